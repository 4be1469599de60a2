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

from sim.errors import WorldError
from sim.rotors import ORDER, Pair, read_number

RHO, SOUND_M_S = 1.225, 340.0
SLOWEST = 0.15  # below this share of full speed the Reynolds number's power law is not trusted
ROUNDS = 25
GRID = np.linspace(0.1, 1.0, 26)

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


def pair_loads(
    blades: Blades, tip_m_s: float, u_upper: ArrayLike, u_lower: ArrayLike, climb_m_s: float = 0.0
) -> Floats:
    """(4, ...) upper thrust (N), upper torque (N m), lower thrust, lower torque at normalised speeds."""
    b = blades
    u, v = (np.asarray(x, float) for x in np.broadcast_arrays(u_upper, u_lower))
    x = b.spacing_m / b.radius_m
    reach = x / math.sqrt(1.0 + x * x)
    inner = math.sqrt(1.0 / (1.0 + reach))
    back = np.zeros(u.shape)
    for _ in range(ROUNDS):
        t_upper, w_upper = _ring(b, tip_m_s, u, climb_m_s + b.feedback * (1.0 - reach) * back, 0.0, 1.0)
        wake = b.wake * (1.0 + reach) * np.maximum(w_upper - climb_m_s, 0.0)
        t_in, w_in = _ring(b, tip_m_s, v, climb_m_s + wake, 0.0, inner)
        t_out, w_out = _ring(b, tip_m_s, v, climb_m_s + 0.0 * wake, inner, 1.0)
        if b.feedback == 0.0:
            break
        induced = (w_in - climb_m_s - wake) * inner**2 + (w_out - climb_m_s) * (1.0 - inner**2)
        back = 0.5 * back + 0.5 * np.maximum(induced, 0.0)
    area = math.pi * b.radius_m**2
    stalled = b.bluff * RHO / 2.0 * wake**2 * area * inner**2 * np.exp(-4.0 * v)
    q_upper = _induced(b, tip_m_s, u, t_upper * w_upper) + _profile(b, tip_m_s, u)
    q_lower = _induced(b, tip_m_s, v, t_in * w_in + t_out * w_out) + _profile(b, tip_m_s, v)
    return np.array([t_upper, q_upper, t_in + t_out - stalled, q_lower])


def _ring(b: Blades, tip: float, x: Floats, climb: ArrayLike, r0: float, r1: float) -> tuple[Floats, Floats]:
    """Thrust of a ring and the flow through it."""
    speed, area, third = tip * x, r1**2 - r0**2, r1**3 - r0**3
    slope = b.lift * np.maximum(x, SLOWEST) ** b.reynolds
    slope = slope / np.sqrt(1.0 - np.minimum(b.mach * (0.75 * speed / SOUND_M_S) ** 2, 0.8))
    half = slope * speed / 16.0 - 0.5 * np.asarray(climb)
    flow = np.sqrt(half**2 + slope * b.pitch_rad * speed**2 * third / area / 12.0) - half
    disc = math.pi * b.radius_m**2
    thrust = RHO * disc * slope / 2.0 * speed * (b.pitch_rad * speed * third / 3.0 - flow * area / 2.0)
    return thrust, flow


def _induced(b: Blades, tip: float, x: Floats, power: Floats) -> Floats:
    return b.induced * power * b.radius_m / (tip * np.maximum(x, 0.02))


def _profile(b: Blades, tip: float, x: Floats) -> Floats:
    thin = np.maximum(x, SLOWEST) ** (-0.5 * abs(b.reynolds))
    return RHO * math.pi * b.radius_m**3 * b.drag / 8.0 * (tip * x) ** 2 * thin


@dataclass(frozen=True)
class BemtPair(Pair):
    """The stand turns the equations themselves; the compiled plant turns `coefficients`, fitted to them."""

    blades: Blades
    fit_error: tuple[float, ...]  # (4,) RMS of the fit over 0.1..1, N and N m

    def loads(self, u_upper: ArrayLike, u_lower: ArrayLike) -> Floats:
        """(4, ...) by the equations."""
        return pair_loads(self.blades, self.tip_m_s, u_upper, u_lower)

    @property
    def tip_m_s(self) -> float:
        """Tip speed at u = 1."""
        return self.speed_max_rpm * math.pi / 30.0 * self.blades.radius_m

    @property
    def inflow(self) -> float:
        """Thrust lost per climb speed over tip speed, of hovering rotors."""
        still, up = (pair_loads(self.blades, self.tip_m_s, 0.5, 0.65, c)[[0, 2]].sum() for c in (0.0, 1.0))
        return float((still - up) / still * self.tip_m_s * 0.57)

    @property
    def in_plane_drag(self) -> float:
        """N s/m of one rotor at full speed: profile drag of blades into and with the wind."""
        return RHO * math.pi * self.blades.radius_m**2 * self.blades.drag / 4.0 * self.tip_m_s


def bemt_pair(path: Path, document: dict[str, Any], speed_max_rpm: float) -> BemtPair:
    """From a parsed rotor file of form "bemt". Raises WorldError."""
    table = document.get("blades")
    names = {f.name for f in fields(Blades)}
    if not isinstance(table, dict) or not set(table) <= names:
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
    tip = speed_max_rpm * math.pi / 30.0 * blades.radius_m
    u, v = (axis.ravel() for axis in np.meshgrid(GRID, GRID, indexing="ij"))
    exact = pair_loads(blades, tip, u, v)
    powers = np.stack([u**a * v**k for a in range(ORDER + 1) for k in range(ORDER + 1)], axis=1)
    solution = np.linalg.lstsq(powers, exact.T, rcond=None)[0]
    error = np.sqrt(np.mean((powers @ solution - exact.T) ** 2, axis=0))
    coefficients = np.array(solution.T.reshape(4, ORDER + 1, ORDER + 1), np.float64)
    return BemtPair(speed_max_rpm, coefficients, blades, tuple(float(e) for e in error))
