"""What the columns of a stand log really hold: loads or speeds exchanged, another unit, another sign.

Every reading of the labels (`Way`) says what the columns would show if it were so. Where one of them fits a
stretch of rows to a few per cent, and the labels as they stand do not by far, the labels are wrong there.
The yardstick is the given rotor model, or what the other rows of the same log agree on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.frames import STAND_CHANNELS, Array, StandFrame
from coaxlink.residual.channels.stand import COLUMN_OF
from coaxlink.residual.faults.row_ranges import (
    CAP,
    LEAST_PLACES,
    WHOLE,
    Mask,
    nuisance_terms,
    parts_of,
    places,
    robust_fit,
    stretches,
)
from coaxlink.rotor.polynomial import design_matrix

TOLERANCE = 0.03  # of the reference load: what a nuisance model may err by
CLOSER = 0.25  # of the capped squares under the labels as they stand
NEAR = 4.0  # squared tolerances a reading may be off by, where a way is right
FAR = (0.6, 1.6)  # no effect of physics changes one load by more
FARTHER = (0.4, 2.5)  # in a part of the rows, where more may happen
# but for these: half a bridge, or an amplifier's other gain (HX711: 128 or 64)
GAINS, GAIN_ERROR = (0.5, 2.0), 0.02
FAIR = (0.2, 5.0)  # beyond, even a slight load tells
LEAST_TIMES = 4.0  # closer
LOADED = 0.25  # of the reference: less load tells no ratio
LEAST_COPIED = 6  # rows
ALIKE = 2.5  # steps of the readings: within them two cells may read the same by chance
BY_CHANCE = 1e-6  # logs in which two cells agree for so long by accident
ROUNDS = 4
FIT_ROWS = 4000
BEGINNINGS, SCREENED_ROWS = 2, 400  # effort: of readings that are taken further; of a look at each
UNITS = {  # of a newton, and of a newton metre
    "thrust": {
        "kgf": 1 / GRAVITY_M_S2,
        "gf": 1000 / GRAVITY_M_S2,
        "mN": 1000.0,
        "lbf": 0.2248089,
        "ozf": 3.596943,
    },
    "torque": {
        "N cm": 100.0,
        "N mm": 1000.0,
        "kgf cm": 100 / GRAVITY_M_S2,
        "gf cm": 1e5 / GRAVITY_M_S2,
        "kgf m": 1 / GRAVITY_M_S2,
        "ozf in": 141.6119,
        "lbf in": 8.850746,
    },
}


@dataclass(frozen=True)
class Way:
    """A way in which labels may be wrong. `source` (channel) is the load that each column really shows."""

    columns: str
    channels: tuple[int, ...]  # whose columns it concerns
    source: tuple[int, int, int, int] = (0, 1, 2, 3)
    speeds: bool = False  # the speeds of the two rotors are exchanged
    factor: float = 1.0
    says: str = ""


@dataclass(frozen=True)
class Mislabel:
    """Rows in which a way of reading the columns fits, and the labels do not."""

    way: Way
    rows: Mask
    times: float  # closer

    @property
    def of_all_rows(self) -> bool:
        """Whether it concerns every row of the log."""
        return float(np.mean(self.rows)) > WHOLE

    @property
    def why(self) -> str:
        """In words."""
        if not self.times:
            return self.way.says
        return f"{self.way.says} ({self.times:.0f} times closer than as labelled)"


def mislabels(frame: StandFrame, usable: Mask) -> list[Mislabel]:
    """Where the labels of loads and speeds are wrong, in rows that nothing else is wrong with."""
    copies = _copies(frame, usable)
    for copy in copies:
        usable = usable & ~copy.rows
    return [*copies, *_exchanged(frame, usable)]


def _exchanged(frame: StandFrame, usable: Mask) -> list[Mislabel]:
    loads = [c for c in frame.present if c < 4]
    if usable.sum() < 8 or not loads:
        return []
    if not frame.free_nuisance:
        return _found(
            _Yardstick(frame, frame.predicted[:, :4], frame.loads_at(frame.speeds[:, ::-1])), usable
        )
    parts = [part & usable for part in parts_of(len(usable))]
    best, agree = _agreed(frame, usable, [(part, None) for part in parts])
    if not agree and not best[1]:
        # where each part has speeds of its own, a fit to one says little of the other: one for both, with
        # the other exchanged
        ways = [way for way in _exchanges(frame) if not way.speeds]
        both = [(usable & ~part, way) for way in ways for part in parts[1:]]
        both = sorted(both, key=lambda r: _misses(frame, usable, r))[:BEGINNINGS]
        best = min(best, _agreed(frame, usable, both)[0], key=lambda b: b[0])
    return best[1]


Reading = tuple[Mask, Way | None]  # rows to begin with, and how they are read; else trusted as they are


def _misses(frame: StandFrame, usable: Mask, reading: tuple[Mask, Way]) -> float:
    """Capped squares that one fit to all rows leaves, some of them read in another way; of a thinned log."""
    rows, way = reading
    few = np.zeros(len(usable), bool)
    few[np.flatnonzero(usable)[:: max(1, int(usable.sum()) // SCREENED_ROWS)]] = True
    stick = _fitted(frame, few, [(way, rows)])
    cost = np.where(rows[:, None], stick.cost(way), stick.cost(None))
    return float(np.sum(cost[few][:, [c for c in frame.present if c < 4]]))


def _agreed(
    frame: StandFrame, usable: Mask, readings: Sequence[Reading]
) -> tuple[tuple[float, list[Mislabel]], bool]:
    """The mislabels that leave least, each reading taken to where it stays; whether all rows agree."""
    loads = [c for c in frame.present if c < 4]
    best: tuple[float, list[Mislabel]] = (np.inf, [])
    for number, (rows, way) in enumerate(readings):
        trusted = usable if way else rows
        if trusted.sum() < 24:
            continue
        read: list[tuple[Way, Mask]] = [(way, rows)] if way else []
        found: list[Mislabel] = []
        for _ in range(ROUNDS):
            stick = _fitted(frame, trusted, read)
            found = _found(stick, usable)
            if way:
                now, again = (
                    usable,
                    [(m.way, m.rows) for m in found if not m.way.speeds and m.way.factor == 1.0],
                )
            else:
                now, again = (
                    usable & ~np.logical_or.reduce([np.zeros(len(usable), bool), *(m.rows for m in found)]),
                    [],
                )
            if now.sum() < 24 or (np.array_equal(now, trusted) and _same_rows(read, again)):
                break
            trusted, read = now, again
        left = stick.cost(None)[:, loads]
        # minus the log of a likelihood: the fewer rows must be wrong, and the fewer ways, the better
        total = usable.sum() * float(np.sum(np.log(stick.reference[loads]))) + 30.0 * len(found)
        for m in found:
            left[m.rows] = np.minimum(left, stick.cost(m.way)[:, loads])[m.rows]
            total += float(m.rows.sum()) * (1.0 + np.log(abs(m.way.factor)))
        total += 0.5 * float(np.sum(left[usable]))
        if total < best[0] and not any(m.rows.sum() > 0.55 * usable.sum() for m in found):
            best = total, found
        if number == 0 and not way and not found and np.mean(left[usable] > 9.0) < 0.01:
            return best, True
    return best, False


def _same_rows(read: Sequence[tuple[Way, Mask]], again: Sequence[tuple[Way, Mask]]) -> bool:
    return len(read) == len(again) and all(
        a is b and np.array_equal(x, y) for (a, x), (b, y) in zip(read, again, strict=True)
    )


def _copies(frame: StandFrame, usable: Mask) -> list[Mislabel]:
    """Stretches in which two columns show the same readings, digit by digit, and should not."""
    out = []
    pairs = [(0, 2), (1, 3)]
    for a, b in pairs:
        if {a, b} <= set(frame.present):
            same = _copied_runs(usable, frame.measured[:, a], frame.measured[:, b])
            if same.any():
                names = ", ".join(COLUMN_OF[STAND_CHANNELS[c]] for c in (a, b))
                out.append(
                    Mislabel(
                        Way(names, (a, b), says="both show the same readings, digit by digit"), same, 0.0
                    )
                )
    # two rotors told to turn alike may do so: only where the loads contradict it
    same = _runs(usable & (frame.speeds[:, 0] == frame.speeds[:, 1]), frame.speeds[:, 0])
    rest = usable & ~same
    if not same.any() or rest.sum() < 24 or same.sum() > rest.sum():
        return out
    if (
        frame.driven and frame.free_nuisance
    ):  # nothing but a fit to other commands says what these should give
        return out
    loads = [c for c in frame.present if c < 4]
    stick = _Yardstick(frame, frame.predicted[:, :4], frame.predicted[:, :4])
    if frame.free_nuisance:
        stick = _fitted(frame, rest)
    cost = stick.cost(None)[:, loads].max(axis=1)
    # commands that are alike may be meant so, and what they make of it may err
    if np.mean(cost[same]) > max(0.6 * CAP if frame.driven else NEAR, 4.0 * float(np.mean(cost[rest]))):
        says = "both show the same readings, digit by digit, and the loads are of other speeds"
        out.append(Mislabel(Way("upper_rpm, lower_rpm", tuple(loads), says=says), same, 0.0))
    return out


def _copied_runs(usable: Mask, a: Array, b: Array) -> Mask:
    """Runs of rows in which two cells read the same, that coarse readings do not bring by chance.

    How often two sound cells agree is told by the rows outside a run in which they read alike; where there
    are none, by how often either reads each of its values.
    """
    equal = usable & (a == b)
    rows = np.flatnonzero(_runs(equal, a))
    out = np.zeros(len(usable), bool)
    values, counts = np.unique(np.concatenate([a[usable], b[usable]]), return_counts=True)
    meeting = float(np.sum((counts / counts.sum()) ** 2))
    step = float(np.min(np.diff(values), initial=np.inf))
    alike = usable & (np.abs(a - b) < ALIKE * step)
    for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(rows) else ():
        others = alike.copy()
        others[run] = False
        agree = max(meeting, float(np.sum(equal & others)) / max(int(others.sum()), LEAST_COPIED))
        if -len(run) * np.log(min(agree, 1.0)) - 2.0 * np.log(len(a)) > -np.log(BY_CHANCE):
            out[run] = True
    return out


def _runs(same: Mask, values: Array) -> Mask:
    """Rows of a mask that come in runs of readings which are not all one."""
    out = np.zeros(len(same), bool)
    rows = np.flatnonzero(same)
    for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
        if len(run) >= LEAST_COPIED and len(np.unique(values[run])) > 2:
            out[run] = True
    return out


@dataclass(frozen=True)
class _Yardstick:
    """What the columns should show: loads as labelled and with the speeds exchanged, both (rows, 4)."""

    frame: StandFrame
    plain: Array
    exchanged: Array

    @property
    def reference(self) -> Array:
        return np.maximum(np.quantile(np.abs(self.plain), 0.95, axis=0), 1e-9)

    def cost(self, way: Way | None) -> Array:
        """(rows, 4) capped squares of misses over the tolerance."""
        source = list(way.source) if way else [0, 1, 2, 3]
        expected = self.exchanged if way and way.speeds else self.plain
        factor = np.ones(4)
        if way:
            factor[list(way.channels)] = way.factor
        miss = self.frame.measured[:, :4] - factor * expected[:, source]
        return np.asarray(
            np.minimum((miss / (TOLERANCE * np.abs(factor) * self.reference[source])) ** 2, CAP)
        )


def _fitted(frame: StandFrame, trusted: Mask, read: Sequence[tuple[Way, Mask]] = ()) -> _Yardstick:
    """The polynomials that trusted rows agree on, some of them read in another way."""
    measured = frame.measured.copy()
    for way, mine in read:
        measured[mine, :4] = frame.measured[mine][:, list(way.source)]
    rows = np.flatnonzero(trusted)
    few = np.zeros(len(trusted), bool)
    few[rows[:: max(1, len(rows) // FIT_ROWS)]] = True
    out = [np.zeros((len(trusted), 4)), np.zeros((len(trusted), 4))]
    for c in frame.present:
        if c < 4:
            names = nuisance_terms(frame.speeds[few], c)
            x = design_matrix(names, frame.speeds[:, 0], frame.speeds[:, 1])
            fit = robust_fit(x, measured[:, c], few)
            out[0][:, c] = x @ fit
            out[1][:, c] = design_matrix(names, frame.speeds[:, 1], frame.speeds[:, 0]) @ fit
    return _Yardstick(frame, *out)


def _exchanges(frame: StandFrame) -> list[Way]:
    present = [c for c in frame.present if c < 4]
    ways = []
    pairs = [(a, b) for a in present for b in present if a < b]
    for pair in [*pairs, (0, 2, 1, 3)]:
        if not set(pair) <= set(present):
            continue
        source = [0, 1, 2, 3]
        for a, b in zip(pair[::2], pair[1::2], strict=True):
            source[a], source[b] = b, a
        names = ", ".join(COLUMN_OF[STAND_CHANNELS[c]] for c in pair)
        says = "exchanged, the columns fit: labels or wires are swapped"
        ways.append(Way(names, tuple(sorted(pair)), (source[0], source[1], source[2], source[3]), says=says))
    if min(np.ptp(frame.speeds, axis=0)) > 0.0:
        names = "upper_*, lower_* speeds"
        says = "with the speeds of upper and lower exchanged the loads fit: labels or wires are swapped"
        ways.append(Way(names, tuple(present), speeds=True, says=says))
    return ways


def _found(stick: _Yardstick, usable: Mask) -> list[Mislabel]:
    """Mislabels one after the other, the one that wins most first."""
    out: list[Mislabel] = []
    free = usable.copy()
    for _ in range(ROUNDS):
        plain = stick.cost(None)
        best: tuple[float, Mislabel] | None = None
        for way in [*_exchanges(stick.frame), *_scalings(stick, free)]:
            new = _where(stick, way, plain, free)
            if new is not None and (best is None or new[0] > best[0]):
                best = new
        if best is None:
            return out
        out.append(best[1])
        free &= ~best[1].rows
        if free.sum() < 8:
            return out
    return out


def _where(stick: _Yardstick, way: Way, plain: Array, free: Mask) -> tuple[float, Mislabel] | None:
    """The rows in which a way fits far better, and by how much in all."""
    use = list(way.channels)
    with_it = stick.cost(way)[:, use]
    as_is = plain[:, use].copy()
    if way.factor != 1.0:  # an unloaded cell tells no ratio
        modest = FAIR[0] < way.factor < FAIR[1]
        idle = np.abs(stick.plain[:, use]) < (LOADED if modest else 0.02) * stick.reference[use]
        as_is[idle] = with_it[idle] = 0.0
    rows = np.flatnonzero(free)
    won = (as_is - with_it).sum(axis=1)[rows]
    mask, total = np.zeros(len(free), bool), 0.0
    for piece in _joined(stretches(won), won):
        mine = rows[piece]
        telling = np.abs(as_is[mine] - with_it[mine]).sum(axis=1) > 1.0
        before, after = as_is[mine][telling], with_it[mine][telling]
        close = after.sum() < CLOSER * before.sum() and np.all(after.mean(axis=0) < NEAR)
        every = np.all(after.sum(axis=0) < 0.5 * before.sum(axis=0))
        if telling.sum() >= 4 and close and every and _ranges(stick, way, mine[telling]):
            mask[mine] = True
            total += float(won[piece].sum())
    if not mask.any():
        return None
    whole = mask.sum() >= WHOLE * free.sum()
    gain = way.factor == 1.0 or any(abs(way.factor / known - 1.0) < GAIN_ERROR for known in GAINS)
    if not whole and FARTHER[0] < way.factor < FARTHER[1] and not gain:
        return None
    times = float(np.sqrt(_raw(stick, None, use, mask) / max(_raw(stick, way, use, mask), 1e-12)))
    return (total, Mislabel(way, free.copy() if whole else mask, times)) if times > LEAST_TIMES else None


def _joined(pieces: Sequence[slice], won: Array) -> list[slice]:
    """Pieces in order, with gaps closed that tell nothing against it."""
    out: list[slice] = []
    for piece in sorted(pieces, key=lambda p: p.start):
        if out and won[out[-1].stop : piece.start].sum() >= -CAP:
            out[-1] = slice(out[-1].start, piece.stop)
        else:
            out.append(piece)
    return out


def _raw(stick: _Yardstick, way: Way | None, use: list[int], rows: Mask) -> float:
    source = list(way.source) if way else [0, 1, 2, 3]
    expected = stick.exchanged if way and way.speeds else stick.plain
    factor = way.factor if way else 1.0
    miss = stick.frame.measured[:, use] - factor * expected[:, source][:, use]
    scale = np.abs(factor) * stick.reference[source][use]
    return float(np.mean((miss / scale)[rows] ** 2))


def _ranges(stick: _Yardstick, way: Way, rows: NDArray[np.intp]) -> bool:
    """Whether it is seen at several speeds, and a scaling over a range of loads."""
    if places(stick.frame.speeds[rows]) < LEAST_PLACES:
        return False
    if way.factor == 1.0:
        return True
    c = way.channels[0]
    return bool(np.ptp(stick.plain[rows, c]) > 0.2 * stick.reference[c])


def _scalings(stick: _Yardstick, free: Mask) -> list[Way]:
    """A factor for every load that is, in many rows, far from what it should be."""
    out = []
    frame = stick.frame
    for c in frame.present:
        if c > 3:
            continue
        p, m = stick.plain[:, c], frame.measured[:, c]
        loaded = free & (np.abs(p) > LOADED * stick.reference[c])
        ratio = m[loaded] / p[loaded]
        off = ratio[(ratio < FAR[0]) | (ratio > FAR[1])]
        if len(off) < 6:
            continue
        factor = float(np.median(off))
        if FAR[0] < factor < FAR[1] or abs(factor) < 1e-4:
            continue
        partner = c ^ 1
        with_c = loaded & ((m < FAR[0] * p) | (m > FAR[1] * p))
        # a unit is wrong throughout, of both loads perhaps
        throughout = with_c.sum() >= WHOLE * loaded.sum()
        if partner in frame.present and (FAIR[0] < factor < FAIR[1] or not throughout):
            # both loads of a rotor are off alike where it turns at another speed, or another rotor is on it
            beside = frame.measured[with_c, partner] / np.where(
                np.abs(stick.plain[with_c, partner]) < 1e-9, 1e-9, stick.plain[with_c, partner]
            )
            if not FAR[0] < float(np.median(beside)) < FAR[1]:
                continue
        out.append(Way(COLUMN_OF[STAND_CHANNELS[c]], (c,), factor=factor, says=_scale_words(c, factor)))
    return out


def _scale_words(channel: int, factor: float) -> str:
    near = {
        abs(np.log(abs(factor) / k)): name for name, k in UNITS[("thrust", "torque")[channel % 2]].items()
    }
    near[abs(np.log(abs(factor)))] = ""
    unit = near[min(near)] if min(near) < 0.05 else ""
    guesses = ["its sign"] * (factor < 0) + [unit] * bool(unit)
    guess = f": {' and '.join(guesses)}?" if guesses else ""
    return f"{factor:.3g} times what the speeds give{guess}; no effect of physics does that"
