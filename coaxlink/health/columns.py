"""What a flight's residual may be made of: a linear model with priors, and each rotor's own loads in it.

    y = X theta + rotors + noise,  theta ~ N(0, P)

y is what was measured less what the model predicts, force down and three torques (`residual.flight`). What
lasts from flight to flight (how this copy of the vehicle differs from the drawing) is one set of unknowns;
what may change overnight (pack, air, payload) is another for every flight. Priors are physical: each has its
source beside it. They are what keeps a payload strapped on askew from being called a weak rotor.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import SIGMA_PER_MAD
from coaxlink.effects.ground_effect import GROUND_FELT_M
from coaxlink.frames import Array, FlightFrame
from coaxlink.health.onsets import ROUNDS, Onset, onsets, variants
from coaxlink.health.priors import (
    CG_DRAWN_M,
    CG_MOVED_M,
    DELAY_TODAY_S,
    INERTIA_TODAY,
    LIFT_TODAY,
    TILT_ARM_M,
    TORQUE_TODAY,
)
from coaxlink.residual.channels.flight import JUDGED_RATE_HZ, reduce_columns
from coaxlink.residual.nuisance.flight_corrections import flight_corrections

CHANNELS = (2, 3, 4, 5)  # force down, roll, pitch, yaw
BOUND_SDS = 2.0  # a correction's largest believable size, in standard deviations
THRUST_SPECIMEN, TORQUE_SPECIMEN = 0.02, 0.03  # two propellers of one mould, Brandt and Selig 2011
THRUST_TODAY, TORQUE_TODAY_EACH = 0.01, 0.015  # of each rotor: dirt, a motor's heat, a propeller taken off
CG_PAYLOAD_M, INERTIA_PAYLOAD = 0.03, 0.1  # something else hangs there today
TRIM = 0.002  # of the reference torques: what no linear model of a vehicle's trim gets right
LEVEL_TODAY = 0.02  # of upper against lower rotors: voltage acts on both
VOLTAGE_SLOPE = 0.10  # of lift for a tenth of the voltage, less what LIFT_TODAY has
FREE = 0.2  # of a rotor's loads, where noise is what is left
EVENT = 6.0  # robust standard deviations: one normal row in 5e8
EVENT_S = 0.4  # so far the low-pass of the rows feels one
MOST_EVENTS = 0.1  # of the rows
LOUDER = 0.05  # of noise or of independent rows: less is not worth another look
SMALL = 1e-3  # of a speed, for a derivative
PASSING = 0.02  # of the reference load: climb and speed in hover-like flight
WIND = 0.05  # of the reference load along an axis: rotors' drag and inflow in a wind of 5 m/s
# of the reference load for a tilt of 1: where rows fall in step with a slower loop, each finds the commands
# at the same moment of its kick, which their mean does not have (0.005 in PX4's loops in rows of 50 Hz)
LEANING = 0.01
DAMPING_S = (
    0.05  # of the reference load a rad/s: a hub that turns climbs on one side (0.25 m, 0.5 N s/m a rotor)
)


@dataclass(frozen=True)
class NuisanceColumn:
    """One unknown: its name, its prior's standard deviation, what a unit of it adds."""

    name: str
    sd: float
    values: Array  # (rows, 6)


@dataclass(frozen=True)
class Flight:
    """One flight, reduced: rows are judged samples of the four channels, scaled by their noise."""

    y: Array  # (n,)
    lasting: Array  # (n, P)
    passing: Array  # (n, Q)
    thrust: Array  # (n, N) what a unit more of each rotor's thrust adds
    torque: Array  # (n, N)
    slower: Array  # (n, N) of a motor that turns slower, for all of its thrust at the slope it begins with
    yaw_push: Array  # (n,) a torque of weight x arm about yaw
    time_s: Array  # (n,)
    cutoff_hz: float  # of the rows' low-pass
    lasting_sd: Array  # (P,)
    passing_sd: Array  # (Q,)
    passing_names: tuple[str, ...]
    share: float  # of the rows that count as independent
    seconds: float
    noise: Array  # (4,) N, N m


def lasting(frame: FlightFrame) -> Iterator[NuisanceColumn]:
    """What this vehicle differs by from its drawing, the same on every day."""
    for correction in flight_corrections(frame):
        if not correction.name.startswith("accel"):
            yield NuisanceColumn(correction.name, correction.bound / BOUND_SDS, correction.columns)
    yield from _centre(frame, CG_DRAWN_M)
    yield NuisanceColumn("tilt_arm_m", TILT_ARM_M, _about(frame, 5))


def passing(frame: FlightFrame) -> Iterator[NuisanceColumn]:
    """What may be otherwise on another day."""
    none = np.zeros_like(frame.thrust)
    lift, drag = frame.airframe.body_loads(frame.thrust, none), frame.airframe.body_loads(none, frame.torque)
    yield NuisanceColumn("lift_today", LIFT_TODAY, lift)
    yield NuisanceColumn("torque_today", TORQUE_TODAY, drag)
    upper = np.array([1.0 if r.level == "upper" else 0.0 for r in frame.airframe.rotors])
    if 0 < upper.sum() < len(upper):
        yield NuisanceColumn(
            "upper_today", LEVEL_TODAY, frame.airframe.body_loads(frame.thrust * upper, none)
        )
    for k in range(len(upper)):
        one = np.eye(len(upper))[k]
        yield NuisanceColumn(f"thrust_{k}", THRUST_TODAY, frame.airframe.body_loads(frame.thrust * one, none))
        yield NuisanceColumn(
            f"torque_{k}", TORQUE_TODAY_EACH, frame.airframe.body_loads(none, frame.torque * one)
        )
    yield from _centre(frame, CG_MOVED_M)
    for correction in flight_corrections(frame):  # they are seen from the centre of mass
        if correction.name.startswith("imu_place"):
            yield NuisanceColumn(correction.name, CG_MOVED_M, correction.columns)
        elif correction.name.startswith("inertia"):
            yield NuisanceColumn(correction.name, INERTIA_TODAY, correction.columns)
        elif "delay" in correction.name:
            yield NuisanceColumn(correction.name, DELAY_TODAY_S, correction.columns)
    for c in (3, 4, 5):
        trim = np.zeros_like(frame.predicted)
        trim[:, c] = frame.reference[c]
        yield NuisanceColumn(f"trim_{c}", TRIM, trim)
    if frame.voltage is not None:
        volts = frame.voltage / float(np.median(frame.voltage[frame.keep])) - 1.0
        yield NuisanceColumn("voltage", 10.0 * VOLTAGE_SLOPE, lift * volts[:, None])
    bias = np.zeros_like(frame.predicted)
    bias[:, 2] = frame.airframe.mass_kg
    yield NuisanceColumn("accel_z_bias_m_s2", 0.05, bias)
    reference = frame.reference
    speeds = np.concatenate([frame.velocity, np.linalg.norm(frame.velocity, axis=1, keepdims=True)], axis=1)
    for k, axis in enumerate(("forward", "right", "down", "speed")):
        usual = max(float(np.sqrt(np.mean(speeds[frame.keep, k] ** 2))), 0.3)
        for c in CHANNELS:
            values = np.zeros_like(frame.predicted)
            values[:, c] = reference[c] * speeds[:, k] / usual
            yield NuisanceColumn(f"{axis}_{c}", PASSING, values)
    for c, k in ((2, 2), (3, 1), (4, 0)):
        for way, unit in (("north", frame.north), ("east", frame.east)):
            air = np.zeros_like(frame.predicted)
            air[:, c] = reference[c] * unit[:, k]
            yield NuisanceColumn(f"air_{way}_{c}", WIND, air)
    down = np.cross(frame.north, frame.east)
    for c, k in ((3, 1), (4, 0)):
        leaning = np.zeros_like(frame.predicted)
        leaning[:, c] = reference[c] * down[:, k]
        yield NuisanceColumn(f"leaning_{c}", LEANING, leaning)
    for c in (3, 4, 5):
        damping = np.zeros_like(frame.predicted)
        damping[:, c] = reference[c] * frame.rates[:, c - 3]
        yield NuisanceColumn(f"damping_{c}", DAMPING_S, damping)
    if frame.height is not None and float(np.min(frame.height[frame.keep])) < GROUND_FELT_M:
        near = np.exp(-np.maximum(frame.height, 0.0) / 0.8)[:, None]  # He, Lee and Leang 2019
        yield NuisanceColumn("ground", 0.2, lift * near)


def _centre(frame: FlightFrame, sd: float) -> Iterator[NuisanceColumn]:
    """A centre of mass elsewhere: lift turns the body about it (Steiner's terms are second order)."""
    yield NuisanceColumn("cg_forward_m", sd, _about(frame, 4))
    yield NuisanceColumn("cg_right_m", sd, _about(frame, 3))


def _about(frame: FlightFrame, channel: int) -> Array:
    values = np.zeros_like(frame.predicted)
    values[:, channel] = -frame.predicted[:, 2]
    return values


def reduced(frame: FlightFrame) -> Flight:
    """A frame as the rows of the linear model, whitened."""
    y = rows_of(frame, (frame.measured - frame.predicted)[..., None])[:, :, 0]  # (kept, 4)
    parts = [list(lasting(frame)), list(passing(frame))]
    stacked = [rows_of(frame, np.stack([c.values for c in part], axis=-1)) for part in parts]
    unit = np.eye(len(frame.airframe.rotors))
    thrust = np.stack([frame.airframe.body_loads(frame.thrust * e, 0 * frame.torque) for e in unit], axis=-1)
    torque = np.stack([frame.airframe.body_loads(0 * frame.thrust, frame.torque * e) for e in unit], axis=-1)
    rotors = [rows_of(frame, c) for c in (thrust, torque, _slower(frame))]
    push = np.zeros_like(frame.predicted)
    push[:, 5] = frame.reference[3] * np.sqrt(2.0)  # weight x arm
    rotors.append(rows_of(frame, push[..., None]))
    # noise is what not even free rotors and free corrections explain, changed once in the flight if need be
    everything = np.concatenate([*stacked, *rotors[:2]], axis=-1)
    sds = np.concatenate([*[[c.sd for c in part] for part in parts], np.full(2 * len(unit), FREE)])
    time = frame.time_s[frame.keep]
    rest = changed_once(y, everything, sds, 2 * len(unit), time, frame.cutoff_hz)
    steady = ~passing_events(rest, time)
    if not steady.all():
        y, time, everything = y[steady], time[steady], everything[steady]
        stacked, rotors = ([block[steady] for block in blocks] for blocks in (stacked, rotors))
        rest = changed_once(y, everything, sds, 2 * len(unit), time, frame.cutoff_hz)
    noise = np.maximum(np.sqrt(np.mean(rest**2, axis=0)), 1e-6 * frame.reference[list(CHANNELS)])
    scaled = noise[None, :, None]
    lasts, passes, thrusts, torques, slower, pushed = (
        np.asarray((block / scaled).reshape(-1, block.shape[-1])) for block in (*stacked, *rotors)
    )
    return Flight(
        np.asarray((y / noise).ravel()), lasts, passes, thrusts, torques, slower, pushed[:, 0],
        np.repeat(time, len(CHANNELS)), frame.cutoff_hz,
        np.array([c.sd for c in parts[0]]), np.array([c.sd for c in parts[1]]),
        tuple(c.name for c in parts[1]), independent(rest / noise),
        len(time) / JUDGED_RATE_HZ, noise,
    )  # fmt: skip


def passing_events(rest: Array, time_s: Array) -> NDArray[np.bool_]:
    """(kept,) rows in and near what is over within a second: a touch, a jump of commands, a wrong lag.

    No row where there are more of them than events are: then noise has heavy tails.
    """
    usual = SIGMA_PER_MAD * np.median(np.abs(rest), axis=0) + 1e-300
    out = time_s[(np.abs(rest) > EVENT * usual).any(axis=1)]
    if len(out) == 0:
        return np.zeros(len(time_s), bool)
    place = np.searchsorted(out, time_s)
    before, behind = (out[np.clip(place + k, 0, len(out) - 1)] for k in (-1, 0))
    near = np.minimum(np.abs(time_s - before), np.abs(time_s - behind)) <= EVENT_S
    return near if np.mean(near) < MOST_EVENTS else np.zeros(len(time_s), bool)


def louder(flight: Flight, rest: Array) -> Flight | None:
    """The flight with the noise that the likeliest hypothesis leaves; None where that is no more.

    `rest` (n,) in the flight's present noise. Where the model is not the vehicle's, free rotors and a change
    of all of them explain what no single hypothesis does, and noise is taken too small.
    """
    channels = rest.reshape(-1, len(CHANNELS))
    more = np.maximum(np.sqrt(np.mean(channels**2, axis=0)), 1.0)
    share = min(flight.share, independent(channels / more))
    if float(np.sum(np.log(more))) < LOUDER and share > (1.0 - LOUDER) * flight.share:
        return None
    scale = np.tile(more, len(channels))

    def less(values: Array) -> Array:
        return np.asarray((values.T / scale).T)

    return replace(
        flight, y=less(flight.y), lasting=less(flight.lasting), passing=less(flight.passing),
        thrust=less(flight.thrust), torque=less(flight.torque), slower=less(flight.slower),
        yaw_push=less(flight.yaw_push), share=share, noise=flight.noise * more,
    )  # fmt: skip


def _slower(frame: FlightFrame) -> Array:
    """(rows, 6, N) added by each motor that turns slower, for all of its thrust at the slope it begins with.

    The other rotor of its pair is loaded or unloaded as the model's own derivatives say.
    """
    columns = []
    for i in range(frame.speeds.shape[1]):
        speeds = frame.speeds.copy()
        speeds[:, i] *= 1.0 - SMALL
        slowed = frame.turning_at(speeds)
        lost = float(np.sum((frame.thrust - slowed.thrust)[frame.keep, i]))
        whole = float(np.sum(frame.thrust[frame.keep, i])) / lost if lost > 0.0 else 0.0
        columns.append(whole * (slowed.predicted - frame.predicted))
    return np.stack(columns, axis=-1)


def changed_once(y: Array, X: Array, sd: Array, last: int, time_s: Array, cutoff_hz: float) -> Array:
    """(kept, 4) residual of `left`, or of one whose `last` columns change once, where that explains most.

    A change counts where the likelihood's gain, for rows that go together, exceeds what so many more numbers
    cost (Schwarz 1978): what sets in within a flight is no noise.
    """
    rest = left(y, X, sd)
    scale = np.maximum(np.sqrt(np.mean(rest**2, axis=0)), 1e-300)
    flat = (X / scale[None, :, None]).reshape(-1, X.shape[-1])
    inverse = np.linalg.inv(flat.T @ flat + np.diag(sd**-2.0))
    off = (rest / scale).ravel()

    def explained(onset: Onset) -> float:
        own = flat[:, -last:] * np.repeat(onset.time_profile(time_s, cutoff_hz), y.shape[1])[:, None]
        cross = own.T @ flat
        information = own.T @ own + np.diag(sd[-last:] ** -2.0) - cross @ inverse @ cross.T
        pull = own.T @ off
        return float(pull @ np.linalg.solve(information, pull))

    known = tuple(o for o in onsets(time_s) if o.sudden)
    best = known[0]
    for again in range(ROUNDS + 1):
        best = known[int(np.argmax([explained(o) for o in known]))]
        if again < ROUNDS:
            known = tuple(
                o for o in variants(known, best) if abs(o.middle_s - best.middle_s) < 2.0 * best.width_s
            )
    own = X[..., -last:] * best.time_profile(time_s, cutoff_hz)[:, None, None]
    found = left(y, np.concatenate([X, own], axis=-1), np.concatenate([sd, sd[-last:]]))
    free = len(time_s) * independent(found / np.std(found, axis=0))
    price = 0.5 * (last + 1) * np.log(max(free, 1.0))
    return found if 0.5 * free * (_log_power(rest) - _log_power(found)) > price else rest


def _log_power(rest: Array) -> float:
    return float(np.sum(np.log(np.mean(rest**2, axis=0) + 1e-300)))


def rows_of(frame: FlightFrame, columns: Array) -> Array:
    """(kept, 4, ...) judged rows of columns (rows, 6, ...), low-passed, the four channels."""
    return reduce_columns(frame, columns)[:, list(CHANNELS)]


def ridge(y: Array, X: Array, sd: Array) -> Array:
    """(K,) of a ridge fit of (kept, 4) on (kept, 4, K), each channel's noise found as it goes."""
    scale = np.std(y, axis=0) + 1e-12
    theta = np.zeros(X.shape[-1])
    for _ in range(4):
        A = (X / scale[None, :, None]).reshape(-1, X.shape[-1])
        b = (y / scale).ravel()
        theta = np.linalg.solve(A.T @ A + np.diag(1 / sd**2), A.T @ b)
        scale = np.sqrt(np.mean((y - X @ theta) ** 2, axis=0)) + 1e-12
    return theta


def left(y: Array, X: Array, sd: Array) -> Array:
    """(kept, 4) residual of a ridge fit."""
    return np.asarray(y - X @ ridge(y, X, sd))


def independent(rest: Array) -> float:
    """Share of the rows that count: one over the residual's correlation time in rows (Priestley 1981, 5.3.2).

    The sum of autocorrelations up to the first that is chance, the largest over the channels.
    """
    n = len(rest)
    longest = 1.0
    for column in (rest - rest.mean(axis=0)).T:
        power = float(column @ column)
        total = 1.0
        for lag in range(1, n // 4):
            r = float(column[lag:] @ column[:-lag]) / max(power, 1e-300)
            if r < 2.0 / np.sqrt(n):
                break
            total += 2.0 * r
        longest = max(longest, total)
    return 1.0 / longest
