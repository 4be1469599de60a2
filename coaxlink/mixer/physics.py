"""What effects do to rotors, as plain formulas of an effect's own numbers: for static and for live mixing.

The same formulas as `coaxlink.residual.effects`, where their sources stand.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Numbers = Mapping[str, float]
LOWEST_M = 0.08  # a disc is never nearer to the ground
LEAST_SPEED = 0.1
LEAST_BEND = 0.3  # a gain that steepens near the ground ends at about three times its first term


def speed_factor(p: Numbers, voltage_V: float) -> float:
    """Speed over command at a voltage: (V / V_ref)^k, or the stand's own form where a `power` is given."""
    ratio = voltage_V / p["reference_voltage_V"]
    k, power = p["speed_exponent"], p.get("power", 0.0)
    return float(1.0 + k * (ratio**power - 1.0) / power) if power else float(ratio**k)


def ground_gain(p: Numbers, height_m: float) -> float:
    """Share of thrust that the ground adds to a rotor whose disc is this high."""
    h = max(height_m, LOWEST_M)
    if "height_scale_m" in p:
        gain = p["gain_at_ground"] * math.exp(-h / p["height_scale_m"])
    else:
        radius, power = p["effective_radius_m"], p.get("height_power", 2.0)
        gain = math.copysign((abs(radius) / (4.0 * h)) ** power, radius)
    return gain / max(1.0 + p.get("levelling", 0.0) * gain, LEAST_BEND)


def climb_loss(p: Numbers, climb_m_s: ArrayLike, speed: ArrayLike, lift: ArrayLike, usual: float) -> Array:
    """Thrust (N) that rotors lose, climbing along their axes: all arguments broadcast.

    `speed` normalised, `lift` their thrust in N; `usual` is thrust over speed squared of a usual rotor in
    hover, which counts only where the effect goes by thrust.
    """
    climb, u = np.asarray(climb_m_s, float), np.maximum(np.asarray(speed, float), LEAST_SPEED)
    share = np.asarray(lift, float) / u**2 / usual if "by_thrust" in p else 1.0
    loss = p["thrust_per_climb_N_s_m"] * u * climb / (1.0 + p.get("levelling_s_m", 0.0) * np.abs(climb) / u)
    return np.asarray(share * (loss + p.get("thrust_per_climb_squared_N_s2_m2", 0.0) * climb**2))
