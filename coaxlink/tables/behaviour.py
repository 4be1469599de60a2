"""How a vehicle answers its autopilot: hover, ceiling, and what a unit of roll, pitch or yaw demand is worth.

The answer is the rotor model's, not the table's own belief, so two tables can be compared on one vehicle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.mixer.worth import STEP, Speeds, solve
from coaxlink.vehicle import Vehicle

__all__ = ["TURNS", "Behaviour", "Speeds", "behaviour", "solve"]

TURNS = ("roll", "pitch", "yaw")


@dataclass(frozen=True)
class Behaviour:
    """A vehicle under one table."""

    hover: float | None  # thrust demand 0..1 that carries the weight; None when none does
    hover_speeds: tuple[float, ...]  # normalised; at demand 1 when there is no hover
    ceiling_N: float  # thrust at demand 1
    gain_Nm: tuple[float, float, float]  # roll, pitch, yaw torque per unit demand, at hover
    authority_Nm: tuple[float, float, float]  # the smaller of what demand +1 and -1 bring, at hover
    cross_N: float  # largest thrust change that a small torque demand brings, N per unit

    def gain_hint(self, reference: Behaviour) -> tuple[float, float, float]:
        """What to multiply the rate gains by so that the loop is as it was under `reference`."""
        pairs = zip(reference.gain_Nm, self.gain_Nm, strict=True)
        roll, pitch, yaw = (old / new if new else float("inf") for old, new in pairs)
        return roll, pitch, yaw


def behaviour(vehicle: Vehicle, speeds: Speeds) -> Behaviour:
    """Fly a table by the rotor model, without an airframe in motion."""
    airframe, model = vehicle.airframe, vehicle.model

    def wrench(roll: float, pitch: float, yaw: float, thrust: float) -> NDArray[np.float64]:
        loads = airframe.loads(model, speeds(roll, pitch, yaw, thrust))
        result: NDArray[np.float64] = airframe.wrench(*loads)
        return result

    def lift(thrust: float) -> float:
        return float(wrench(0.0, 0.0, 0.0, thrust)[0])

    hover = solve(lift, airframe.mass_kg * GRAVITY_M_S2)
    at = 1.0 if hover is None else hover

    def turned(demand: NDArray[np.float64]) -> NDArray[np.float64]:
        return wrench(float(demand[0]), float(demand[1]), float(demand[2]), at)

    gain, authority, cross = [], [], 0.0
    for axis in range(3):
        unit = np.eye(3)[axis]
        high, low = turned(STEP * unit), turned(-STEP * unit)
        gain.append(float(high[axis + 1] - low[axis + 1]) / (2.0 * STEP))
        cross = max(cross, abs(float(high[0] - low[0])) / (2.0 * STEP))
        most, least = turned(unit)[axis + 1], turned(-unit)[axis + 1]
        authority.append(float(min(abs(most), abs(least))))
    return Behaviour(
        hover,
        tuple(float(u) for u in speeds(0.0, 0.0, 0.0, at)),
        lift(1.0),
        (gain[0], gain[1], gain[2]),
        (authority[0], authority[1], authority[2]),
        cross,
    )
