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
from sim.errors import WorldError
from sim.physics.blade_numbers import Blades, constants, lift_slope, profile_drag
from sim.physics.layout import FASTEST, SLOWEST
from sim.physics.pair import Pair

Floats = NDArray[np.float64]


def pair_loads(
    blades: Blades,
    tip_m_s: float,
    u_upper: ArrayLike,
    u_lower: ArrayLike,
    climb_m_s: float = 0.0,
    edge_m_s: float = 0.0,
) -> Floats:
    """(4, ...) upper thrust (N), upper torque (N m), lower thrust, lower torque at normalised speeds."""
    return pair_air(blades, tip_m_s, u_upper, u_lower, climb_m_s, edge_m_s)[:4]


def pair_air(
    blades: Blades,
    tip_m_s: float,
    u_upper: ArrayLike,
    u_lower: ArrayLike,
    climb_m_s: float = 0.0,
    edge_m_s: float = 0.0,
) -> Floats:
    """(6, ...) as `pair_loads`, and the upper and the lower rotor's drag along the disc, N s/m.

    The very functions of the compiled plant, at the blades' own lift and drag instead of their fits.
    """
    from sim.physics.stand_blades import pair_rows  # numba takes its time

    u, v = (np.asarray(x, float) for x in np.broadcast_arrays(u_upper, u_lower))
    return pair_rows(blades, tip_m_s, u.ravel(), v.ravel(), climb_m_s, edge_m_s).reshape(6, *u.shape)


@dataclass(frozen=True)
class BemtPair(Pair):
    """The stand and the compiled plant turn the same equations; `coefficients` are not used."""

    blades: Blades

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

    def compiled(self) -> tuple[Any, Any, Any]:
        """Blades: their numbers, and lift and profile drag as polynomials of the root of speed."""
        b, tip = self.blades, self.tip_m_s
        x = np.cos(np.pi * (np.arange(200) + 0.5) / 200)
        root = 0.5 * (math.sqrt(FASTEST) + math.sqrt(SLOWEST) + (math.sqrt(FASTEST) - math.sqrt(SLOWEST)) * x)
        fits = [
            tuple(float(c) for c in np.polynomial.Polynomial.fit(root, f, 12).convert().coef[::-1])
            for f in (lift_slope(b, tip, root**2), profile_drag(b, root**2))
        ]
        return None, None, (constants(b, tip), *fits)


def bemt_pair(path: Path, document: dict[str, Any], speed_max_rpm: float) -> BemtPair:
    """From a parsed rotor file of form "bemt". Raises WorldError."""
    table = document.get("blades")
    names = {f.name for f in fields(Blades)}
    if isinstance(table, dict):
        refuse_unknown(path, "blades", table, sorted(names))
    else:
        raise WorldError(path, "blades", f"a table of {', '.join(sorted(names))} is expected")
    values = {name: read_number(path, f"blades.{name}", value) for name, value in table.items()}
    try:
        blades = Blades(**values)
    except TypeError:
        raise WorldError(
            path, "blades", "radius_m, spacing_m, lift, pitch_rad and drag are expected"
        ) from None
    if min(blades.radius_m, blades.spacing_m, blades.lift) <= 0:
        raise WorldError(path, "blades", "radius, spacing and lift are positive")
    return BemtPair(speed_max_rpm, np.zeros((4, 5, 5)), blades)
