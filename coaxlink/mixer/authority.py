"""How far a table yaws a hovering vehicle with every motor well inside its range; doublets sized by it."""

from __future__ import annotations

import math

import numpy as np

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.errors import InputError
from coaxlink.mixer.fitted import FittedLaw
from coaxlink.vehicle import Vehicle
from firmware_params.errors import TableError

# of full speed: flights are judged between 0.1 and 0.98 (`rotor_update`); 0.05 are left for gusts
LOW, HIGH = 0.15, 0.93
# of that yaw: PX4's yaw loop overshoots a doublet's torque by up to 1.4 (stand-in, X8 in gusts), and a model
# before any flight has torques 15 % too large; 1.4 x 1.15 x 0.5 leaves a fifth for roll and pitch
SHARE = 0.5
MOST_DEG = 70.0  # of a doublet: a heading that any compass and estimator follows
EXACT = 1e-3  # of a yaw, where bisection ends


def yaw_authority(vehicle: Vehicle) -> float:
    """Largest yaw, N m to either side, that the fitted table flies in hover with speeds in LOW..HIGH.

    0 where hover itself is not within. Other tables for the same rotors yaw further (`coaxlink compare`).
    Raises InputError where the rotors cannot fly the vehicle.

    >>> from coaxlink.vehicle import load_vehicle
    >>> round(yaw_authority(load_vehicle("examples/x8_demo.toml", "examples/rotor_paper.toml")), 1)
    4.9
    """
    airframe = vehicle.airframe
    try:
        law = FittedLaw(vehicle)
    except (TableError, ValueError) as error:
        source = airframe.source or airframe.name
        raise InputError(source, "rotors", f"PX4 cannot hold its fitted table: {error}") from error
    weight = airframe.mass_kg * GRAVITY_M_S2

    def within(yaw: float) -> bool:
        speeds = [law.speeds([weight, 0.0, 0.0, way * yaw]) for way in (-1.0, 1.0)]
        return bool(np.min(speeds) >= LOW and np.max(speeds) <= HIGH)

    if not within(0.0):
        return 0.0
    arm = max(float(np.hypot(*r.position_m[:2])) for r in airframe.rotors)
    low, high = 0.0, weight * arm
    while high - low > EXACT * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if within(middle) else (low, middle)
    return low


def doublet_acceleration(vehicle: Vehicle) -> float:
    """Largest yaw acceleration, rad/s^2, that a doublet may demand of this vehicle. Raises InputError."""
    return SHARE * yaw_authority(vehicle) / float(vehicle.airframe.inertia_kg_m2[2])


def doublet_deg(acceleration_rad_s2: float, seconds: float, cycles: int) -> float:
    """Angle of a heading that goes to and fro `cycles` times in `seconds` along a cosine, degrees.

    The cosine's largest acceleration is half the angle times its rate squared.

    >>> round(doublet_deg(1.0, 12.0, 4), 1)
    26.1
    """
    rate = 2.0 * math.pi * cycles / seconds
    return min(MOST_DEG, math.degrees(2.0 * acceleration_rad_s2 / rate**2))
