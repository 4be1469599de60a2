"""Small corrections of the nuisance that every explanation of a flight may use: what a stand and an IMU leave
open.

A rotor model from a stand is off by a per cent or two, an accelerometer has a bias, clocks differ by
milliseconds, inertia is an estimate. None of that is an effect, so all of it is fitted together with every
candidate, inside bounds. What these corrections can absorb is not reported.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from coaxlink.frames import Array, FlightFrame
from coaxlink.signals import derivative, low_pass

LEVEL = 0.03  # thrust and torque level of a stand-identified model
TILT = 0.03  # the same, growing with speed
WAKE = 0.03  # of the lower rotor's load, with the upper's speed
FORCE_DELAY_S = 0.012  # measured on real firmware: 5 to 8 ms
TORQUE_DELAY_S = 0.006  # measured: 2 ms
ACCEL_BIAS_M_S2 = (0.12, 0.12, 0.05)  # along the thrust its level absorbs a bias as well
INERTIA = 0.12  # of a declared one: drawings and pendulums err by a tenth
IMU_PLACE_M = 0.05
SLOW_HZ = 0.3  # a moment that lasts longer would turn the body over


@dataclass(frozen=True)
class Correction:
    """One column of the nuisance: its name, its largest believable coefficient, what a unit of it adds."""

    name: str
    bound: float
    columns: Array  # (rows, 6)


def flight_corrections(frame: FlightFrame) -> Iterator[Correction]:
    """All nuisance corrections of a flight, one at a time: a long log's do not fit side by side."""
    none = np.zeros_like(frame.thrust)
    airframe = frame.airframe
    middle = np.median(frame.speeds[frame.keep], axis=0)
    upper_of = {lower: upper for upper, lower in airframe.pairs}
    for level in ("upper", "lower", "single"):
        mask = np.array([r.level == level for r in airframe.rotors], float)
        if not mask.any():
            continue
        tilt = 2.0 * (frame.speeds - middle)
        for load in ("thrust", "torque"):
            nuisance = (frame.thrust if load == "thrust" else frame.torque) * mask

            def body(values: Array, load: str = load) -> Array:
                return (
                    airframe.body_loads(values, none)
                    if load == "thrust"
                    else airframe.body_loads(none, values)
                )

            yield Correction(f"{level}_{load}_level", LEVEL, body(nuisance))
            yield Correction(f"{level}_{load}_tilt", TILT, body(nuisance * tilt))
            if level == "lower":
                wake = np.zeros_like(nuisance)
                for lower, upper in upper_of.items():
                    wake[:, lower] = nuisance[:, lower] * tilt[:, upper]
                yield Correction(f"lower_{load}_wake", WAKE, body(wake))
    yield from _instruments(frame)


def lift_share(frame: FlightFrame, corrections: Mapping[str, float]) -> float:
    """What nuisance corrections (`flight_corrections`, by name) add to the lift, over the lift."""
    lift = np.median(frame.thrust[frame.keep], axis=0)
    level = np.array([corrections.get(f"{r.level}_thrust_level", 0.0) for r in frame.airframe.rotors])
    bias = -corrections.get("accel_z_bias_m_s2", 0.0) * frame.airframe.mass_kg / max(float(lift.sum()), 1e-9)
    return float(level @ lift / max(float(lift.sum()), 1e-9)) + bias


def lift_room(frame: FlightFrame) -> float:
    """What a rotor model may miss of the lift, a share of it.

    LEVEL, and two deviations of what the model left of its own stand log.
    """
    missed = [size for load, size in frame.model.missed.items() if load.unit == "N"]
    lift = float(np.median(frame.thrust[frame.keep].sum(axis=1)))
    pairs = max(len(frame.airframe.pairs), 1)
    return float(np.hypot(LEVEL, 2.0 * pairs * float(np.linalg.norm(missed)) / max(lift, 1e-9)))


def _moving(frame: FlightFrame, loads: Array) -> Array:
    """(rows, 3) moments without what is slower than SLOW_HZ: I dw/dt has no mean, over no few seconds."""
    return np.asarray(loads[:, 3:] - low_pass(loads[:, 3:], frame.rate_hz, SLOW_HZ))


def _aliased(frame: FlightFrame) -> Array:
    """(3,) share of the power of each predicted moment that the body did not follow, in the judged band.

    A log that holds a few of the many commands tells them with noise, and noise in a column is fitted away:
    the inertia seems smaller by about this share (errors in variables).
    """
    predicted, measured = (
        low_pass(_moving(frame, loads), frame.rate_hz, frame.cutoff_hz)[frame.keep]
        for loads in (frame.predicted, frame.measured)
    )
    power = np.maximum(np.sum(predicted**2, axis=0), 1e-300)
    return np.asarray(np.clip(1.0 - np.sum(predicted * measured, axis=0) / power, 0.0, 1.0))


def _instruments(frame: FlightFrame) -> Iterator[Correction]:
    rows, mass = len(frame.time_s), frame.airframe.mass_kg
    for k, axis in enumerate("xyz"):
        bias = np.zeros((rows, 6))
        bias[:, k] = mass
        yield Correction(f"accel_{axis}_bias_m_s2", ACCEL_BIAS_M_S2[k], bias)
    slope = derivative(frame.predicted, frame.rate_hz)
    for name, part, bound in (
        ("force_delay_s", slice(0, 3), FORCE_DELAY_S),
        ("torque_delay_s", slice(3, 6), TORQUE_DELAY_S),
    ):
        late = np.zeros((rows, 6))
        late[:, part] = -slope[:, part]
        # commands hold between rows, speeds are computed as if they ran straight: half a row of delay
        yield Correction(name, bound + 0.5 * frame.step_s, late)
    moving = _moving(frame, frame.predicted)
    aliased = _aliased(frame)
    for k, axis in enumerate("xyz"):
        share = np.zeros((rows, 6))
        share[:, 3 + k] = -moving[:, k]
        turned = frame.rates * np.eye(3)[k] * frame.airframe.inertia_kg_m2[k]
        share[:, 3:] -= np.cross(frame.rates, turned)  # of w x I w
        yield Correction(f"inertia_{axis}_share", float(np.hypot(INERTIA, 2.0 * aliased[k])), share)
    for k, axis in enumerate("xyz"):
        place = np.zeros((rows, 6))
        arm = np.eye(3)[k]
        turning, rates = frame.angular_acceleration, frame.rates
        place[:, :3] = mass * (np.cross(turning, arm) + np.cross(rates, np.cross(rates, arm)))
        yield Correction(f"imu_place_{axis}_m", IMU_PLACE_M, place)
