"""All laws side by side on one vehicle: error per axis, power, authority and efficiency over an envelope.

Figure 7 of Berra, Trujillo and Heredia 2024, without the flight: what each mixer makes of a wrench if the
rotors are those of the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import GRAVITY_M_S2, RAD_S_PER_RPM
from coaxlink.mixer.law import Law
from coaxlink.vehicle import Vehicle

THRUSTS = np.linspace(0.4, 1.8, 29)  # of the weight, for the curve


@dataclass(frozen=True)
class Row:
    """One law."""

    label: str
    mean_error: NDArray[np.float64]  # (4,) mean |delivered - demanded|, N and N m
    max_error: NDArray[np.float64]  # (4,)
    power: float  # mean sum of torque x speed
    efficiency_N_W: float  # thrust over shaft power, over the envelope
    most_thrust_N: float  # delivered level, at any demand
    most_yaw_Nm: float  # delivered around hover, thrust kept within 2 % of the hover's
    thrust_error_N: NDArray[np.float64]  # (len(THRUSTS),) in level flight

    def to_json(self) -> dict[str, Any]:
        """As `coaxlink compare --json` writes it."""
        return {
            "law": self.label,
            "mean_error": self.mean_error.tolist(),
            "max_error": self.max_error.tolist(),
            "power": self.power,
            "efficiency_N_W": self.efficiency_N_W,
            "most_thrust_N": self.most_thrust_N,
            "most_yaw_Nm": self.most_yaw_Nm,
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
    level = np.zeros((len(THRUSTS), 4))
    level[:, 0] = THRUSTS * weight
    lifted = flown(level)[0][:, 0]
    rising = np.zeros((24, 4))
    rising[:, 0] = np.linspace(1.0, 3.5, 24) * weight
    yaws = np.zeros((33, 4))
    yaws[:, 0], yaws[:, 3] = weight, np.linspace(0.0, 32.0, 33) * weight * 1.6e-3
    turned = flown(yaws)[0]
    on_thrust = np.abs(turned[:, 0] - turned[0, 0]) < 0.02 * weight
    radians = model.speed_max_rpm * RAD_S_PER_RPM
    return Row(
        label,
        error.mean(axis=0),
        error.max(axis=0),
        float(power.mean()),
        float(delivered[:, 0].sum() / (power.sum() * radians)),
        float(max(flown(rising)[0][:, 0].max(), lifted.max())),
        float(turned[on_thrust, 3].max()),
        lifted - level[:, 0],
    )
