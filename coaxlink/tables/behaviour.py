"""How a vehicle answers its autopilot: hover, ceiling, and what a unit of roll, pitch or yaw demand is worth.

The answer is the rotor model's, not the table's own belief, so two tables can be compared on one vehicle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.mixer.demands import Commands
from coaxlink.mixer.worth import STEP, TableOnRotors, reach, solve
from coaxlink.vehicle import Vehicle

TURNS = ("roll", "pitch", "yaw")


@dataclass(frozen=True)
class Behaviour:
    """A vehicle under one table."""

    hover: float | None  # thrust demand 0..1 that carries the weight; None when none does
    hover_speeds: tuple[float, ...]  # normalised; at demand 1 when there is no hover
    ceiling_N: float  # level thrust, the most of any demand
    gain_Nm: tuple[float, float, float]  # roll, pitch, yaw torque per unit demand, at hover
    authority_Nm: tuple[float, float, float]  # until a rotor is at its bound, at hover: `mixer.worth.reach`
    cross_N: float  # largest thrust change that a small torque demand brings, N per unit

    def gain_hint(self, reference: Behaviour) -> tuple[float, float, float]:
        """What to multiply the rate gains by so that the loop is as it was under `reference`."""
        pairs = zip(reference.gain_Nm, self.gain_Nm, strict=True)
        roll, pitch, yaw = (old / new if new else float("inf") for old, new in pairs)
        return roll, pitch, yaw

    def to_json(self) -> dict[str, Any]:
        """The key `rotor_model` of the JSON of `table`."""
        return {
            "hover": self.hover,
            "hover_speeds": list(self.hover_speeds),
            "ceiling_N": self.ceiling_N,
            "gain_Nm": list(self.gain_Nm),
            "authority_Nm": list(self.authority_Nm),
        }


def behaviour(vehicle: Vehicle, commands: Commands) -> Behaviour:
    """Fly a table by the rotor model, without an airframe in motion."""
    fly = TableOnRotors(vehicle, commands)
    hover = solve(fly.lift, vehicle.airframe.mass_kg * GRAVITY_M_S2)
    at = np.array([1.0 if hover is None else hover, 0.0, 0.0, 0.0])
    gain, authority, cross = [], [], []
    for axis in (1, 2, 3):
        unit = np.eye(4)[axis]
        slope = (fly.wrench(at + STEP * unit) - fly.wrench(at - STEP * unit)) / (2.0 * STEP)
        gain.append(float(slope[axis]))
        cross.append(abs(float(slope[0])))
        authority.append(reach(fly, float(at[0]), axis).moment_Nm)
    return Behaviour(
        hover,
        tuple(fly.speeds(at).tolist()),
        fly.ceiling(),
        (gain[0], gain[1], gain[2]),
        (authority[0], authority[1], authority[2]),
        max(cross),
    )
