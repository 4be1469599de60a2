"""Rotor inertia: spinning a rotor up turns the body the other way, and turning the body tips the spin.

Source: balance of angular momentum with rotors of inertia J about their axes (Bouabdallah 2007, ch. 2):
M = -dH/dt - w x H, H = J sum(spin_i Omega_i axis_i).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coaxlink.constants import RAD_S_PER_RPM
from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.tracing import Array, NotShown, Tracing
from coaxlink.frames import FlightFrame, StandFrame
from coaxlink.load import Load
from coaxlink.signals import derivative

INERTIA = "rotor_inertia_kg_m2"
FAST_S = 0.3  # rows slower than that are settled


def _turning(frame: FlightFrame) -> Array:
    """(rows, N) rotor speeds, rad/s, counter-clockwise from above: right-handed about the upward axis."""
    spin = np.array([r.yaw_sign for r in frame.airframe.rotors], float)
    return np.asarray(frame.speeds * frame.model.speed_max_rpm * RAD_S_PER_RPM * spin)


def _flight_starts(frame: FlightFrame) -> Sequence[Numbers]:
    if not float(np.std(np.diff(frame.commands, axis=0))) > 1e-5:
        raise NotShown("the commands hardly move")
    return [{INERTIA: 1e-3}]


def _flight_adds(frame: FlightFrame, p: Numbers) -> Array:
    momentum = _turning(frame) @ np.array([r.axis for r in frame.airframe.rotors])
    out = np.zeros_like(frame.predicted)
    out[:, 3:] = -derivative(momentum, frame.rate_hz) - np.cross(frame.rates, momentum)
    return p[INERTIA] * out


FLIGHT: Tracing[FlightFrame] = Tracing(
    needs=("time_s", "motor1", "gyro_x_rad_s"),
    channels=("torque_x", "torque_y", "torque_z"),
    starts=_flight_starts,
    adds=_flight_adds,
    cause=lambda frame, *_: (
        "yaw_speed_rate_1_s",
        np.gradient(
            frame.speeds @ np.array([r.yaw_sign for r in frame.airframe.rotors], float), 1 / frame.rate_hz
        ),
    ),
)


def _starts(frame: StandFrame) -> Sequence[Numbers]:
    step = float(np.median(np.diff(frame.time_s))) if len(frame.time_s) > 2 else np.inf
    if frame.driven:
        raise NotShown("the log has no rpm: how fast the rotor speeds up is not known")
    if not 0.0 < step < FAST_S:
        raise NotShown(f"rows are {step:.1f} s apart: speeds do not change within them")
    return [{INERTIA: 1e-3}]


def _adds(frame: StandFrame, p: Numbers) -> Array:
    """Speeding a rotor up takes torque, which its cell reads too: J dOmega/dt."""
    step = float(np.median(np.diff(frame.time_s)))
    turning = np.gradient(frame.speeds, step, axis=0) * frame.model.speed_max_rpm * RAD_S_PER_RPM
    out = np.zeros((len(frame.time_s), 6))
    out[:, [Load.UPPER_TORQUE, Load.LOWER_TORQUE]] = p[INERTIA] * turning
    return out


STAND: Tracing[StandFrame] = Tracing(
    needs=("time_s", "upper_rpm"),
    channels=(Load.UPPER_TORQUE.channel, Load.LOWER_TORQUE.channel),
    starts=_starts,
    adds=_adds,
    cause=lambda frame, _, channel: (
        "speed_rate_1_s",
        np.gradient(frame.speeds[:, 1 if channel.startswith("lower") else 0], frame.time_s),
    ),
)


_BEFOREHAND = "the reaction lasts only while speeds change, and has to be known before it happens"
EFFECT = PhysicalEffect(
    name="rotor_inertia_torque",
    stage=Stage.BODY,
    physics="reaction to the rotors' angular momentum: M = -dH/dt - w x H",
    source="balance of angular momentum (Bouabdallah 2007)",
    parameters=(
        Parameter(INERTIA, "kg m2", 1e-8, 0.05, amount=True, nil=0.0,
            source="wide: any value between the bounds; m l^2 / 12 is 5e-6 for a 5 in propeller of 4 g, "
                   "0.013 for a 40 in one of 150 g"),
    ),
    flight=FLIGHT,
    stand=STAND,
    no_static=_BEFOREHAND,
    no_live=_BEFOREHAND,
)  # fmt: skip
