"""What the vehicle's owner tuned before anyone came: hover thrust and rate gains for the table it boots with.

PX4's stock gains are for small quadrotors. A bench engineer would set P so that the loop closes at a chosen
rate: gain = bandwidth * inertia / (torque per unit of normalised control), measured here on the plant itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sim.physics.plant import GRAVITY, Plant

BANDWIDTH = (12.0, 12.0, 5.0)  # rad/s of the rate loops; the motors' lag allows about a quarter of 1 / lag


class Mixing(Protocol):
    """A mixer to tune for."""

    def command(self, roll: float, pitch: float, yaw: float, thrust: float) -> NDArray[np.float64]:
        """(N,) motor commands."""
        ...


@dataclass(frozen=True)
class Tuning:
    """The thrust that hovers, and P, I, D of roll, pitch and yaw rate."""

    hover: float
    gains: tuple[tuple[float, float, float], ...]  # (3, 3)


def tune(mixer: Mixing, plant: Plant) -> Tuning:
    """Settings for this plant and this mixer."""
    low, high = 0.02, 1.0
    weight = plant.vehicle.mass_kg * GRAVITY
    for _ in range(40):
        middle = 0.5 * (low + high)
        lifted = wrench(plant, mixer.command(0.0, 0.0, 0.0, middle))[0] > weight
        low, high = (low, middle) if lifted else (middle, high)
    hover, gains = round(0.5 * (low + high), 3), []
    for k in range(3):
        a, b = (wrench(plant, mixer.command(*_nudge(k, s), hover))[1 + k] for s in (0.01, -0.01))
        authority = max(float(a - b) / 0.02, 1e-3)
        gain = BANDWIDTH[k] * float(plant.vehicle.inertia_kg_m2[k]) / authority
        gains.append((round(gain, 3), round(gain * 1.5, 3), round(gain * 0.015, 4) if k < 2 else 0.0))
    return Tuning(hover, tuple(gains))


def _nudge(axis: int, size: float) -> tuple[float, float, float]:
    return size * (axis == 0), size * (axis == 1), size * (axis == 2)


def wrench(plant: Plant, u: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4,) thrust up, roll, pitch, yaw of steady normalised speeds (N,)."""
    v = plant.vehicle
    thrust, torque = np.zeros(v.rotors), np.zeros(v.rotors)
    for i in range(v.rotors):
        other = u[v.partner[i]] if v.partner[i] >= 0 else 0.0
        lower = v.level[i] == 1
        loads = plant.pair.loads(other if lower else u[i], u[i] if lower else other)
        thrust[i], torque[i] = loads[2:] if lower else loads[:2]
    force = thrust[:, None] * v.axis
    moment = np.cross(v.position_m, force) - (v.spin * torque)[:, None] * v.axis
    return np.concatenate([[-force[:, 2].sum()], moment.sum(axis=0)])
