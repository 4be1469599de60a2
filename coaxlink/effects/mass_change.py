"""Another mass than declared: the same force accelerates it differently, while the torques do not change.

Source: Newton's second law. The accelerometer times the declared mass reads F m_declared / m. A rotor model
that is off by the same few per cent looks alike in force: only what exceeds the stand's own doubt is a
mass. A payload that falls, or is taken up, shows by itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.onset import COMES, OVER, onset_limits, since
from coaxlink.effects.static import StaticVehicle
from coaxlink.effects.tracing import Array, Shape, Tracing, one_shape, outside, present
from coaxlink.frames import FlightFrame


def _columns(frame: FlightFrame, shape: Shape) -> Array:
    out = np.zeros((len(frame.predicted), 6, 1))
    out[:, :3, 0] = -frame.predicted[:, :3] * since(frame, shape)[:, None]
    return out


def _parameters(frame: FlightFrame, shape: Shape, c: Array) -> dict[str, float]:
    # m_declared / m = 1 - c
    return {"mass_kg": float(frame.airframe.mass_kg / max(1.0 - c[0], 0.05)), **shape}


def _inverse(frame: FlightFrame, p: Mapping[str, float]) -> tuple[Shape, Array]:
    shape = {k: v for k, v in p.items() if k in COMES}
    return shape, np.array([1.0 - frame.airframe.mass_kg / p["mass_kg"]])


FLIGHT: Tracing[FlightFrame] = Tracing(
    name="mass_change",
    physics="the vehicle weighs something else than declared",
    source="Newton's second law",
    needs=("accel_z_m_s2",),
    channels=("force_x", "force_y", "force_z"),
    units={"mass_kg": "kg", "onset_s": "s", "over_s": "s"},
    missing=present,
    shapes=one_shape,
    columns=_columns,
    parameters=_parameters,
    inverse=_inverse,
    refuse=lambda p: outside("mass_kg", p["mass_kg"], 1e-3, 1e4, "kg"),
    cause=lambda frame, _, channel: ("total_thrust_N", frame.thrust.sum(axis=1)),
    nil=lambda frame: {"mass_kg": frame.airframe.mass_kg},
    sudden=True,
    stage=9,
    free=onset_limits,
)


def _static(vehicle: StaticVehicle, p: Numbers) -> str:
    declared, vehicle.airframe = vehicle.airframe.mass_kg, replace(vehicle.airframe, mass_kg=p["mass_kg"])
    return f"{p['mass_kg']:.2f} kg instead of {declared:.2f}: hover thrust and envelope follow"


EFFECT = PhysicalEffect(
    name="mass_change",
    stage=Stage.BODY,
    parameters=(
        Parameter("mass_kg", "kg", 1e-3, 1e4,
            source="wide: any value between the bounds; a payload may be any; bounded by what flies at all"),
        Parameter("onset_s", "s", 0.0, 1e6,
            source="wide: any value between the bounds; the second of the log at which it began"),
        OVER,
    ),
    flight=FLIGHT,
    static=_static,
    required=("mass_kg",),
    no_live="no change of the rotors; the autopilot's hover thrust has to follow",
)  # fmt: skip
