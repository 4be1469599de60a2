"""Columns of a flight that cannot be what their labels say: stuck, reversed, scaled or exchanged sensors.

Each way in which columns may lie is a state of a hidden Markov chain over the windows of a flight: it undoes
one fault (another scale, unit or sign, labels exchanged), and counts by how much nearer the columns then are
to what the others make of them (`kinematics`). What repeats digit by digit is known by that alone, or, where
the column is coarse, with what it should have read.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from coaxlink.data.resolution import is_coarse
from coaxlink.evidence.held_out import Index
from coaxlink.frames import IMU_COLUMNS, Array
from coaxlink.instruments.chain import BEGINS, SURE, WHOLE, log_evidence_of, settled
from coaxlink.instruments.findings import Finding, Mask, runs_of
from coaxlink.instruments.flight.apart import rounded
from coaxlink.instruments.flight.flown_log import FlownLog
from coaxlink.instruments.flight.kinematics import (
    ACCEL,
    ANGLES,
    COARSE,
    COLUMNS,
    FINEST,
    GYRO,
    LEAST_WINDOWS,
    SHARE,
    VELOCITY,
    Kinematics,
    Linear,
    independent,
    kinematics_of,
    linear_of,
    noise_of,
)
from coaxlink.instruments.flight.still import STUCK_S
from coaxlink.instruments.repeats import copied_rows, held_runs, is_fine, limits_of

# priors: name = value  # unit, source
MOST_V = 1500.0  # judgement: packs of multirotors have 60 V, of air taxis 800 V
# nats a window, judgement: what the reference itself misses adds up in a long flight (sound ones of ten sets
# gain 0.17 at most, columns that lie throughout 0.8 and more)
SLIGHT = 0.3
# of a zero from one part of a flight to the next, judgement: what SHARE leaves of 1 g, and of a turn of a
# radian a second; sensors that warm move by a third of it (MPU-6000)
SHIFT = dict.fromkeys(ACCEL[:2], 0.5) | dict.fromkeys(GYRO, 0.05)
QUARTERS = 4  # of a flight, one of which has to read otherwise than the rest
KNOWN_BY = {"accel": "velocity", "gyro": "angles", "vel": "accelerometers", "height": "vertical velocity"}
KNOWN_BY |= dict.fromkeys(("roll", "pitch", "yaw"), "gyros")
EXCHANGED = "exchanged, the columns fit: labels or wires are swapped"


def column_faults(log: FlownLog) -> list[Finding]:
    """(column, (rows,) mask, why) of what cannot be, whatever the rotors do."""
    kin = kinematics_of(log)
    copied = copied_rows(np.stack([log[name] for name in IMU_COLUMNS], axis=1))
    found: list[Finding] = []
    if copied.any():
        found.append(("accel_*, gyro_*", copied, "these readings stand in the log before, digit by digit"))
    for name, rows in _held(log).items():
        fine = _fine_around(log, name, rows)
        stuck = fine | _proven(kin, name, rows & ~fine)
        if stuck.any():
            determined = "the gyros tell that the vehicle turns" if name in ANGLES else "the vehicle flies"
            found.append((name, stuck, f"one reading repeats exactly while {determined}"))
    for name in [name for name in IMU_COLUMNS if _is_fine(log, name)]:
        for limit, _ in limits_of(log[name]):
            why = f"it reads no further than {limit:.3g}, again and again: the sensor is at its limit"
            found.append((name, log[name] == limit, why))
    gone = np.logical_or.reduce([copied, *(rows for _, rows, _ in found)])
    found += _rounded(log)
    if len(kin.first) >= LEAST_WINDOWS:
        found += _Judged.of(kin, ~kin.touches(gone)).about_the_most().chained(log.rows)
    return [*found, *_voltage(log)]


def _rounded(log: FlownLog) -> Iterator[Finding]:
    """The axis of a sensor that moves in far larger steps than its others."""
    for names, finest in ((ACCEL, FINEST[0]), (GYRO, FINEST[3]), (VELOCITY, FINEST[0])):
        values = np.stack([log[name] for name in names], axis=1)
        if coarse := rounded(names, values, log.flying, matters=float(finest)):
            name, step, others = coarse
            why = f"it moves in steps of {step:.2g}, its other axes in {others:.1g}: rounded"
            yield name, np.ones(log.rows, bool), why


def _held(log: FlownLog) -> dict[str, Mask]:
    """Rows of a column in which one reading repeats for so long that it is no accident, in flight."""
    out: dict[str, Mask] = {}
    for name in filter(log.has, COLUMNS):
        rows = np.zeros(log.rows, bool)
        for a, b in held_runs(log[name], STUCK_S / max(log.step_s, 1e-9)):
            rows[a:b] = log.flying[a:b].mean() > 0.5
        if rows.any():
            out[name] = rows
    return out


def _fine_around(log: FlownLog, name: str, held: Mask) -> Mask:
    """(rows,) held runs around which, as many rows on either side, the column moves by more than its steps.

    An estimator's velocity of 1 cm/s resolution is fine in fast flight and stands still with a vehicle that
    hardly moves: one that moves by its steps there is held against the others.
    """
    out = np.zeros_like(held)
    if not _is_fine(log, name):
        return out
    for a, b in runs_of(held):
        out[a:b] = is_fine(log[name][max(2 * a - b, 0) : 2 * b - a], log.steps[name])
    return out


def _is_fine(log: FlownLog, name: str) -> bool:
    """Whether a column does not repeat for its resolution; one that never moves has its neighbours'."""
    family = next((f for f in (ACCEL, GYRO, VELOCITY) if name in f), ())
    if not family:
        return False  # angles and heights may stand still with the vehicle
    if np.isfinite(log.steps[name]):
        return is_fine(log[name], log.steps[name])
    least = min((log.steps[n] for n in family if np.isfinite(log.steps[n])), default=np.nan)
    return not any(is_coarse(log[n], least) for n in family)


@dataclass(frozen=True)
class _Judged:
    """The windows of a log, and what zeros and scales within their bounds leave of their misses."""

    kin: Kinematics
    misses: Array  # (windows, 7)
    linear: Linear
    sound: Array  # (windows, 7)

    @classmethod
    def of(cls, kin: Kinematics, usable: Mask) -> _Judged:
        misses = kin.misses()
        usable = usable if usable.sum() >= LEAST_WINDOWS else np.ones_like(usable)
        linear = linear_of(kin, usable)
        sound = linear.left(misses, noise_of(misses[usable]))
        return cls(kin, misses, linear, linear.left(misses, noise_of(sound[usable])))

    def chained(self, rows: int) -> Iterator[Finding]:
        """Columns that lie in some of the log's rows or in all of them, by the most probable states."""
        usable = self.linear.usable
        found = [(names, why, self.linear.left(x, noise_of(x[usable]))) for names, why, x in self._states()]
        found += self._moved()
        left = [x for *_, x in found]
        sigma = np.min([noise_of(x[usable]) for x in (self.sound, *left)], axis=0)
        against = log_evidence_of(self.sound / sigma)
        share = independent(self._best_pieced(left, against, sigma)[usable] / sigma)
        won = np.stack([(against - log_evidence_of(x / sigma)) @ share for x in left], axis=1)
        won[~usable] = 0.0

        def borne_out(k: int, mine: Mask) -> Mask | None:
            # labels are exchanged from the first row on: seen wherever it moves
            whole = found[k][0] in SHARE or mine.sum() > 0.5 * usable.sum()
            gained = float(won[mine, k].sum()) - len(runs_of(mine)) * BEGINS
            return mine if whole and gained > max(SURE, SLIGHT * mine.sum()) else None

        for k, mine, _ in settled(won, borne_out):
            at = np.ones(rows, bool)
            if mine.sum() < WHOLE * usable.sum():
                at[:] = False
                for a, b in runs_of(mine):
                    at[self.kin.first[a] : self.kin.first[b - 1] + self.kin.size] = True
            yield found[k][0], at, found[k][1]

    def _best_pieced(self, left: list[Array], against: Array, sigma: Array) -> Array:
        """(windows, 7) misses as labelled, or of one state where that is nearer: it may begin on the way, and
        what a step leaves is no memory of noise."""
        best, least = self.sound, float(np.sum(against[self.linear.usable]))
        for misses in left:
            nearer = np.sum(log_evidence_of(misses / sigma) - against, axis=1) < 0.0
            pieced = np.where(nearer[:, None], misses, self.sound)
            cost = float(np.sum(log_evidence_of(pieced[self.linear.usable] / sigma)))
            best, least = (pieced, cost) if cost < least else (best, least)
        return best

    def _states(self) -> Iterator[tuple[str, str, Array]]:
        """Ways in which columns may lie: their names, in words, the misses (windows, 7) without it."""
        log, usable = self.kin.columns, self.linear.usable
        for names, change in self.linear.exchanges.items():
            yield names, EXCHANGED, self.misses + change
        for a, b in combinations(ANGLES, 2):
            yield f"{a}, {b}", EXCHANGED, self.kin.misses(**{a: log[b], b: log[a]})
        sigma = noise_of(self.sound[usable])
        off = usable & np.any(np.abs(self.sound) > 3.0 * sigma, axis=1)
        # a column that is off from the middle on is neither as a whole nor by its outliers what it is there
        half = np.arange(len(usable)) >= len(usable) // 2
        for name in (*self.linear.scales, *ANGLES):
            for at in (usable, off, usable & half, usable & ~half):
                times = self.linear.scale(name, self.misses, sigma, at) if at.any() else 1.0
                if SHARE[name][0] <= 1.0 / times <= SHARE[name][1]:
                    continue
                by, what = KNOWN_BY[name.split("_")[0]], "scale, zero or unit" if times > 0.0 else "sign"
                why = f"it reads {1.0 / times:.3g} times what the {by} would have: its {what} is wrong"
                yield name, why, self._scaled(name, times)

    def _moved(self) -> Iterator[tuple[str, str, Array]]:
        """Likewise of a zero that is another one in some windows: the misses (windows, 7) then."""
        for name, part, moved in self._parts():
            unit, known = "m/s^2" if name in ACCEL else "rad/s", KNOWN_BY[name.split("_")[0]]
            why = f"by the {known} it reads {moved:+.2g} {unit} more here than elsewhere: its zero moves"
            by = float(np.median(-self.kin.along(name, self.sound)[0][part]))
            yield name, why, self.sound + self.kin.zero(name, by)

    def about_the_most(self) -> _Judged:
        """With the zero of what moves where most windows have it, and not between the two: the middle of the
        shortest interval that holds half of them (Rousseeuw 1984)."""
        sound = self.sound
        for name in dict.fromkeys(name for name, *_ in self._parts()):
            more = np.sort(-self.kin.along(name, sound)[0][self.linear.usable])
            half = len(more) // 2
            first = int(np.argmin(more[half:] - more[: len(more) - half]))
            sound = sound + self.kin.zero(name, float(np.median(more[first : first + half + 1])))
        return replace(self, sound=sound)

    def _parts(self) -> Iterator[tuple[str, Index, float]]:
        """Sensors that read otherwise in a quarter of the flight than in the rest, its windows, and by how
        much more."""
        usable = np.flatnonzero(self.linear.usable)
        for name, most in SHIFT.items():
            more = -self.kin.along(name, self.sound)[0]
            for part in filter(len, np.array_split(usable, QUARTERS)):
                moved = float(np.median(more[part]) - np.median(more[np.setdiff1d(usable, part)]))
                if abs(moved) > most:
                    yield name, part, moved

    def _scaled(self, name: str, times: float) -> Array:
        """(windows, 7) misses with a column times so much."""
        if name in ANGLES:
            return self.kin.misses(**{name: times * np.unwrap(self.kin.columns[name])})
        return self.misses + (times - 1.0) * self.linear.scales[name]


def _proven(kin: Kinematics, name: str, held: Mask) -> Mask:
    """(rows,) runs of a coarse column in which the others differ from it by more than elsewhere."""
    out = np.zeros_like(held)
    if len(kin.first) < LEAST_WINDOWS or not held.any():
        return out
    usable = ~kin.touches(held)
    off, channel = kin.along(name, _Judged.of(kin, usable).sound)
    elsewhere = usable.sum() >= LEAST_WINDOWS  # one that never moved is held against what sound ones do
    sigma = FINEST[channel]
    if elsewhere:
        spread = 1.4826 * float(np.median(np.abs(off[usable])))
        sigma = max(spread, FINEST[channel] * COARSE)
    against = log_evidence_of(off / sigma)
    usual = float(np.mean(against[usable])) if elsewhere else 1.0
    for a, b in runs_of(held):
        inside = (kin.first >= a) & (kin.first + kin.size < b)
        out[a:b] = float(np.sum(against[inside] - usual)) > SURE
    return out


def _voltage(log: FlownLog) -> list[Finding]:
    if not log.has("voltage_V"):
        return []
    measured = log["voltage_V"][np.isfinite(log["voltage_V"])]
    usual = float(np.median(measured)) if len(measured) else 0.0
    if not usual > MOST_V:
        return []
    why = f"{usual:.0f} V is no supply of a vehicle: millivolts would be {usual / 1000.0:.1f} V"
    return [("voltage_V", np.ones(log.rows, bool), why)]
