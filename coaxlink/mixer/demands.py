"""What is demanded of a vehicle: wrenches over an envelope, and an autopilot's demands as wrenches."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import Airframe
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.mixer.law import Law
from coaxlink.vehicle import Vehicle

# (roll, pitch, yaw -1..1, thrust up 0..1) -> motor commands (N,), 0..1
Commands = Callable[[float, float, float, float], NDArray[np.float64]]

ENVELOPE = (0.765, 1.326)  # thrusts, of the weight: 150 to 260 N of the paper's vehicle


def weight_arm(airframe: Airframe) -> float:
    """Weight x longest arm, N m: what moments are measured by."""
    arm = max(float(np.hypot(*r.position_m[:2])) for r in airframe.rotors)
    return airframe.mass_kg * GRAVITY_M_S2 * arm


def envelope(airframe: Airframe, rows: int = 150, seed: int = 1) -> NDArray[np.float64]:
    """(rows, 4) wrenches a vehicle meets: 0.76 to 1.32 of its weight with roll, pitch and yaw.

    Roll and pitch of up to 8 % of weight x arm, yaw up to 2 % of it: on the paper's vehicle 150 to 260 N,
    +-4 and +-1 N m.
    """
    weight = airframe.mass_kg * GRAVITY_M_S2
    turn = weight_arm(airframe) * 4.0 / (196.133 * 0.25555)
    low = np.array([ENVELOPE[0] * weight, -turn, -turn, -0.25 * turn])
    high = np.array([ENVELOPE[1] * weight, turn, turn, 0.25 * turn])
    return np.random.default_rng(seed).uniform(low, high, (rows, 4))


def demand_units(airframe: Airframe, ceiling_N: float) -> NDArray[np.float64]:
    """(4,) what a demand of 1 means to a law on wrenches: thrust, roll, pitch, yaw; N, N m.

    Thrust 1 is `ceiling_N`, a turn of 1 weight x arm in roll and pitch; in yaw a quarter of it, as the
    envelope has it.
    """
    turn = weight_arm(airframe)
    return np.array([ceiling_N, turn, turn, 0.25 * turn])


def law_commands(law: Law, vehicle: Vehicle, ceiling_N: float) -> Commands:
    """A law on wrenches as one on demands, in `demand_units`: what motors are told for its speeds."""
    units = demand_units(vehicle.airframe, ceiling_N)

    def commands(roll: float, pitch: float, yaw: float, thrust: float) -> NDArray[np.float64]:
        return np.clip(vehicle.commanded(law.speeds(units * (thrust, roll, pitch, yaw))), 0.0, 1.0)

    return commands
