"""Another mass than declared: the same force accelerates it differently, while the torques do not change.

Source: Newton's second law. The accelerometer times the declared mass reads F m_declared / m. A rotor model
that is off by the same few per cent looks alike in force: only what exceeds the stand's own doubt is a
mass. A payload that falls, or is taken up, shows by itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.onset import ONSET, since
from coaxlink.effects.parameter import Linear
from coaxlink.effects.static import StaticVehicle
from coaxlink.effects.tracing import Array, Tracing
from coaxlink.frames import FlightFrame


def _adds(frame: FlightFrame, p: Numbers) -> Array:
    out = np.zeros_like(frame.predicted)
    less = _lost(frame, p, p["mass_kg"])
    out[:, :3] = -frame.predicted[:, :3] * (less * since(frame, p))[:, None]
    return out


def _lost(frame: FlightFrame, _: Numbers, mass_kg: float) -> float:
    """Share of the declared mass's acceleration that this one does not have."""
    return 1.0 - frame.airframe.mass_kg / mass_kg


def _mass(frame: FlightFrame, _: Numbers, lost: float) -> float:
    return frame.airframe.mass_kg / max(1.0 - lost, 0.05)


FLIGHT: Tracing[FlightFrame] = Tracing(
    needs=("accel_z_m_s2",),
    channels=("force_x", "force_y", "force_z"),
    starts=lambda frame: [{"mass_kg": frame.airframe.mass_kg}],
    adds=_adds,
    cause=lambda frame, *_: ("total_thrust_N", frame.thrust.sum(axis=1)),
)


def _static(vehicle: StaticVehicle, p: Numbers) -> str:
    declared, vehicle.airframe = vehicle.airframe.mass_kg, replace(vehicle.airframe, mass_kg=p["mass_kg"])
    return f"{p['mass_kg']:.2f} kg instead of {declared:.2f}: hover thrust and envelope follow"


EFFECT = PhysicalEffect(
    name="mass_change",
    stage=Stage.BODY,
    place=2,
    physics="the vehicle weighs something else than declared",
    source="Newton's second law",
    parameters=(
        Parameter("mass_kg", "kg", 1e-3, 1e4, amount=Linear(_lost, _mass),
            nil=lambda frame: frame.airframe.mass_kg,
            source="wide: any value between the bounds; a payload may be any; bounded by what flies at all"),
        *ONSET,
    ),
    flight=FLIGHT,
    static=_static,
    required=("mass_kg",),
    no_live="no change of the rotors; the autopilot's hover thrust has to follow",
)  # fmt: skip
