"""From flight samples to measured and predicted body force and torque.

Measured: mass times specific force, and I dw/dt + w x I w (rigid body, Euler). Predicted: the rotor model at
the commanded speeds after the declared first-order lag. Both sides go through the same zero-phase 4 Hz
low-pass; what an effect adds goes through it too. Rows on the ground are not judged: the ground pushes back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from coaxlink.airframe import Airframe
from coaxlink.channels.rounding import before_rounding
from coaxlink.channels.strapdown import smoothed_attitude, smoothed_height, smoothed_velocity
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.data.logs.flight import impossible_commands
from coaxlink.data.resolution import resolution_of
from coaxlink.data.samples import DAMAGED, PREMISES, Samples
from coaxlink.errors import InputError
from coaxlink.frames import IMU_COLUMNS, Array, FlightFrame
from coaxlink.rotor import RotorModel
from coaxlink.signals import derivative, difference_gain, lagged, low_pass, noise_floor

CUTOFF_HZ = 4.0
BAND = 0.2  # of the rows' rate: as much again lies above, where noise shows, and below half the rate
TOP_RATE_HZ = 60.0  # faster logs are thinned to about this rate: nothing above 4 Hz is judged
# rows of hours of flight (seconds, memory): beyond, half the rate does, then one stretch in so many is judged
MANY_ROWS, LONG_RATE_HZ, STRETCH_S = 60_000, 30.0, 120.0
LEAST_ROWS, LEAST_S = 40, 4.0  # of a gapless stretch
JUDGED_RATE_HZ = 10.0
JUMP, MOST_JUMPS = 10.0, 0.1  # times the usual doubt about commands between rows; share of rows left out
AFTER_S = 0.4  # not judged behind a jump
LIMIT, LIMIT_S, MOST_LIMITED = 0.002, 0.3, 0.15  # of full command; about it; of the time in the air
MATTERS = 1.0  # times the noise
COARSER = (2, 4)  # rows a row, to see what fewer rows cost
# of logs up to a rate (Hz): what halving the rows costs beside halving them twice, and the share of it that
# the rows as they are cost already
SHARES = (
    (45.0, (0.0,), (0.9,)),
    (90.0, (0.53, 0.65), (0.82, 0.53)),
    (np.inf, (0.0, 0.39, 0.57), (0.0, 0.38, 0.68)),
)
SUPPLY_HZ = 1.0  # a pack's voltage follows the load within a second; above is the sensor's noise
EDGE_S = 0.4  # the low-pass still feels what happened outside
NEEDED = (
    "time_s",
    *IMU_COLUMNS,
    "roll_rad",
    "pitch_rad",
    "yaw_rad",
    *(f"vel_{a}_m_s" for a in "ned"),
)
OPTIONAL = ("height_m", "voltage_V")


@dataclass(frozen=True)
class _Run:
    """Usable rows of one log, in the order of time and without a gap."""

    log: int
    rows: NDArray[np.intp]
    step_s: float

    def rows_at(self, top_hz: float) -> int:
        """How many rows stay at about this rate, at most."""
        return len(self.rows) // max(1, int(1.0 / self.step_s // top_hz))

    def pieces(self, seconds: float) -> list[_Run]:
        """The run in equal pieces of so many seconds or somewhat more; a shorter run is one piece."""
        count = max(1, int(len(self.rows) * self.step_s / seconds))
        return [replace(self, rows=rows) for rows in np.array_split(self.rows, count)]


@dataclass(frozen=True)
class _Stretch:
    """A gapless piece of one log on a uniform grid."""

    log: int
    rate_hz: float
    step_s: float
    columns: dict[str, Array]


def flown(logs: Sequence[Samples], airframe: Airframe, model: RotorModel) -> list[Samples]:
    """The logs, of a file of several stretches those that can be held against a model: a board that was only
    started leaves one on the ground. What is left out is reported in the `provenance` of the rest.

    Raises InputError where nothing of such a file can be.
    """
    kept: list[Samples] = []
    for provenance, group in groupby(logs, key=lambda log: log.provenance):
        stretches, problems = list(group), []
        if len(stretches) < 2 or not provenance:
            kept += stretches
            continue
        able = []
        for one in stretches:
            try:
                flight_frame([one], airframe, model)
                able.append(one)
            except InputError as error:
                problems.append(error)
        if not able:
            raise problems[0]
        reported = tuple(f"{error.source} is not judged: {error.problem}" for error in problems)
        kept += [replace(one, provenance=(*provenance, *reported)) for one in able]
    return kept


def flight_frame(logs: Sequence[Samples], airframe: Airframe, model: RotorModel) -> FlightFrame:
    """Bring logs onto uniform time bases and compute both sides of the residual.

    Raises InputError: a column is missing, the log's motors are not the airframe's, time does not run, or
    less than 8 s were flown.
    """
    motors = [f"motor{r.number}" for r in airframe.rotors]
    runs: list[_Run] = []
    for number, log in enumerate(logs):
        _same_motors(log, airframe)
        log.require(*NEEDED, *motors)
        runs += _gapless(number, log, [*NEEDED[1:], *motors], motors)
    source = logs[0].source if logs else ""
    if not runs:
        raise InputError(source, "time_s", "no gapless stretch of 4 s or more")
    top = TOP_RATE_HZ if sum(r.rows_at(TOP_RATE_HZ) for r in runs) <= MANY_ROWS else LONG_RATE_HZ
    runs, share = _some(runs, top)
    stretches = [_uniform(r, logs[r.log], motors, airframe, model, top) for r in runs]
    rate = min(s.rate_hz for s in stretches)
    stretches = [_at_rate(s, rate) for s in stretches]
    parts = [_side(i, s, airframe, motors) for i, s in enumerate(stretches)]
    shared = [name for name in parts[0] if all(name in p for p in parts)]
    joined = {name: np.concatenate([p[name] for p in parts]) for name in shared}
    thrust, torque = airframe.loads(model, joined["speeds"])
    predicted = airframe.body_loads(thrust, torque)
    keep, notes = _judged(joined, parts, stretches, -predicted[:, 2], airframe)
    if share > 1:
        notes.append(f"a long log: one stretch of {STRETCH_S:.0f} s in {share} is judged")
    jumps = airframe.body_loads(*airframe.loads(model, np.clip(joined["commands"], 0.0, None)))
    cutoff = min(CUTOFF_HZ, BAND * rate)
    keep = _steady(keep, (jumps, joined["measured"] - predicted), joined["stretch"], rate, cutoff, notes)
    if len(keep) < 8 * JUDGED_RATE_HZ:
        raise InputError(
            source,
            "height_m" if "height" in joined else "motor1",
            f"{len(keep) / JUDGED_RATE_HZ:.0f} s in the air; 8 s are needed",
        )
    frame = FlightFrame(
        airframe=airframe,
        model=model,
        rate_hz=rate,
        time_s=joined["time"],
        stretch=joined["stretch"],
        log=joined["log"],
        commands=joined["commands"],
        speeds=joined["speeds"],
        thrust=thrust,
        torque=torque,
        rates=joined["rates"],
        angular_acceleration=joined["turning"],
        specific_force=joined["specific_force"],
        attitude=joined["attitude"],
        velocity=joined["velocity"],
        north=joined["north"],
        east=joined["east"],
        height=joined.get("height"),
        voltage=joined.get("voltage"),
        predicted=predicted,
        measured=joined["measured"],
        keep=keep,
        cutoff_hz=cutoff,
        step_s=max(s.step_s for s in stretches),
        notes=tuple(notes),
        extra={"logged_attitude": joined["logged_attitude"]},
    )
    return replace(frame, sampling=_between_rows(frame, joined))


def _same_motors(log: Samples, airframe: Airframe) -> None:
    rotors = sorted(r.number for r in airframe.rotors)
    if log.motors and sorted(log.motors) != rotors:
        logged, known = (", ".join(map(str, numbers)) for numbers in (sorted(log.motors), rotors))
        why = "the file is another vehicle's, or it lacks rotors"
        if DAMAGED in log.premises:
            why = PREMISES[DAMAGED]
        problem = f"by the log's own parameters the vehicle has motors {logged}, by its file {known}"
        raise InputError(log.source, "motors", f"{problem}: {why}")


def _between_rows(frame: FlightFrame, joined: dict[str, Array]) -> Array:
    """(6,) error, low-passed, of loads whose commands are known at the log's rows only.

    With every second and every fourth row alone it is known. How it goes on depends on what moves commands:
    what comes from position and attitude grows by 1.6 for every doubled interval, what comes from the gyro
    ends at the loops' own filters (30 to 40 Hz). The ratio of the two tells which it is; the shares are
    those of flights without sensor noise, and with much of it, at every rate.
    """
    if any(f"every_{e}" not in joined for e in COARSER):
        return np.zeros(6)
    errors = []
    for every in COARSER:
        speeds = np.clip(frame.speeds + joined[f"every_{every}"], 0.0, None)
        changed = frame.airframe.body_loads(*frame.airframe.loads(frame.model, speeds)) - frame.predicted
        errors.append(np.sqrt(np.mean(reduce_columns(frame, changed) ** 2, axis=0)))
    second, fourth = errors
    ratios, shares = next((r, s) for rate, r, s in SHARES if 1.0 / frame.step_s < rate)
    return np.asarray(second * np.interp(second / np.maximum(fourth, 1e-12), ratios, shares))


def reduce_columns(frame: FlightFrame, columns: Array) -> Array:
    """Low-pass (rows, ...) stretch by stretch and keep the judged rows: (kept, ...)."""
    out = np.empty((len(frame.keep), *columns.shape[1:]))
    position = 0
    for number in np.unique(frame.stretch):
        rows = np.flatnonzero(frame.stretch == number)
        kept = frame.keep[(frame.keep >= rows[0]) & (frame.keep <= rows[-1])]
        if len(kept):
            piece = columns[rows[0] : rows[-1] + 1]
            if np.any(piece):
                piece = low_pass(piece, frame.rate_hz, frame.cutoff_hz)
            out[position : position + len(kept)] = piece[kept - rows[0]]
        position += len(kept)
    return out


def _gapless(number: int, log: Samples, names: list[str], motors: list[str]) -> list[_Run]:
    """The runs of a log's usable rows without a gap."""
    time = log["time_s"]
    finite = np.isfinite(time)
    order = np.flatnonzero(finite)
    back = np.flatnonzero(np.diff(time[order]) < 0.0)
    if len(back):  # a clock that was set, or a board that started again
        where = log.place(int(order[back[0] + 1]))
        problem = "time goes back: rows of two stretches are not one flight; give each as a log of its own"
        raise InputError(log.source, f"{where}, column time_s", problem)
    lost = {"time_s is no number": int((~finite).sum())}
    for name in names:
        known = np.isfinite(log[name])
        lost[f"{name} is no number"] = int((~known).sum())
        if name in motors:
            beyond = impossible_commands(log[name])
            lost[f"{name} is outside 0..1"] = int(beyond.sum())
            known &= ~beyond
        finite &= known
    order = order[finite[order]]
    usable = len(order)
    order = order[np.concatenate([[True], np.diff(time[order]) > 0])] if len(order) else order
    t = time[order]
    if len(t) < LEAST_ROWS:
        lost["time_s does not go on"] = usable - len(t)
        worst = sorted(((n, why) for why, n in lost.items() if n), reverse=True)[:3]
        taken = "".join(f"; in {n} {why}" for n, why in worst)
        problem = f"{len(t)} of {log.rows} rows can be used, {LEAST_ROWS} are needed{taken}"
        raise InputError(log.source, "rows", problem)
    step = float(np.median(np.diff(t)))
    cuts = np.flatnonzero(np.diff(t) > max(6.0 * step, 0.25)) + 1
    return [_Run(number, rows, step) for rows in np.split(order, cuts) if _lasts(time[rows])]


def _lasts(time_s: Array) -> bool:
    return len(time_s) >= LEAST_ROWS and float(time_s[-1] - time_s[0]) >= LEAST_S


def _some(runs: list[_Run], top_hz: float) -> tuple[list[_Run], int]:
    """One piece in so many that what is judged stays within MANY_ROWS, and this number."""
    share = -(-sum(r.rows_at(top_hz) for r in runs) // MANY_ROWS)
    if share < 2:
        return runs, 1
    return [piece for r in runs for piece in r.pieces(STRETCH_S)][::share], share


def _uniform(
    run: _Run, log: Samples, motors: list[str], airframe: Airframe, model: RotorModel, top_hz: float
) -> _Stretch:
    """A run on a uniform grid, with speeds behind the motors' lag, at most about this rate."""
    step, t, lag_s = run.step_s, log["time_s"][run.rows], airframe.motor_lag_s
    grid = np.arange(t[0], t[-1], step)
    columns = {"time_s": grid}
    for name in (*NEEDED[1:], *motors, *(name for name in OPTIONAL if log.has(name))):
        values = log[name][run.rows]
        good = np.isfinite(values)
        if not good.any():
            continue
        values = np.unwrap(values) if name in ("roll_rad", "yaw_rad") else values
        columns[name] = np.interp(grid, t[good], values[good])
    columns["given"] = np.stack([columns.pop(m) for m in motors], axis=1)
    steps = np.array([log.resolution.get(m, resolution_of(log[m])) for m in motors])
    commands = np.clip(before_rounding(columns["given"], steps), 0.0, 1.0)
    volts = columns.get("voltage_V")
    supply = volts if volts is None else low_pass(volts, 1.0 / step, min(SUPPLY_HZ, 0.4 / step))
    columns["commands"] = airframe.turned(model, commands, supply)
    columns["speeds"] = lagged(columns["commands"], step, lag_s)
    for every in COARSER:
        # what runs smoothly is no error of fewer rows: a spline passes it
        coarse = CubicSpline(grid[::every], columns["commands"][::every])(np.minimum(grid, grid[::every][-1]))
        columns[f"every_{every}"] = lagged(coarse, step, lag_s) - columns["speeds"]
    factor = int(1.0 / step // top_hz)
    if factor < 2:
        return _Stretch(run.log, 1.0 / step, step, columns)
    rate = 1.0 / step / factor
    columns = {  # by an integer factor after a zero-phase anti-alias filter
        name: (values if name == "time_s" else low_pass(values, 1.0 / step, 0.4 * rate))[::factor]
        for name, values in columns.items()
    }
    return _Stretch(run.log, rate, step, columns)


def _at_rate(piece: _Stretch, rate_hz: float) -> _Stretch:
    """The same piece on a grid of another, slower rate (several logs share one)."""
    if abs(piece.rate_hz / rate_hz - 1.0) < 1e-3:
        return piece
    t = piece.columns["time_s"]
    grid = np.arange(t[0], t[-1], 1.0 / rate_hz)
    columns = {}
    for name, values in piece.columns.items():
        flat = values.reshape(len(t), -1)
        columns[name] = np.stack([np.interp(grid, t, v) for v in flat.T], axis=-1).reshape(
            len(grid), *values.shape[1:]
        )
    columns["time_s"] = grid
    return _Stretch(piece.log, rate_hz, piece.step_s, columns)


def _side(number: int, piece: _Stretch, airframe: Airframe, motors: list[str]) -> dict[str, Array]:
    c = piece.columns
    rows = len(c["time_s"])
    rates = np.stack([c[f"gyro_{a}_rad_s"] for a in "xyz"], axis=1)
    smooth = low_pass(rates, piece.rate_hz, 3.0 * CUTOFF_HZ)
    turning = derivative(rates, piece.rate_hz)
    force = np.stack([c[f"accel_{a}_m_s2"] for a in "xyz"], axis=1)
    logged_attitude = np.stack([c["roll_rad"], c["pitch_rad"], c["yaw_rad"]], axis=1)
    attitude = smoothed_attitude(logged_attitude, rates, piece.rate_hz)
    world_to_body = _world_to_body(*attitude.T)
    velocity = np.stack([c[f"vel_{a}_m_s"] for a in "ned"], axis=1)
    to_world = world_to_body.transpose(0, 2, 1)
    velocity = smoothed_velocity(velocity, force, to_world, piece.rate_hz)
    inertia = np.asarray(airframe.inertia_kg_m2)
    moment = inertia * turning + np.cross(smooth, inertia * smooth)
    out = {
        "time": c["time_s"],
        "stretch": np.full(rows, float(number)),
        "log": np.full(rows, float(piece.log)),
        "given": c["given"],
        "commands": c["commands"],
        "speeds": np.clip(c["speeds"], 0.0, None),
        "rates": smooth,
        "turning": turning,
        "specific_force": force,
        "attitude": attitude,
        "velocity": np.einsum("rij,rj->ri", world_to_body, velocity),
        "logged_attitude": logged_attitude,
        "north": world_to_body[:, :, 0],
        "east": world_to_body[:, :, 1],
        "measured": np.concatenate([airframe.mass_kg * force, moment], axis=1),
    }
    out |= {name: values for name, values in c.items() if name.startswith("every_")}
    for name, key in (("height_m", "height"), ("voltage_V", "voltage")):
        if name in c:
            out[key] = c[name]
    if "height" in out:
        out["height"] = smoothed_height(out["height"], velocity[:, 2], piece.rate_hz)
    return out


def _steady(
    keep: np.ndarray, sides: tuple[Array, Array], stretch: Array, rate: float, cutoff: float, notes: list[str]
) -> np.ndarray:
    """Judged rows without those where commands jump so fast that the log's rows do not show what they did.

    A jump of D at an unknown time between two rows h apart is an impulse of D h / sqrt(12), one standard
    deviation; its two second differences tell of it. `sides` are loads (rows, 6) of the bare commands, and
    the residual, whose noise a doubt must match to count.
    """
    if not len(keep):
        return keep
    loads, residual = sides
    doubt, reduced = np.zeros(loads.shape), np.zeros(loads.shape)
    impulse = np.zeros((2 * int(EDGE_S * rate) + 1, 1))
    impulse[len(impulse) // 2] = 1.0
    reach = low_pass(impulse, rate, cutoff)[:, 0] ** 2
    for number in np.unique(stretch):
        rows = np.flatnonzero(stretch == number)
        bend = np.zeros((len(rows), loads.shape[1]))
        bend[1:-1] = np.diff(loads[rows], 2, axis=0) / np.sqrt(24.0)
        reduced[rows] = low_pass(residual[rows], rate, cutoff)
        for c in range(loads.shape[1]):
            doubt[rows, c] = np.convolve(bend[:, c] ** 2, reach, mode="same")[: len(rows)]
    doubt = doubt[keep]
    every = max(1, round(rate / JUDGED_RATE_HZ))
    runs = np.cumsum(np.diff(keep, prepend=keep[:1]) != every).astype(float)
    gain = [difference_gain(rate, cutoff, every, differentiated=c > 2) for c in range(loads.shape[1])]
    noise = noise_floor(reduced[keep], runs, np.array(gain))
    usual = np.maximum(JUMP * np.median(doubt, axis=0), (MATTERS * noise) ** 2)
    excess = np.max(doubt / np.maximum(usual, 1e-30), axis=1)
    sound = excess <= max(1.0, float(np.quantile(excess, 1.0 - MOST_JUMPS)))
    # behind a step of the commands the motors are on their way, by a law that no lag follows exactly
    steps = keep[excess > 1.0]
    last = steps[np.maximum(np.searchsorted(steps, keep, side="right") - 1, 0)] if len(steps) else keep + 1
    after = (keep >= last) & (keep - last <= AFTER_S * rate)
    if np.mean(after) < MOST_JUMPS:
        sound &= ~after
    out = keep[sound]
    if len(out) < len(keep):
        seconds = (len(keep) - len(out)) / JUDGED_RATE_HZ
        notes.append(f"{seconds:.1f} s not judged: commands jump there between two rows of the log")
    return out


def _world_to_body(roll: Array, pitch: Array, yaw: Array) -> Array:
    """(rows, 3, 3) rotation from NED to FRD for the angles yaw, pitch, roll (z, y, x)."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    return np.stack(
        [
            np.stack([cp * cy, cp * sy, -sp], axis=-1),
            np.stack([sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp], axis=-1),
            np.stack([cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp], axis=-1),
        ],
        axis=-2,
    )


def _judged(
    joined: dict[str, Array],
    parts: list[dict[str, Array]],
    stretches: list[_Stretch],
    lift: Array,
    airframe: Airframe,
) -> tuple[np.ndarray, list[str]]:
    """Rows in the air and away from every edge, thinned to about JUDGED_RATE_HZ."""
    flying = lift > 0.4 * airframe.mass_kg * GRAVITY_M_S2
    notes: list[str] = []
    if "height" in joined:
        idle = lift < 0.3 * airframe.mass_kg * GRAVITY_M_S2
        ground = (
            float(np.median(joined["height"][idle])) if idle.sum() > 5 else min(0.0, joined["height"].min())
        )
        moving = np.abs(joined["velocity"]).max(axis=1) > 0.05
        flying &= (joined["height"] > ground + 0.2) | (moving & (joined["height"] > ground + 0.15))
    else:
        notes.append("height_m is not in the log: rows on the ground are recognised by thrust alone")
    # when a command comes off its limit between two rows, the log does not say
    limited = ((joined["given"] <= LIMIT) | (joined["given"] >= 1.0 - LIMIT)).any(axis=1)
    near = np.convolve(limited, np.ones(2 * int(LIMIT_S * stretches[0].rate_hz) + 1), mode="same") > 0.5
    if 0 < np.sum(near & flying) < MOST_LIMITED * np.sum(flying):
        seconds = float(np.sum(near & flying)) / stretches[0].rate_hz
        notes.append(f"{seconds:.1f} s not judged: a command is at its limit")
    else:
        near = np.zeros_like(flying)
    keep: list[np.ndarray] = []
    start = 0
    for part, piece in zip(parts, stretches, strict=True):
        rows = len(part["time"])
        edge = int(np.ceil(EDGE_S * piece.rate_hz))
        every = max(1, round(piece.rate_hz / JUDGED_RATE_HZ))
        inside = flying[start : start + rows].copy()
        inside[:1] = inside[-1:] = False
        # shrink every run of flying rows by the edge
        blocked = np.convolve(~inside, np.ones(2 * edge + 1), mode="same") > 0.5
        blocked |= near[start : start + rows]
        keep.append(start + np.flatnonzero(~blocked & (np.arange(rows) % every == 0)))
        start += rows
    return np.concatenate(keep), notes
