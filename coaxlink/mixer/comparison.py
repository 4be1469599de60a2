"""All laws side by side on one vehicle: error per axis, power, authority and efficiency over an envelope.

Figure 7 of Berra, Trujillo and Heredia 2024, without the flight: what each mixer makes of a wrench if the
rotors are those of the model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import GRAVITY_M_S2, RAD_S_PER_RPM
from coaxlink.mixer.demands import law_commands
from coaxlink.mixer.law import Law
from coaxlink.mixer.worth import TableOnRotors, reach, solve
from coaxlink.vehicle import Vehicle


@dataclass(frozen=True)
class Row:
    """One law."""

    label: str
    mean_error: NDArray[np.float64]  # (4,) mean |delivered - demanded|, N and N m
    max_error: NDArray[np.float64]  # (4,)
    power: float  # mean sum of torque x speed
    efficiency_N_W: float  # thrust over shaft power, over the envelope
    ceiling_N: float  # level thrust, the most of any demand
    yaw_Nm: float  # in hover until the first rotor is at its bound: `worth.reach`; NaN without a hover

    def to_json(self) -> dict[str, Any]:
        """As `coaxlink compare --json` writes it."""
        return {
            "law": self.label,
            "mean_error": self.mean_error.tolist(),
            "max_error": self.max_error.tolist(),
            "power": self.power,
            "efficiency_N_W": self.efficiency_N_W if math.isfinite(self.efficiency_N_W) else None,
            "most_thrust_N": self.ceiling_N,
            "most_yaw_Nm": self.yaw_Nm if math.isfinite(self.yaw_Nm) else None,
        }


def compare(vehicle: Vehicle, laws: Sequence[tuple[str, Law]], wrenches: NDArray[np.float64]) -> list[Row]:
    """Weigh labelled laws on the vehicle over `wrenches` (rows, 4), N and N m."""
    return [_row(vehicle, label, law, wrenches) for label, law in laws]


def _row(vehicle: Vehicle, label: str, law: Law, wrenches: NDArray[np.float64]) -> Row:
    airframe, model = vehicle.airframe, vehicle.model
    weight = airframe.mass_kg * GRAVITY_M_S2

    def flown(demands: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        u = np.array([law.speeds(w) for w in demands])
        thrust, torque = airframe.loads(model, u)
        return airframe.wrench(thrust, torque), (torque * u).sum(axis=1)

    delivered, power = flown(wrenches)
    error = np.abs(delivered - wrenches)
    full = float(airframe.wrench(*airframe.loads(model, vehicle.full))[0])
    fly = TableOnRotors(
        vehicle, law_commands(law, vehicle, 2.0 * full)
    )  # a law that believes in more gets there
    hover = solve(fly.lift, weight)
    radians = model.speed_max_rpm * RAD_S_PER_RPM
    return Row(
        label,
        error.mean(axis=0),
        error.max(axis=0),
        float(power.mean()),
        float(delivered[:, 0].sum() / (power.sum() * radians)),
        fly.ceiling(),
        math.nan if hover is None else reach(fly, hover, 3).moment_Nm,
    )
