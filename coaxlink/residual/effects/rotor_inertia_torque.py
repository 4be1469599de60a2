"""Rotor inertia: spinning a rotor up turns the body the other way, and turning the body tips the spin.

Source: balance of angular momentum with rotors of inertia J about their axes (Bouabdallah 2007, ch. 2):
M = -dH/dt - w x H, H = J sum(spin_i Omega_i axis_i).
"""

from __future__ import annotations

import numpy as np

from coaxlink.residual.effects.base import Array, Effect, Shape, one_shape, outside
from coaxlink.residual.frames import FlightFrame
from coaxlink.residual.signals import derivative


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


FLIGHT: Effect[FlightFrame] = Effect(
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
