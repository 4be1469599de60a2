# mypy: disallow-untyped-defs=False
"""A coaxial pair by momentum and blade-element theory, in moving air: the world's physics, compiled.

A ring of the disc from r0 to r1 (shares of the radius R), tip speed V, flow w = v + w_c through it, v what it
induces, w_c its climb through the air, e the air's speed along it. Blades of linear lift, averaged over
a turn, and momentum with Glauert's speed and the air's own mass (Pitt and Peters) give

    T = rho A s / 2 (theta (V^2 (r1^3 - r0^3) / 3 + e^2 (r1 - r0) / 2) - V w (r1^2 - r0^2) / 2)
      = rho A (r1^2 - r0^2) (8 R / (3 pi) dv/dt + 2 v sqrt(w^2 + e^2)),       s = solidity * lift slope

so that v is a state in flight (it settles within some 5 ms) and the root of dv/dt = 0 on a stand. The upper
rotor's wake contracts (to 1 / g of the disc at speed g v, g = 1 + x / sqrt(1 + x^2), x = spacing / R), is
blown aside by e, and is the climb of the lower rotor's inner ring; its outer ring sees still air. The lower
one's induced flow reaches back, less with spacing. Shaft power is induced (kappa T w) and profile (growing
with mu^2) less the work of the drag along the disc, which the same blades give: s theta e w / 4 and
c_d V e / 4. Lift and profile drag follow Reynolds number (a power of speed) and lift the tip's Mach number
(Prandtl and Glauert); slow blades in the wake are a bluff body, and a wheel that it drives. Leishman,
Principles of Helicopter Aerodynamics, ch. 2, 3, 5; Pitt and Peters 1981.

Speeds in m/s; forces over rho A, so that air density comes in at the end. `b` is the blades' array: see
`bemt.constants`, then lift and profile drag as polynomials of the root of speed.
"""

from __future__ import annotations

import math

import numpy as np

from sim.physics.compile_cache import OPTIONS, cached, inlined
from sim.physics.layout import FASTEST, SLOWEST

TINY = 1e-9
(TIP, PITCH, DENSITY, RADIUS, SPACING, INNER, JET, BACK, INDUCED, BLUFF, MASS, MASS_IN, MASS_OUT) = range(13)
LIFT, DRAG, BLADES, TERMS = 13, 26, 39, 13


@inlined
def spun(u, b):
    """Solidity times lift slope, and times a quarter of profile drag, at a normalised speed."""
    x = math.sqrt(min(max(u, SLOWEST), FASTEST))
    slope = drag = 0.0
    for k in range(TERMS):
        slope = slope * x + b[LIFT + k]
        drag = drag * x + b[DRAG + k]
    return slope, drag


@inlined
def turning(u, slope, drag, b):
    """(lift, its loss with flow, its gain with e^2, drag along the disc, 1 / V, profile torque) of a disc."""
    v = u * b[TIP]
    d = drag * v
    return (
        slope * v * v * (b[PITCH] / 6.0), slope * v * 0.25, slope * 0.25 * b[PITCH], d,
        1.0 / max(v, 0.02 * b[TIP]), d * v * 0.5,
    )  # fmt: skip


@inlined
def loaded(inside, along, power, edge2, disc, b):
    """(thrust N, torque N m, drag along the disc N s/m) of a rotor from its sums over rho A."""
    _, _, _, drag, over, profile = disc
    torque = (power * b[INDUCED] - (along - drag * 0.5) * edge2) * over + profile
    return inside * b[DENSITY], torque * b[DENSITY] * b[RADIUS], (along + drag) * b[DENSITY]


@inlined
def alone(u, slope, drag, flow, edge2, climb, back, b):
    """(thrust, torque, drag along the disc, slope of its flow) of an upper or single rotor."""
    disc = turning(u, slope, drag, b)
    through = flow + climb + back
    inside = disc[0] + disc[2] * edge2 - disc[1] * through
    fresh = (inside - flow * math.sqrt(through * through + edge2) * 2.0) * b[MASS]
    along = disc[2] * through
    return loaded(inside, along, inside * through, edge2, disc, b), fresh


@inlined
def reaching_back(inner_flow, outer_flow, b):
    """Flow through the upper disc that the lower rotor induces."""
    square = b[INNER] * b[INNER]
    return max(inner_flow * square + outer_flow * (1.0 - square), 0.0) * b[BACK]


@inlined
def jet_of(flow, climb, edge2, b):
    """Speed of the upper rotor's wake at the lower disc, where the wind has not blown it off."""
    down = max(flow, 0.0)
    swept = (down + climb) * (down + climb)
    return down * b[JET] * swept / (swept + edge2 * b[SPACING] * b[SPACING] + TINY)


@inlined
def below(u, slope, drag, inner_flow, outer_flow, edge2, climb, jet, b):
    """(thrust, torque, drag along the disc, slopes of the flows of its rings) of a lower rotor in a wake."""
    disc = turning(u, slope, drag, b)
    lift, fall, lean = disc[0], disc[1], disc[2]
    r = b[INNER]
    square, cube = r * r, r * r * r
    through, around = inner_flow + climb + jet, outer_flow + climb
    inside = lift * cube + lean * r * edge2 - fall * square * through
    outside = lift * (1.0 - cube) + lean * (1.0 - r) * edge2 - fall * (1.0 - square) * around
    fresh_in = inside * b[MASS_IN] - inner_flow * math.sqrt(through * through + edge2) * 2.0 * b[MASS]
    fresh_out = outside * b[MASS_OUT] - outer_flow * math.sqrt(around * around + edge2) * 2.0 * b[MASS]
    along = lean * r * through + lean * (1.0 - r) * around
    power = inside * through + outside * around
    loads = loaded(inside + outside, along, power, edge2, disc, b)
    rest = math.exp(-4.0 * u) * 0.5 * square * b[BLUFF] * jet * jet * b[DENSITY]  # slow blades are in the way
    return (loads[0] - rest, loads[1], loads[2]), fresh_in, fresh_out


STEPS, STEPS_AT_MOST = 0.8, 4000  # a step of the stand's air against its own time, and how many at the most


@cached(**OPTIONS)
def settled(speed, lift, drag, b, climb, edge, out):
    """Fill out (6, rows): thrust and torque of upper and lower, drag of both, once the air has settled.

    speed, lift, drag (2, rows): normalised speeds, lift slope and profile drag there.
    """
    edge2, pace = edge * edge, STEPS * b[RADIUS] / (b[TIP] + abs(climb) + abs(edge))
    for r in range(speed.shape[1]):
        flow, ahead, first = np.zeros(3), np.zeros(3), np.zeros(3)
        for k in range(2 * STEPS_AT_MOST + 1):  # Heun's steps, short against the air's time
            at = ahead if k % 2 else flow
            back = reaching_back(at[1], at[2], b)
            jet = jet_of(at[0], climb, edge2, b)
            up, s0 = alone(speed[0, r], lift[0, r], drag[0, r], at[0], edge2, climb, back, b)
            low, s1, s2 = below(speed[1, r], lift[1, r], drag[1, r], at[1], at[2], edge2, climb, jet, b)
            slope = np.array([s0, s1, s2])
            if k % 2:
                flow = flow + (first + slope) * (0.5 * pace)
                continue
            if np.max(np.abs(slope)) * pace < 1e-11 or k == 2 * STEPS_AT_MOST:
                break
            first = slope
            ahead = flow + first * pace
        for k in range(2):
            out[k, r], out[2 + k, r] = up[k], low[k]
        out[4, r], out[5, r] = up[2], low[2]
