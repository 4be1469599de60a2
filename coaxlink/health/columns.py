"""What a flight's residual may be made of: a linear model with priors, and each rotor's own loads in it.

What is explained is what was measured less what the model predicts, force down and three torques
(`channels`). What lasts from flight to flight (how this copy of the vehicle differs from the
drawing) is one set of unknowns; what may change overnight (pack, air, payload) is another for every flight.
Priors are physical: each has its source beside it. They are what keeps a payload strapped on askew from being
called a weak rotor.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from coaxlink.channels.flight import EDGE_S, JUDGED_RATE_HZ, reduce_columns
from coaxlink.channels.flight_corrections import flight_corrections
from coaxlink.constants import SIGMA_PER_MAD
from coaxlink.effects.ground_effect import GROUND_FELT_M
from coaxlink.evidence.blocks import Block
from coaxlink.frames import Array, FlightFrame
from coaxlink.health.accelerometer import USUAL_M_S2
from coaxlink.health.evidence import CHANNELS, Further, Rows, gained, together
from coaxlink.health.onsets import ONSET_ROUNDS, onsets, variants
from coaxlink.health.priors import (
    CG_DRAWN_M,
    CG_MOVED_M,
    DELAY_TODAY_S,
    DISTURBED,
    INERTIA_TODAY,
    LIFT_TODAY,
    LOSS_SD,
    TILT_ARM_M,
    TORQUE_TODAY,
)

VERTICAL_ZERO = "accel_z_bias_m_s2"
BOUND_SDS = 2.0  # a correction's largest believable size, in standard deviations
THRUST_SPECIMEN, TORQUE_SPECIMEN = 0.02, 0.03  # two propellers of one mould, Brandt and Selig 2011
THRUST_TODAY, TORQUE_TODAY_EACH = 0.01, 0.015  # of each rotor: dirt, a motor's heat, a propeller taken off
TRIM = 0.002  # of the reference torques: what no linear model of a vehicle's trim gets right
LEVEL_TODAY = 0.02  # of upper against lower rotors: voltage acts on both
VOLTAGE_SLOPE = 0.10  # of lift for a tenth of the voltage, less what LIFT_TODAY has
EVENT = 6.0  # robust standard deviations: one normal row in 5e8
MOST_EVENTS = 0.1  # of the rows
FINEST = 1e-6  # of the reference load: noise of a flight that has none
SMALL = 1e-3  # of a speed, for a derivative
PASSING = 0.02  # of the reference load: climb and speed in hover-like flight
WIND = 0.05  # of the reference load along an axis: rotors' drag and inflow in a wind of 5 m/s
# of the reference load for a tilt of 1: where rows fall in step with a slower loop, each finds the commands
# at the same moment of its kick, which their mean does not have (0.005 in PX4's loops in rows of 50 Hz)
LEANING = 0.01
# of the reference load a rad/s: a hub that turns climbs on one side (0.25 m, 0.5 N s/m a rotor)
DAMPING_S = 0.05


@dataclass(frozen=True, kw_only=True)
class Flight(Rows):
    """A flight whose rotors are judged; gains of each rotor's thrust, then torque, end what lasts."""

    yaw_push: Block  # a torque of weight x arm about yaw
    loads: Array  # (rows, 4, N, 3) what each rotor's loss adds: of thrust, of torque, of speed as thrust
    slowed: Array  # (2, N, N) share of its thrust, torque that each rotor gains by each that turns slower
    cutoff_hz: float  # of the rows' low-pass

    @property
    def seconds(self) -> float:
        """That are judged."""
        return len(self.target) / JUDGED_RATE_HZ


def lasting(frame: FlightFrame) -> Iterator[Block]:
    """What this vehicle differs by from its drawing, the same on every day."""
    for correction in flight_corrections(frame):
        if not correction.name.startswith("accel"):
            yield _block(frame, correction.name, correction.bound / BOUND_SDS, correction.columns)
    yield from _centre(frame, CG_DRAWN_M)
    yield _block(frame, "tilt_arm_m", TILT_ARM_M, _about(frame, 5))


def passing(frame: FlightFrame) -> Iterator[Block]:
    """What may be otherwise on another day."""
    none = np.zeros_like(frame.thrust)
    lift, drag = frame.airframe.body_loads(frame.thrust, none), frame.airframe.body_loads(none, frame.torque)
    yield _block(frame, "lift_today", LIFT_TODAY, lift)
    yield _block(frame, "torque_today", TORQUE_TODAY, drag)
    upper = np.array([1.0 if r.level == "upper" else 0.0 for r in frame.airframe.rotors])
    if 0 < upper.sum() < len(upper):
        yield _block(frame, "upper_today", LEVEL_TODAY, frame.airframe.body_loads(frame.thrust * upper, none))
    for k in range(len(upper)):
        one = np.eye(len(upper))[k]
        yield _block(frame, f"thrust_{k}", THRUST_TODAY, frame.airframe.body_loads(frame.thrust * one, none))
        yield _block(
            frame, f"torque_{k}", TORQUE_TODAY_EACH, frame.airframe.body_loads(none, frame.torque * one)
        )
    yield from _centre(frame, CG_MOVED_M)
    for correction in flight_corrections(frame):  # they are seen from the centre of mass
        if correction.name.startswith("imu_place"):
            yield _block(frame, correction.name, CG_MOVED_M, correction.columns)
        elif correction.name.startswith("inertia"):
            yield _block(frame, correction.name, INERTIA_TODAY, correction.columns)
        elif "delay" in correction.name:
            yield _block(frame, correction.name, DELAY_TODAY_S, correction.columns)
    for c in (3, 4, 5):
        yield _block(frame, f"trim_{c}", TRIM, _share(frame, c, np.ones(len(frame.time_s))))
    if frame.voltage is not None:
        volts = frame.voltage / float(np.median(frame.voltage[frame.keep])) - 1.0
        yield _block(frame, "voltage", 10.0 * VOLTAGE_SLOPE, lift * volts[:, None])
    yield _block(
        frame, VERTICAL_ZERO, USUAL_M_S2, frame.airframe.mass_kg * np.eye(6)[[2]] * np.ones_like(lift)
    )
    speeds = np.concatenate([frame.velocity, np.linalg.norm(frame.velocity, axis=1, keepdims=True)], axis=1)
    for k, axis in enumerate(("forward", "right", "down", "speed")):
        usual = max(float(np.sqrt(np.mean(speeds[frame.keep, k] ** 2))), 0.3)
        for c in CHANNELS:
            yield _block(frame, f"{axis}_{c}", PASSING, _share(frame, c, speeds[:, k] / usual))
    for c, k in ((2, 2), (3, 1), (4, 0)):
        for way, unit in (("north", frame.north), ("east", frame.east)):
            yield _block(frame, f"air_{way}_{c}", WIND, _share(frame, c, unit[:, k]))
    down = np.cross(frame.north, frame.east)
    for c, k in ((3, 1), (4, 0)):
        yield _block(frame, f"leaning_{c}", LEANING, _share(frame, c, down[:, k]))
    for c in (3, 4, 5):
        yield _block(frame, f"damping_{c}", DAMPING_S, _share(frame, c, frame.rates[:, c - 3]))
    if frame.height is not None and float(np.min(frame.height[frame.keep])) < GROUND_FELT_M:
        near = np.exp(-np.maximum(frame.height, 0.0) / 0.8)[:, None]  # He, Lee and Leang 2019
        yield _block(frame, "ground", 0.2, lift * near)


def _centre(frame: FlightFrame, sd: float) -> Iterator[Block]:
    """A centre of mass elsewhere: lift turns the body about it (Steiner's terms are second order)."""
    yield _block(frame, "cg_forward_m", sd, _about(frame, 4))
    yield _block(frame, "cg_right_m", sd, _about(frame, 3))


def _about(frame: FlightFrame, channel: int) -> Array:
    values = np.zeros_like(frame.predicted)
    values[:, channel] = -frame.predicted[:, 2]
    return values


def _share(frame: FlightFrame, channel: int, values: Array) -> Array:
    """(rows, 6) shares (rows,) of the reference load, in one channel."""
    out = np.zeros_like(frame.predicted)
    out[:, channel] = frame.reference[channel] * values
    return out


def reduced(frame: FlightFrame) -> Flight:
    """A frame as the rows of the linear model, with their noise; without events that are over at once."""
    flight, rest = changed_once(_flight(frame))
    if (out := passing_events(rest, flight.time_s)).any():
        flight, _ = changed_once(_flight(replace(frame, keep=frame.keep[~out])))
    return flight


def _flight(frame: FlightFrame) -> Flight:
    body, none = frame.airframe, np.zeros_like(frame.thrust)
    unit = np.eye(len(body.rotors))
    thrust = np.stack([body.body_loads(frame.thrust * e, none) for e in unit], axis=-1)
    torque = np.stack([body.body_loads(none, frame.torque * e) for e in unit], axis=-1)
    slower, slowed = _slower(frame)
    loads = rows_of(frame, np.stack([-thrust, -torque, slower], axis=-1))
    own = [
        Block("thrust", -loads[..., 0], np.full(len(unit), THRUST_SPECIMEN)),
        Block("torque", -loads[..., 1], np.full(len(unit), TORQUE_SPECIMEN)),
    ]
    push = _share(frame, 5, np.ones(len(frame.time_s)))
    push *= frame.reference[3] * np.sqrt(2.0) / frame.reference[5]  # weight x arm
    return Flight(
        target=rows_of(frame, (frame.measured - frame.predicted)[..., None])[:, :, 0],
        lasting=(*lasting(frame), *own),
        passing=tuple(passing(frame)),
        yaw_push=_block(frame, "yaw_push", DISTURBED, push),
        loads=loads,
        slowed=slowed,
        time_s=frame.time_s[frame.keep],
        cutoff_hz=frame.cutoff_hz,
        least=least_noise(frame),
    )


def _block(frame: FlightFrame, name: str, sd: float, values: Array) -> Block:
    """One unknown: its prior's standard deviation, and what a unit of it adds, (rows, 6) of the frame."""
    return Block(name, rows_of(frame, values[..., None]), np.array([sd]))


def changed_once(flight: Flight) -> tuple[Flight, Array]:
    """The flight with the noise that is left where every rotor may have lost anything and all change once,
    when that explains most; and (rows, 4) what is left.
    """
    free = flight.loads[..., :2].reshape(*flight.target.shape, -1)
    sd = np.full(free.shape[-1], LOSS_SD)
    lost = Block("lost", free, sd)
    flight = replace(flight.beside([lost])[0], together=1.0)  # what changes hangs together, and is no noise
    known = tuple(o for o in onsets(flight.time_s) if o.sudden)
    all_of_it = together([flight], {0: [lost]})
    for again in range(ONSET_ROUNDS + 1):
        profiles = np.stack([o.time_profile(flight.time_s, flight.cutoff_hz) for o in known])
        gains = gained(Further(flight, free[:, :, None], profiles).beside(all_of_it, 0), sd)[:, 0]
        best = int(np.argmax(gains))
        if again < ONSET_ROUNDS:
            known = variants(known, known[best])
    return flight.beside([lost, Block("changed", free * profiles[best][:, None, None], sd)])


def passing_events(rest: Array, time_s: Array) -> NDArray[np.bool_]:
    """(kept,) rows in and near what is over within a second: a touch, a jump of commands, a wrong lag.

    No row where there are more of them than events are: then noise has heavy tails.
    """
    usual = SIGMA_PER_MAD * np.median(np.abs(rest), axis=0) + 1e-300
    out = time_s[(np.abs(rest) > EVENT * usual).any(axis=1)]
    near = np.abs(time_s[:, None] - out).min(axis=1, initial=np.inf) <= EDGE_S
    return near if np.mean(near) < MOST_EVENTS else np.zeros(len(time_s), bool)


def _slower(frame: FlightFrame) -> tuple[Array, Array]:
    """(rows, 6, N) added by each motor that turns slower, for all of its thrust at the slope it begins with;
    (2, N, N) shares of thrust and torque that each rotor (rows) then has more, in the mean.

    The other rotor of its pair is loaded or unloaded as the model's own derivatives say.
    """
    columns, shares = [], []

    def mean(values: Array) -> Array:
        return np.asarray(values[frame.keep].mean(axis=0))

    for i in range(frame.speeds.shape[1]):
        speeds = frame.speeds.copy()
        speeds[:, i] *= 1.0 - SMALL
        slowed = frame.turning_at(speeds)
        lost = float(mean(frame.thrust - slowed.thrust)[i])
        whole = float(mean(frame.thrust)[i]) / lost if lost > 0.0 else 0.0
        columns.append(whole * (slowed.predicted - frame.predicted))
        both = ((frame.thrust, slowed.thrust), (frame.torque, slowed.torque))
        shares.append([whole * mean(now - own) / np.maximum(mean(own), 1e-12) for own, now in both])
    return np.stack(columns, axis=-1), np.moveaxis(np.array(shares), 0, -1)


def least_noise(frame: FlightFrame) -> Array:
    """(4,) what no channel's noise is below: the resolution of what is logged."""
    return FINEST * frame.reference[list(CHANNELS)]


def rows_of(frame: FlightFrame, columns: Array) -> Array:
    """(kept, 4, ...) judged rows of columns (rows, 6, ...), low-passed, the four channels."""
    return reduce_columns(frame, columns)[:, list(CHANNELS)]
