"""What the columns of a stand log really show, row by row: a hidden Markov chain over ways in which they lie.

Each state undoes one fault of the instruments (another unit or sign, cables exchanged, a loose plug, pulses
counted wrong) and says how far what is left is from the loads at those speeds, and the speeds from what their
throttles give. The sound state allows beside the tolerance whatever physics may do to a load. Yardstick is
the given rotor model, or what the other rows of the same log agree on. Rabiner, Proc. IEEE 77 (1989), III.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from coaxlink.channels.stand import COLUMN_OF, dictionary_of
from coaxlink.frames import STAND_CHANNELS, Array, StandFrame
from coaxlink.instruments.chain import BEGINS, SURE, WHOLE, log_evidence_of, settled
from coaxlink.instruments.findings import Mask, runs_of
from coaxlink.instruments.stand.reference import (
    LOADED,
    PHYSICS,
    TOLERANCE,
    Reference,
    curves_of,
    reference_of,
)
from coaxlink.instruments.stand.states import (
    AGREED,
    RATIOS,
    RPM,
    Faulty,
    State,
    earlier,
    exchanges,
    named,
    readings_of,
    scale_words,
)
from coaxlink.rotor.model import LOADS
from coaxlink.rotor.polynomial import design_matrix

# priors: name = value  # unit, source
LIKE = 0.05  # of full speed: rows at like speeds
CLOSER, NEAR, OFF = 4.0, 4.0, 25.0  # times; squared tolerances, of each channel; more is off, by however much
LATEST_S = 3.0  # s, judgement: an amplifier's filter or another clock; later is another run's column
SLIP = 0.01  # of the speed: a motor's curve of throttle is known to that
GAIN, OTHER = 0.05, 0.25  # of the load: spans drift by less within a log; of that, by the rotor's other load
RUNS, AGREE, AMONG = 2, 0.35, 12  # of another gain; of it, by so many rows that have others at like speeds
MOST_OF_ROWS = 0.55  # of the rows: of a fit to the log itself, more cannot be separated from the rest
FAULT_ROUNDS, SCREENED_ROWS, BEGINNINGS = 4, 400, 2  # effort
PARTS = (((0.0, 1.0),), ((0.0, 0.5),), ((0.5, 1.0),), ((0.25, 0.75),), ((0.0, 0.25), (0.75, 1.0)),
         ((0.0, 0.34),), ((0.66, 1.0),))  # fmt: skip


# damaged readings, whose powers are beyond numbers, tell nothing
@np.errstate(over="ignore", invalid="ignore")
def lies(frame: StandFrame, usable: Mask) -> list[Faulty]:
    """Where columns are not what they say, in rows that nothing else is wrong with."""
    if usable.sum() < 8 or not [c for c in frame.present if c < 4]:
        return []
    parts = [part & usable for part in parts_of(len(usable))]
    best = _path(frame, usable, usable, [])
    if best.agree:
        return best.found
    for part in parts[1:]:
        best = best.or_(_path(frame, usable, part, []))
    states, every = exchanges(frame), []
    if frame.free_nuisance:
        # where each part has speeds of its own, a fit to one says little of the other: one for both
        every = [(s, usable & ~part) for s in states if s.exchanged != "speeds" for part in parts[1:]]
        every = sorted(every, key=lambda r: _screened(frame, usable, r))[:BEGINNINGS]
    # of all rows a fit tells nothing of what is free in it: a rotor's thrust and its torque
    determined = [
        s for s in states if frame.free_nuisance and (s.exchanged or s.channels in ((0, 2), (1, 3)))
    ]
    every += [(s, usable) for s in determined or [s for s in states if s.exchanged == "throttles"]]
    every += [(s, usable) for s in _late_cells(frame, usable)]
    for begun in every:
        best = best.or_(_path(frame, usable, usable, [begun]))
    return best.found


@np.errstate(over="ignore", invalid="ignore")
def slips(frame: StandFrame, usable: Mask) -> list[Faulty]:
    """Where a tachometer or a cell reads by some per cent something else than the others of the log say."""
    sides = [c - 4 for c in frame.present if c > 3 and {2 * c - 8, 2 * c - 7} & set(frame.present)]
    sides = [] if frame.driven else sides
    if usable.sum() < 24:
        return []
    best = _path(frame, usable, usable, [], True)
    begun = sorted(_begun(frame, usable, sides), key=lambda r: _screened(frame, usable, r, True))
    for read in begun[:BEGINNINGS]:
        best = best.or_(_path(frame, usable, usable, [read], True))
    return best.found


def _begun(frame: StandFrame, usable: Mask, sides: Sequence[int]) -> Iterator[tuple[State, Mask]]:
    """Slips in bands of throttle or of time, by what joins the curves of inside and outside best."""
    log, rows = readings_of(frame), np.flatnonzero(usable)
    few = rows[:: max(1, len(rows) // SCREENED_ROWS)]
    for side in sides:
        speed, curves = log.speeds[:, side], curves_of(log.throttles, side, True)
        tried = []
        for order in (log.throttles[:, side], np.arange(len(speed))):
            edges = np.unique([-np.inf, *np.quantile(order[usable], np.linspace(0.1, 0.9, 9)), np.inf])
            for low, high in combinations(edges, 2):
                band = (order > low) & (order <= high)
                x = np.concatenate([curves, (speed * band)[:, None]], axis=1)[few]
                fit, left, *_ = np.linalg.lstsq(x, speed[few], rcond=1e-10)
                if len(left) and abs(fit[-1]) > SLIP and -2.0 < fit[-1] < 0.7:
                    tried.append((float(left[0]), float(fit[-1]), band & usable))
        for _, part, band in sorted(tried, key=lambda t: t[0])[:BEGINNINGS]:
            for inside, ratio in ((band, 1.0 / (1.0 - part)), (usable & ~band, 1.0 - part)):
                yield State(RPM[side], AGREED, side=side, ratio=ratio), inside


@dataclass(frozen=True)
class _Path:
    """The most probable states of the rows under one reference."""

    total: float  # nats
    found: list[Faulty]
    agree: bool  # all rows, as they are labelled

    def or_(self, other: _Path) -> _Path:
        """The more probable one; a fault surely so."""
        return other if self.total - other.total > (0.0 if self.found else SURE) else self


def _screened(frame: StandFrame, usable: Mask, read: tuple[State, Mask], fine: bool = False) -> float:
    """Nats against a thinned log of which some rows are read in another way, by one fit to all of it."""
    few = np.zeros(len(usable), bool)
    few[np.flatnonzero(usable)[:: max(1, int(usable.sum()) // SCREENED_ROWS)]] = True
    stick = reference_of(frame, few, [read], fine)
    log = read[0].undo(readings_of(frame), read[1])
    scale = float(np.sum(np.log(stick.tolerance[list(frame.present)])))
    # of a reading on another scale
    scale += float(np.log(read[0].ratio or 1.0) * np.mean(read[1][few]))
    return float(np.sum(log_evidence_of(stick.misses(log, stick.due(log)))[few])) + few.sum() * scale


def _path(
    frame: StandFrame, usable: Mask, trusted: Mask, read: list[tuple[State, Mask]], fine: bool = False
) -> _Path:
    """The states that a reference of these rows tells, and the reference of those, until they stay."""
    failed = _Path(np.inf, [], False)
    begun = bool(read)
    for _ in range(FAULT_ROUNDS):
        if trusted.sum() < 24 and frame.free_nuisance:
            return failed
        stick = reference_of(frame, trusted, read, fine)
        found, log_evidence = _states(stick, usable, fine)
        gone = np.logical_or.reduce([np.zeros(len(usable), bool), *(s.rows for s in found)])
        again = [(s.state, s.rows) for s in found if s.state.kept or fine] if begun else []
        now = usable & ~gone
        for _, rows in again:
            now = now | rows
        if now.sum() < 24:
            break
        if np.array_equal(now, trusted) and len(read) == len(again) and all(
            a == b and np.array_equal(x, y) for (a, x), (b, y) in zip(read, again, strict=True)
        ):  # fmt: skip
            break
        trusted, read = now, again
    # where what is right is known, or all of it tried
    determined = not fine and (begun or not frame.free_nuisance)
    if not determined and any(s.rows.sum() > MOST_OF_ROWS * usable.sum() for s in found):
        return failed
    scale = float(np.sum(np.log(stick.tolerance[list(frame.present)])))
    log = readings_of(frame)
    off = np.abs(stick.misses(log, stick.due(log)))[usable]
    return _Path(log_evidence + usable.sum() * scale, found, not found and float(np.mean(off > 3.0)) < 0.01)


def _slips(stick: Reference, usable: Mask, due: Array, possible: Mask) -> list[State]:
    """Tachometers and cells that read by what the off ones of these rows read."""
    out = []
    for c in [c for c in stick.frame.present if c < 4 and c ^ 1 in stick.frame.present]:
        rows = usable & (np.abs(due[:, c]) > LOADED * stick.reference[c])
        rows &= np.abs(stick.frame.measured[:, c] - due[:, c]) > 3.0 * stick.tolerance[c]
        off = stick.frame.measured[rows, c] / due[rows, c]
        for times in (off[off > 1.0], off[off < 1.0]):
            factor = float(np.median(times)) if len(times) else 1.0
            if abs(factor - 1.0) > GAIN:
                says = f"reads {100 * (factor - 1.0):+.0f} % here, and the rotor's other load does not"
                out.append(State(COLUMN_OF[STAND_CHANNELS[c]], says, (c,), factor=factor))
    for side in stick.curves if not stick.frame.driven else ():
        c = 4 + side
        out.append(State(RPM[side], AGREED, side=side))
        rows = usable & (due[:, c] > LOADED * stick.reference[c])
        rows &= np.abs(stick.frame.speeds[:, side] - due[:, c]) > 3.0 * stick.tolerance[c]
        off = stick.frame.speeds[rows, side] / due[rows, c]
        for times in (off[off > 1.0], off[off < 1.0]):
            if len(times) and abs(float(np.median(times)) - 1.0) > SLIP:
                out.append(State(RPM[side], AGREED, side=side, ratio=float(np.median(times))))
    return out


def _possible(stick: Reference, usable: Mask, due: Array, possible: Mask) -> list[State]:
    """The states that these readings ask for."""
    frame = stick.frame
    out = exchanges(frame)
    for c in [c for c in frame.present if c < 4]:
        name = COLUMN_OF[STAND_CHANNELS[c]]
        why = "it reads nothing for some rows while the rotor pulls: a plug or a wire is loose"
        out.append(State(name, why, (c,), factor=0.0))
        loaded = usable & (np.abs(due[:, c]) > LOADED * stick.reference[c])
        share = frame.measured[loaded, c] / due[loaded, c]
        off = share[(share < PHYSICS[0]) | (share > PHYSICS[1])]
        factor = float(np.median(off)) if len(off) else 1.0
        if not PHYSICS[0] < factor < PHYSICS[1] and abs(factor) > 1e-4:
            out.append(State(name, scale_words(c, factor), (c,), factor=factor))
        out += [_late(frame, c, late) for late in [_rows_late(stick, usable, due, c)] if late]
    for side in (0, 1) if not frame.driven else ():
        loads = [c for c in (2 * side, 2 * side + 1) if c in frame.present]
        if not np.any(usable & ~possible[:, loads].all(axis=1)):  # as pulses miscounted make them
            continue
        says, ratios = "the loads show another speed, pulses are counted wrong", set(RATIOS)
        if 4 + side in frame.present:
            says = AGREED
            usual = due[:, 4 + side]
            turns = usable & (usual > LOADED * stick.reference[4 + side])
            times = frame.speeds[turns, side] / usual[turns]
            off = times[np.abs(times - 1.0) > 3.0 * TOLERANCE]
            usually = float(np.median(off)) if len(off) else 1.0
            if all(abs(usually / r - 1.0) > TOLERANCE for r in (1.0, *RATIOS)):
                ratios.add(usually)
        out += [State(RPM[side], says, side=side, ratio=r) for r in sorted(ratios) if r > 0.05]
    return out


def _late(frame: StandFrame, c: int, rows: int) -> State:
    seconds = rows * float(np.median(np.diff(frame.time_s)))
    says = f"comes {seconds:.2g} s after the speeds, and the rotor's other load does not"
    return State(COLUMN_OF[STAND_CHANNELS[c]], says, (c,), late=rows)


def _most_late(frame: StandFrame, usable: Mask, c: int) -> int:
    """Rows by which a load may be late; none without the rotor's other load, which is not."""
    step = float(np.median(np.diff(frame.time_s)))
    known = c ^ 1 in frame.present and step > 0.0
    return min(int(LATEST_S / step), int(usable.sum()) // 4) if known else 0


def _rows_late(stick: Reference, usable: Mask, due: Array, c: int) -> int:
    """By how many rows a load is behind what its speeds give; none where the rotor's other load, which a lag
    of the rotor or of its wake would move too, is not nearer as it is.
    """
    frame, partner = stick.frame, c ^ 1

    def missed(load: int, rows: int) -> float:
        off = (earlier(frame.measured[:, load], rows) - due[:, load])[usable]
        return float(np.mean(np.minimum((off / stick.tolerance[load]) ** 2, OFF)))

    late = int(np.argmin([missed(c, k) for k in range(_most_late(frame, usable, c) + 1)]))
    return late if late and missed(partner, 0) < missed(partner, late) else 0


def _late_cells(frame: StandFrame, usable: Mask) -> Iterator[State]:
    """Loads that polynomials of the speeds follow better some rows earlier, where no model is given: a fit to
    what came late follows neither.
    """
    rows = np.flatnonzero(usable)[:: max(1, int(usable.sum()) // SCREENED_ROWS)]
    for c in [c for c in frame.present if c < 4 and frame.free_nuisance]:
        x = design_matrix(dictionary_of(LOADS[c], 2), *frame.speeds[rows].T)
        across = np.eye(len(rows)) - x @ np.linalg.pinv(x)
        shifts = range(_most_late(frame, usable, c) + 1)
        left = np.array([float(np.std(across @ earlier(frame.measured[:, c], k)[rows])) for k in shifts])
        if (late := int(np.argmin(left))) and CLOSER * left[late] < left[0]:
            yield _late(frame, c, late)


def _states(stick: Reference, usable: Mask, fine: bool) -> tuple[list[Faulty], float]:
    """What holds in which rows, and nats against all of them."""
    log, rows = readings_of(stick.frame), np.flatnonzero(usable)
    due = stick.due(log)
    sound, possible = stick.sound(log)
    states = (_slips if fine else _possible)(stick, usable, due, possible)
    if not states:
        return [], float(np.sum(sound[rows]))
    won = np.stack([stick.won(s, sound, possible, due) for s in states], axis=1)[rows]
    against = float(np.sum(sound[rows]))
    likely = []
    for k, state in enumerate(states):  # a chain of all of them is dear
        mine = np.zeros(len(usable), bool)
        mine[rows[won[:, k] > 1.0]] = True
        if mine.any() and _closer(stick, state, mine, due):
            likely.append(k)
    states, won = [states[k] for k in likely], won[:, likely]

    def borne_out(k: int, mine: Mask) -> Faulty | None:
        at = np.zeros(len(usable), bool)
        at[rows[mine]] = True
        return _borne_out(stick, states[k], at, usable, won[mine, k], due)

    found = settled(won, borne_out)
    explained = sum(float(won[mine, k].sum()) for k, mine, _ in found)
    return [reported for *_, reported in found], against - explained


def _borne_out(
    stick: Reference, state: State, rows: Mask, usable: Mask, won: Array, due: Array
) -> Faulty | None:
    """The rows of a state, all where nearly all are; none without enough speeds and loads that show it."""
    frame = stick.frame
    if float(won.sum()) - len(runs_of(rows)) * BEGINS < SURE:
        return None
    whole = rows.sum() >= WHOLE * usable.sum()
    if state.one_cell:
        (c,) = state.channels
        unnamed = not whole and state.factor and not named(c, state.factor)[1]
        if unnamed and not _touched(stick, state, rows, usable, due):
            return None
    times = _closer(stick, state, rows, due)
    if not times:
        return None
    reads = np.ones(len(rows))
    if state.side >= 0:
        reads[rows] = state.ratio or 1.0
        if not state.ratio:
            reads[rows] = frame.speeds[rows, state.side] / due[rows, 4 + state.side]
    return Faulty(state, usable.copy() if whole else rows, times, reads)


def _closer(stick: Reference, state: State, rows: Mask, due: Array) -> float:
    """How many times closer these rows are with it; nothing where a channel is not, or is not near then."""
    log, concerned = readings_of(stick.frame), [c for c in state.concerns if c in stick.frame.present]
    if not rows.any() or not concerned:
        return 0.0
    read = stick.undone(state, due)
    before = stick.misses(log, due)[rows][:, concerned] ** 2
    after = stick.misses(read, due if state.one_cell else stick.due(read))[rows][:, concerned] ** 2
    if not state.factor:
        after = (log.loads / stick.tolerance[:4])[rows][:, concerned] ** 2
    times = float(np.sqrt(before.mean() / max(float(after.mean()), 1e-12)))
    few, many = (np.minimum(x, OFF).mean(axis=0) for x in (after, before))
    return times if times > CLOSER and np.all(few < np.minimum(many / 2.0, NEAR)) else 0.0


def _touched(stick: Reference, state: State, rows: Mask, usable: Mask, due: Array) -> bool:
    """Whether a cell's gain changed for a while, by rows at like speeds before and after it.

    No effect of a rotor scales one load and not its other one, between two rows of a log and back again.
    """
    frame, (c,), off = stick.frame, state.channels, state.factor - 1.0
    loaded = np.abs(due[:, :4]) > LOADED * stick.reference[:4]
    if c ^ 1 not in frame.present or len(runs_of(rows)) > RUNS:
        return False
    share = np.where(loaded, frame.measured[:, :4] / np.where(loaded, due[:, :4], 1.0), np.nan)
    both = rows & loaded[:, c] & loaded[:, c ^ 1]
    if not both.any() or abs(float(np.median(share[both, c ^ 1])) - 1.0) > OTHER * abs(off):
        return False
    mine, at = np.flatnonzero(rows & loaded[:, c]), np.arange(len(rows))
    agree = []
    for side in (at < mine[0], at > mine[-1]):
        others = np.flatnonzero(usable & ~rows & side & loaded[:, c])
        if not len(others):
            continue
        far, near = cKDTree(frame.speeds[others]).query(frame.speeds[mine], distance_upper_bound=LIKE)
        has = np.isfinite(far)
        if has.sum() >= AMONG:
            change = float(np.median(share[mine[has], c] - share[others[near[has]], c]))
            agree.append(abs(change - off) < AGREE * abs(off))
    return bool(agree) and all(agree)


def parts_of(rows: int) -> list[Mask]:
    """Masks (rows,) of contiguous parts of a log: in one of them the labels may be right throughout."""
    at = (np.arange(rows) + 0.5) / rows
    return [np.logical_or.reduce([(a <= at) & (at < b) for a, b in part]) for part in PARTS]
