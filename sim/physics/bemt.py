"""A coaxial pair by momentum and blade-element theory: physics of the world's own.

Each disc (radius R, tip speed V = V_max u) is one ring or two; linear lift integrated from r0 to r1,

    T = rho A s V / 2 (theta V (r1^3 - r0^3) / 3 - w (r1^2 - r0^2) / 2),   s = solidity * lift slope

and momentum, T = 2 rho A (r1^2 - r0^2) w (w - w_c), give the flow w through it in closed form. The upper
rotor's wake contracts (to 1 / g of the disc at speed g w, g = 1 + x / sqrt(1 + x^2), x = spacing / R) and
is the climb w_c of the lower rotor's inner ring; its outer ring sees still air. The lower one's induced
flow reaches back to the upper one, less with spacing. Torque is induced (kappa T w / Omega) and profile. Lift
and profile drag change with Reynolds number (a power of speed) and tip Mach number (Prandtl and Glauert);
blades that the wake meets at rest are a bluff body. Leishman, Principles of Helicopter Aerodynamics, ch. 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.documents import read_number, refuse_unknown
from sim.errors import SimulationError
from sim.physics.layout import FASTEST, SLOWEST, SOUND_M_S
from sim.physics.pair import Pair

Floats = NDArray[np.float64]


RHO = 1.225


@dataclass(frozen=True)
class BladeNumbers:
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


def lift_slope(b: BladeNumbers, tip_m_s: float, u: Floats) -> Floats:
    """Solidity times lift slope: Reynolds number, and Mach number by Prandtl and Glauert."""
    x = np.clip(u, SLOWEST, FASTEST)
    mach = b.mach * (0.75 * tip_m_s * x / SOUND_M_S) ** 2
    return b.lift * x**b.reynolds / np.sqrt(1.0 - np.minimum(mach, 0.8))


def profile_drag(b: BladeNumbers, u: Floats) -> Floats:
    """Solidity times profile drag coefficient, over 4."""
    return 0.25 * b.drag * np.clip(u, SLOWEST, FASTEST) ** (-0.5 * abs(b.reynolds))


def constants(b: BladeNumbers, tip_m_s: float) -> Floats:
    """(13,) what the compiled equations want to know, as `blades` numbers it."""
    x = b.spacing_m / b.radius_m
    reach = x / math.sqrt(1.0 + x * x)
    square = 1.0 / (1.0 + reach)
    mass = 3.0 * math.pi / (8.0 * b.radius_m)
    return np.array(
        [
            tip_m_s, b.pitch_rad, RHO * math.pi * b.radius_m**2, b.radius_m, x, math.sqrt(square),
            b.wake * (1.0 + reach), b.feedback * (1.0 - reach), b.induced, b.bluff,
            mass, mass / square, mass / (1.0 - square),
        ]
    )  # fmt: skip


def pair_loads(
    blades: BladeNumbers,
    tip_m_s: float,
    u_upper: ArrayLike,
    u_lower: ArrayLike,
    climb_m_s: float = 0.0,
    edge_m_s: float = 0.0,
) -> Floats:
    """(4, ...) upper thrust (N), upper torque (N m), lower thrust, lower torque at normalised speeds."""
    return pair_air(blades, tip_m_s, u_upper, u_lower, climb_m_s, edge_m_s)[:4]


def pair_air(
    blades: BladeNumbers,
    tip_m_s: float,
    u_upper: ArrayLike,
    u_lower: ArrayLike,
    climb_m_s: float = 0.0,
    edge_m_s: float = 0.0,
) -> Floats:
    """(6, ...) as `pair_loads`, and the upper and the lower rotor's drag along the disc, N s/m.

    The very functions of the compiled plant, at the blades' own lift and drag instead of their fits.
    """
    from sim.physics.blades import settled  # numba takes its time

    u, v = (np.asarray(x, float) for x in np.broadcast_arrays(u_upper, u_lower))
    speed = np.stack([u.ravel(), v.ravel()])
    out = np.empty((6, u.size))
    lift, drag = lift_slope(blades, tip_m_s, speed), profile_drag(blades, speed)
    settled(speed, lift, drag, constants(blades, tip_m_s), climb_m_s, edge_m_s, out)
    return out.reshape(6, *u.shape)


@dataclass(frozen=True)
class BemtPair(Pair):
    """The stand and the compiled plant turn the same equations; `coefficients` are not used."""

    blades: BladeNumbers

    def loads(self, u_upper: ArrayLike, u_lower: ArrayLike) -> Floats:
        """(4, ...) by the equations."""
        return pair_loads(self.blades, self.tip_m_s, u_upper, u_lower)

    @property
    def tip_m_s(self) -> float:
        """Tip speed at u = 1."""
        return self.speed_max_rpm * math.pi / 30.0 * self.blades.radius_m

    @property
    def radius_m(self) -> float:
        """Of the disc."""
        return self.blades.radius_m

    def compiled(self) -> tuple[Floats, Floats]:
        """Blades: their numbers, then lift and profile drag as polynomials of the root of speed."""
        b, tip = self.blades, self.tip_m_s
        x = np.cos(np.pi * (np.arange(200) + 0.5) / 200)
        root = 0.5 * (math.sqrt(FASTEST) + math.sqrt(SLOWEST) + (math.sqrt(FASTEST) - math.sqrt(SLOWEST)) * x)
        fits = [
            np.polynomial.Polynomial.fit(root, f, 12).convert().coef[::-1]
            for f in (lift_slope(b, tip, root**2), profile_drag(b, root**2))
        ]
        return np.zeros((4, 0, 0)), np.concatenate([constants(b, tip), *fits])


def bemt_pair(path: Path, document: dict[str, Any], speed_max_rpm: float) -> BemtPair:
    """From a parsed rotor file of form "bemt". Raises WorldError."""
    table = document.get("blades")
    names = {f.name for f in fields(BladeNumbers)}
    if isinstance(table, dict):
        refuse_unknown(path, "blades", table, sorted(names))
    else:
        raise SimulationError(path, "blades", f"a table of {', '.join(sorted(names))} is expected")
    values = {name: read_number(path, f"blades.{name}", value) for name, value in table.items()}
    try:
        blades = BladeNumbers(**values)
    except TypeError:
        raise SimulationError(
            path, "blades", "radius_m, spacing_m, lift, pitch_rad and drag are expected"
        ) from None
    if min(blades.radius_m, blades.spacing_m, blades.lift) <= 0:
        raise SimulationError(path, "blades", "radius, spacing and lift are positive")
    return BemtPair(speed_max_rpm, np.zeros((4, 5, 5)), blades)
