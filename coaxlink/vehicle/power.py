"""What rotors take: watts at the shafts, torque times speed; watts from the battery where measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coaxlink.constants import RAD_S_PER_RPM
from coaxlink.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]


def shaft_watts(vehicle: Vehicle, speeds: ArrayLike) -> Array:
    """(...) shaft watts of all rotors together at normalised speeds (..., N)."""
    u = np.asarray(speeds, float)
    torque = vehicle.airframe.loads(vehicle.model, u)[1]
    return np.asarray((torque * u).sum(axis=-1) * vehicle.model.speed_max_rpm * RAD_S_PER_RPM)


def battery_watts(vehicle: Vehicle, speeds: ArrayLike) -> Array:
    """(...) battery watts at normalised speeds (..., N); NaN where the stand measured no volts and amps."""
    u = np.asarray(speeds, float)
    powers = vehicle.model.battery_power
    if not powers:
        return np.full(u.shape[:-1], np.nan)
    torque = vehicle.airframe.loads(vehicle.model, u)[1]
    rad_s = u * (vehicle.model.speed_max_rpm * RAD_S_PER_RPM)
    total = np.zeros(u.shape[:-1])
    for i, rotor in enumerate(vehicle.airframe.rotors):
        side = powers["lower" if rotor.level == "lower" else "upper"]
        total = total + side.watts(rad_s[..., i], torque[..., i])
    return total
