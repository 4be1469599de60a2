"""What the vehicle's owner tuned before anyone came: hover thrust and rate gains for the table it boots with.

PX4's stock gains are for small quadrotors. A bench engineer would set P so that the loop closes at a chosen
rate: gain = bandwidth * inertia / (torque per unit of normalised control), measured here on the plant itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sim.physics.plant import GRAVITY, Plant
from sim.vehicle import LOWER

BANDWIDTH = (12.0, 12.0, 5.0)  # rad/s of the rate loops; the motors' lag allows about a quarter of 1 / lag

INTEGRALS = ("MPC_XY_VEL_I_ACC", "MPC_Z_VEL_I_ACC", "MC_ROLLRATE_I", "MC_PITCHRATE_I", "MC_YAWRATE_I")
VERTICAL = ("MPC_Z_VEL_P_ACC", "MPC_Z_VEL_I_ACC", "MPC_Z_VEL_D_ACC")


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


def tuned_settings(a: Any, *, lift: bool = True) -> dict[str, float]:
    """Hover thrust and rate gains for the mixer on board `a`; `lift`: vertical gains over its slope, too."""
    tuned = tune(a.mixer, a.plant)
    settings = {"MPC_THR_HOVER": tuned.hover}
    for axis, gains in zip(("ROLL", "PITCH", "YAW"), tuned.gains, strict=True):
        settings |= {f"MC_{axis}RATE_{k}": gain for k, gain in zip("PID", gains, strict=True)}
    if lift:
        slope = lift_exponent(a, tuned.hover)
        settings |= {name: float(a.store[name]) / slope for name in VERTICAL}
    return settings


def lift_exponent(a: Any, hover: float) -> float:
    """d(log thrust) / d(log demand) in hover: what multiplies a vertical gain; the loops count on 1."""
    high, low = (a.mixer.command(0.0, 0.0, 0.0, (1.0 + s) * hover) for s in (0.02, -0.02))
    lifted = steady(a.plant, np.array([high, low]))[:, 0]
    return float(np.log(lifted[0] / lifted[1]) / np.log(1.02 / 0.98))


def wrench(plant: Plant, command: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4,) thrust up, roll, pitch, yaw of steady motor commands (N,)."""
    return steady(plant, command[None])[0]


def steady(plant: Plant, commands: NDArray[np.float64]) -> NDArray[np.float64]:
    """(rows, 4) thrust up, roll, pitch, yaw of steady motor commands (rows, N) on sound rotors."""
    v, speeds = plant.vehicle, plant.steady_speeds(commands)
    partner, lower = np.asarray(v.partner), np.asarray(v.level) == LOWER
    other = np.where(partner >= 0, speeds[:, partner], 0.0)
    loads = plant.pair.loads(np.where(lower, other, speeds), np.where(lower, speeds, other))
    thrust, torque = np.where(lower, loads[2], loads[0]), np.where(lower, loads[3], loads[1])
    moment = thrust @ np.cross(v.position_m, v.axis) - (torque * v.spin) @ v.axis
    return np.column_stack([-(thrust @ v.axis)[:, 2], moment])
