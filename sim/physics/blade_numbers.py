"""What the blade-element equations need of one rotor type, and what follows from it once (`bemt`)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.physics.layout import FASTEST, SLOWEST, SOUND_M_S

RHO = 1.225

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Blades:
    """What the equations need of one rotor type; meanings as in `pairs/*.toml`."""

    radius_m: float
    spacing_m: float
    lift: float
    pitch_rad: float
    drag: float
    induced: float = 1.0
    reynolds: float = 0.0
    feedback: float = 0.0
    bluff: float = 1.0
    wake: float = 1.0
    mach: float = 1.0


def lift_slope(b: Blades, tip_m_s: float, u: Floats) -> Floats:
    """Solidity times lift slope: Reynolds number, and Mach number by Prandtl and Glauert."""
    x = np.clip(u, SLOWEST, FASTEST)
    mach = b.mach * (0.75 * tip_m_s * x / SOUND_M_S) ** 2
    return b.lift * x**b.reynolds / np.sqrt(1.0 - np.minimum(mach, 0.8))


def profile_drag(b: Blades, u: Floats) -> Floats:
    """Solidity times profile drag coefficient, over 4."""
    return 0.25 * b.drag * np.clip(u, SLOWEST, FASTEST) ** (-0.5 * abs(b.reynolds))


def constants(b: Blades, tip_m_s: float) -> tuple[float, ...]:
    """What the compiled equations want to know: see `blades.blow`."""
    x = b.spacing_m / b.radius_m
    reach = x / math.sqrt(1.0 + x * x)
    square = 1.0 / (1.0 + reach)
    mass = 3.0 * math.pi / (8.0 * b.radius_m)
    numbers = (
        tip_m_s,
        b.pitch_rad,
        RHO * math.pi * b.radius_m**2,
        b.radius_m,
        x,
        math.sqrt(square),
        b.wake * (1.0 + reach),
        b.feedback * (1.0 - reach),
        b.induced,
        b.bluff,
        mass,
        mass / square,
        mass / (1.0 - square),
    )
    return tuple(float(n) for n in numbers)
