"""Flight data that cannot be what their labels say: stuck or reversed sensors, repeats, swapped motors.

Found before anything is fitted; the rows are left out, or, where every row is concerned, nothing is claimed.
Each way in which columns may lie is a state of a hidden Markov chain over the windows of a flight: it undoes
one fault (another scale, unit or sign, labels exchanged), and counts by how much nearer the columns then are
to what the others make of them (`kinematics`). What repeats digit by digit is told by that alone, or, where
the column is coarse, with what it should have read.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from coaxlink.data.logs.flight import MOTOR
from coaxlink.data.resolution import is_coarse, resolution_of
from coaxlink.data.samples import Samples
from coaxlink.frames import IMU_COLUMNS, Array, FlightFrame
from coaxlink.residual.channels.flight import reduce_columns
from coaxlink.residual.faults.apart import rounded
from coaxlink.residual.faults.chain import settled
from coaxlink.residual.faults.kinematics import (
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
    flying_rows,
    independent,
    kinematics_of,
    linear_of,
    noise_of,
    step_of,
)
from coaxlink.residual.faults.reference import BEGINS, SURE, log_evidence_of
from coaxlink.residual.faults.repeats import copied_rows, held_runs, is_fine, limits_of
from coaxlink.residual.faults.response import response_faults
from coaxlink.residual.faults.silent_speeds import STUCK_S
from coaxlink.residual.faults.states import WHOLE, Finding, Mask, runs_of
from coaxlink.residual.held_out import Index
from coaxlink.residual.result import Suspect

# priors: name = value  # unit, source
WORKS = 0.5  # of the least mean command of the rotors, and of their rise: judgement; unused outputs rest
LINEAR, STEP = 0.5, 1e-3  # of a command's variance: judgement; 1 us of PWM's 1000
MOST_V = 1500.0  # judgement: packs of multirotors have 60 V, of air taxis 800 V
SWAP = 0.1  # of the torque's squares left with two motors exchanged
# times what the exchange leaves: one failing rotor, or a centre of mass, that leaves less explains as much
FAILS, PIECES = 3.0, 8  # and parts of the flight, each of which has to bear it out
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


def rotor_faults(frame: FlightFrame) -> list[Suspect]:
    """Labels and clocks that the rotors contradict: two motors exchanged, an answer at another time."""
    return [*_swapped(frame), *response_faults(frame)]


def column_faults(log: Samples) -> list[Finding]:
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


def _rounded(log: Samples) -> Iterator[Finding]:
    """The axis of a sensor that moves in far larger steps than its others."""
    flying = flying_rows(log)
    for names, finest in ((ACCEL, FINEST[0]), (GYRO, FINEST[3]), (VELOCITY, FINEST[0])):
        values = np.stack([log[name] for name in names], axis=1)
        if coarse := rounded(names, values, flying, matters=float(finest)):
            name, step, others = coarse
            why = f"it moves in steps of {step:.2g}, its other axes in {others:.1g}: rounded"
            yield name, np.ones(log.rows, bool), why


def _held(log: Samples) -> dict[str, Mask]:
    """Rows of a column in which one reading repeats for so long that it is no accident, in flight."""
    flying, least = flying_rows(log), STUCK_S / max(step_of(log), 1e-9)
    out: dict[str, Mask] = {}
    for name, values in log.columns.items():
        if name not in COLUMNS:
            continue
        rows = np.zeros(log.rows, bool)
        for a, b in held_runs(values, least):
            rows[a:b] = flying[a:b].mean() > 0.5
        if rows.any():
            out[name] = rows
    return out


def _fine_around(log: Samples, name: str, held: Mask) -> Mask:
    """(rows,) held runs around which, as many rows on either side, the column moves by more than its steps.

    An estimator's velocity of 1 cm/s resolution is fine in fast flight and stands still with a vehicle that
    hardly moves: one that moves by its steps there is held against the others.
    """
    out = np.zeros_like(held)
    if not _is_fine(log, name):
        return out
    values, step = log[name], log.resolution.get(name, resolution_of(log[name]))
    for a, b in runs_of(held):
        out[a:b] = is_fine(values[max(2 * a - b, 0) : 2 * b - a], step)
    return out


def _is_fine(log: Samples, name: str) -> bool:
    """Whether a column does not repeat for its resolution; one that never moves has its neighbours'."""
    family = next((f for f in (ACCEL, GYRO, VELOCITY) if name in f), ())
    if not family:
        return False  # angles and heights may stand still with the vehicle
    steps = {n: log.resolution.get(n, resolution_of(log[n])) for n in family}
    if np.isfinite(steps[name]):
        return is_fine(log[name], steps[name])
    least = min((s for s in steps.values() if np.isfinite(s)), default=np.nan)
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


def motors_too_many(log: Samples, rotors: set[int]) -> list[Finding]:
    """Motors that work as the others do, of other numbers than the airframe's rotors."""
    numbers = sorted(int(found[1]) for n in log.columns if (found := MOTOR.fullmatch(n)))
    flown = flying_rows(log)
    commands = {n: np.clip(np.nan_to_num(log[f"motor{n}"][flown]), 0.0, 1.0) for n in numbers}
    known = [commands[n] for n in numbers if n in rotors]
    least = min((float(u.sum()) for u in known), default=0.0)
    more = [
        n
        for n in numbers
        if n not in rotors and float(commands[n].sum()) > WORKS * least > 0.0 and _mixed(commands[n], known)
    ]
    if not more:
        return []
    names = ", ".join(f"motor{n}" for n in more)
    why = f"the airframe has {len(rotors)} rotors, and these work as theirs do: it is another vehicle's file"
    return [(names, np.ones(log.rows, bool), why)]


def _mixed(command: Array, known: list[Array]) -> bool:
    """Whether a command (rows,) is of the same mixer: linear in the known motors', and rises where all do.

    Four demands move them all, and thrust moves all alike. A gripper or a landing gear rests where it was
    put; a gimbal goes along with tilt, and not with thrust.
    """
    free = len(command) - len(known) - 1
    spread = float(np.var(command))
    if free <= 0 or spread <= STEP**2:
        return False
    columns = np.stack([np.ones(len(command)), *known], axis=1)
    slopes = np.linalg.lstsq(columns, command, rcond=None)[0]
    left = command - columns @ slopes
    return float(left @ left) < (1.0 - LINEAR) * free * spread and float(slopes[1:].sum()) > WORKS


def _voltage(log: Samples) -> list[Finding]:
    if not log.has("voltage_V"):
        return []
    measured = log["voltage_V"][np.isfinite(log["voltage_V"])]
    usual = float(np.median(measured)) if len(measured) else 0.0
    if not usual > MOST_V:
        return []
    why = f"{usual:.0f} V is no supply of a vehicle: millivolts would be {usual / 1000.0:.1f} V"
    return [("voltage_V", np.ones(log.rows, bool), why)]


def _one_fails(frame: FlightFrame, measured: Array, scale: Array) -> float:
    """What is left of the torques (kept, 3), over `scale`, if one rotor lost some of its loads."""
    at = replace(frame, keep=np.arange(len(measured))).turning_at(
        np.clip(reduce_columns(frame, frame.speeds), 0.0, None)
    )
    misfit = measured - at.predicted[:, 3:] / scale
    least = np.inf
    for k in range(at.thrust.shape[1]):
        only = np.eye(at.thrust.shape[1])[k]
        none = np.zeros_like(at.thrust)
        lost = [
            at.airframe.body_loads(at.thrust * only, none),
            at.airframe.body_loads(none, at.torque * only),
        ]
        columns = np.stack([(x[:, 3:] / scale).ravel() for x in lost], axis=1)
        fit = np.linalg.lstsq(columns, misfit.ravel(), rcond=None)[0]
        least = min(least, float(np.mean((misfit.ravel() - columns @ fit) ** 2)))
    return least


def off_centre(frame: FlightFrame, measured: Array, scale: Array) -> float:
    """What is left of the torques (kept, 3), over `scale`, with the centre of mass at its best."""
    loads = reduce_columns(frame, frame.predicted)
    none = np.zeros(len(loads))
    along = np.stack([none, -loads[:, 2], loads[:, 1]], axis=1)  # e_x x F
    aside = np.stack([loads[:, 2], none, -loads[:, 0]], axis=1)  # e_y x F
    columns = np.stack([(x / scale).ravel() for x in (along, aside)], axis=1)
    misfit = (measured - loads[:, 3:] / scale).ravel()
    fit = np.linalg.lstsq(columns, misfit, rcond=None)[0]
    return float(np.mean((misfit - columns @ fit) ** 2))


def _swapped(frame: FlightFrame) -> list[Suspect]:
    """Two motors whose commands explain the torques only when exchanged."""
    speeds = np.clip(reduce_columns(frame, frame.speeds), 0.0, None)
    measured = reduce_columns(frame, frame.measured)[:, 3:]
    scale = np.std(measured, axis=0) + 1e-9

    def left(order: list[int]) -> Array:
        loads = frame.airframe.body_loads(*frame.airframe.loads(frame.model, speeds[:, order]))
        return np.asarray(np.mean(((measured - loads[:, 3:]) / scale) ** 2, axis=1))

    count = speeds.shape[1]
    labelled = left(list(range(count)))
    exchanged, pair = labelled, (0, 0)
    for i, j in combinations(range(count), 2):
        order = list(range(count))
        order[i], order[j] = j, i
        now = left(order)
        if now.mean() < exchanged.mean():
            exchanged, pair = now, (i, j)
    as_labelled, best = float(labelled.mean()), float(exchanged.mean())
    if best > SWAP * as_labelled or as_labelled < 0.05:
        return []
    # cables are exchanged from the first row on; what fits as it is labelled for a while began in mid-flight
    pieces = zip(np.array_split(labelled, PIECES), np.array_split(exchanged, PIECES), strict=True)
    if any(FAILS * a.mean() < b.mean() for a, b in pieces):
        return []
    if min(rival(frame, measured / scale, scale) for rival in (_one_fails, off_centre)) < FAILS * best:
        return []
    closer = np.sqrt(as_labelled / best)
    why = f"with the two exchanged the torques fit {closer:.0f} times closer: they are swapped"
    return [Suspect(f"motor{pair[0] + 1}, motor{pair[1] + 1}", "all", why)]
