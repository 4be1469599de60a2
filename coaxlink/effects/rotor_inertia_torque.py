"""Rotor inertia: spinning a rotor up turns the body the other way, and turning the body tips the spin.

Source: balance of angular momentum with rotors of inertia J about their axes (Bouabdallah 2007, ch. 2):
M = -dH/dt - w x H, H = J sum(spin_i Omega_i axis_i).
"""

from __future__ import annotations

import numpy as np

from coaxlink.constants import RAD_S_PER_RPM
from coaxlink.effects.base import Parameter, PhysicalEffect, Stage
from coaxlink.effects.tracing import Array, Shape, Tracing, one_shape, outside
from coaxlink.frames import FlightFrame, StandFrame
from coaxlink.load import Load
from coaxlink.signals import derivative


def _columns(frame: FlightFrame, _: Shape) -> Array:
    omega = frame.speeds * frame.model.speed_max_rpm * 2.0 * np.pi / 60.0
    spin = np.array([r.yaw_sign for r in frame.airframe.rotors], float)
    axis = np.array([r.axis for r in frame.airframe.rotors])
    # counter-clockwise from above is a right-handed turn about the upward thrust axis
    momentum = (omega * spin) @ axis
    rate = derivative(momentum, frame.rate_hz)
    out = np.zeros((len(omega), 6))
    out[:, 3:] = -rate - np.cross(frame.rates, momentum)
    return out[..., None]


def _missing(frame: FlightFrame) -> str | None:
    return None if float(np.std(np.diff(frame.commands, axis=0))) > 1e-5 else "the commands hardly move"


FLIGHT: Tracing[FlightFrame] = Tracing(
    name="rotor_inertia_torque",
    physics="reaction to the rotors' angular momentum: M = -dH/dt - w x H",
    source="balance of angular momentum (Bouabdallah 2007)",
    needs=("time_s", "motor1", "gyro_x_rad_s"),
    channels=("torque_x", "torque_y", "torque_z"),
    units={"rotor_inertia_kg_m2": "kg m2"},
    missing=_missing,
    shapes=one_shape,
    columns=_columns,
    parameters=lambda _, __, c: {"rotor_inertia_kg_m2": float(c[0])},
    inverse=lambda _, p: ({}, np.array([p["rotor_inertia_kg_m2"]])),
    refuse=lambda p: outside("rotor_inertia_kg_m2", p["rotor_inertia_kg_m2"], 1e-7, 0.05, "kg m2"),
    cause=lambda frame, _, channel: (
        "yaw_speed_rate_1_s",
        np.gradient(
            frame.speeds @ np.array([r.yaw_sign for r in frame.airframe.rotors], float), 1 / frame.rate_hz
        ),
    ),
    nil=lambda _: {"rotor_inertia_kg_m2": 0.0},
    stage=7,
)

FAST_S = 0.3  # rows slower than that are settled


def _reaction(frame: StandFrame, shape: Shape) -> Array:
    step = float(np.median(np.diff(frame.time_s)))
    turning = np.gradient(frame.speeds, step, axis=0) * frame.model.speed_max_rpm * RAD_S_PER_RPM
    out = np.zeros((len(frame.time_s), 6, 1))
    out[:, Load.UPPER_TORQUE, 0], out[:, Load.LOWER_TORQUE, 0] = turning[:, 0], turning[:, 1]
    return out


def _slow(frame: StandFrame) -> str | None:
    step = float(np.median(np.diff(frame.time_s))) if len(frame.time_s) > 2 else np.inf
    if frame.driven:
        return "the log has no rpm: how fast the rotor speeds up is not known"
    return None if 0.0 < step < FAST_S else f"rows are {step:.1f} s apart: speeds do not change within them"


STAND: Tracing[StandFrame] = Tracing(
    name="rotor_inertia_torque",
    stage=7,
    physics="speeding the rotor up takes torque, which the torque cell reads too: J dOmega/dt",
    source="balance of angular momentum (Bouabdallah 2007)",
    needs=("time_s", "upper_rpm"),
    channels=(Load.UPPER_TORQUE.channel, Load.LOWER_TORQUE.channel),
    units={"rotor_inertia_kg_m2": "kg m2"},
    missing=_slow,
    shapes=lambda _: [{}],
    columns=_reaction,
    parameters=lambda _, __, c: {"rotor_inertia_kg_m2": float(c[0])},
    inverse=lambda _, p: ({}, np.array([p["rotor_inertia_kg_m2"]])),
    refuse=lambda p: outside("rotor_inertia_kg_m2", p["rotor_inertia_kg_m2"], 1e-8, 0.05, "kg m2"),
    cause=lambda frame, _, channel: (
        "speed_rate_1_s",
        np.gradient(frame.speeds[:, 1 if channel.startswith("lower") else 0], frame.time_s),
    ),
)


_BEFOREHAND = "the reaction lasts only while speeds change, and has to be known before it happens"
EFFECT = PhysicalEffect(
    name="rotor_inertia_torque",
    stage=Stage.BODY,
    parameters=(
        Parameter("rotor_inertia_kg_m2", "kg m2", 1e-8, 0.05,
            source="wide: any value between the bounds; m l^2 / 12 is 5e-6 for a 5 in propeller of 4 g, "
                   "0.013 for a 40 in one of 150 g"),
    ),
    flight=FLIGHT,
    stand=STAND,
    no_static=_BEFOREHAND,
    no_live=_BEFOREHAND,
)  # fmt: skip
