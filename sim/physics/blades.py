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

Speeds in m/s; forces over rho A, so that air density comes in at the end. Everything is `lanes.Lanes`: a pair
of halves, uppers and lowers; `flow` is (v of uppers and of lowers' inner rings, v of lowers' outer rings).
"""

from __future__ import annotations

from numba.extending import register_jitable

from sim.physics.layout import FASTEST, SLOWEST
from sim.physics.simd import above, below, both, lower, root, upper

FAST = {"contract", "nsz", "arcp", "reassoc"}  # reordering sums, not assuming that all numbers are finite
OPTIONS = {"error_model": "numpy", "fastmath": FAST}
TINY = 1e-9

inlined = register_jitable(forceinline=True, **OPTIONS)
plain = register_jitable(**OPTIONS)


@inlined
def falling(x):  # type: ignore[no-untyped-def]
    """exp(-x) for x >= 0, to 1e-13 where it counts."""
    t = below(x, 32.0) * (-1.0 / 64.0)
    e = ((t * (1.0 / 40320.0) + 1.0 / 5040.0) * t + 1.0 / 720.0) * t + 1.0 / 120.0
    e = (((e * t + 1.0 / 24.0) * t + 1.0 / 6.0) * t + 0.5) * t + 1.0
    e = e * t + 1.0
    e = e * e
    e = e * e
    e = e * e
    e = e * e
    e = e * e
    return e * e


@inlined
def twelfth(c, x):  # type: ignore[no-untyped-def]
    """Polynomial of degree 12 by Horner, the highest power first."""
    y = ((x * c[0] + c[1]) * x + c[2]) * x + c[3]
    y = (((y * x + c[4]) * x + c[5]) * x + c[6]) * x + c[7]
    return ((((y * x + c[8]) * x + c[9]) * x + c[10]) * x + c[11]) * x + c[12]


@inlined
def turned(u, blades):  # type: ignore[no-untyped-def]
    """What of blades depends on their speed alone, as `spun` has it."""
    numbers, slope, thin = blades
    x = root(below(above(u, SLOWEST), FASTEST))
    return spun(u, twelfth(slope, x), twelfth(thin, x), numbers)


@inlined
def spun(u, slope, thin, numbers):  # type: ignore[no-untyped-def]
    """Factors of what `blown` adds up, at normalised speeds u, by lift and profile drag there.

    Thrust / rho A of the upper disc and the lower one's inner ring is lift - fall w + lean e^2, drag along
    the disc lean w + thin, torque has 1 / V and profile; then those of the outer ring, and slow blades' drag.
    """
    tip, pitch, inner = numbers[0], numbers[1], numbers[5]
    v, square, cube = u * tip, inner * inner, inner * inner * inner
    lift, fall, lean = slope * v * v * (pitch / 6.0), slope * v * 0.25, slope * (0.25 * pitch)
    out, out_fall, out_lean = lower(lift), lower(fall), lower(lean)
    drag = thin * v
    return (
        both(upper(lift), out * cube),
        both(upper(fall), out_fall * square),
        both(upper(lean), out_lean * inner),
        drag,
        1.0 / above(v, 0.02 * tip),
        drag * v * 0.5,
        out * (1.0 - cube),
        out_fall * (1.0 - square),
        out_lean * (1.0 - inner),
        lower(falling(u * 4.0)) * (0.5 * square * numbers[9]),
    )


@inlined
def blown(flow, air, edge2, climb, numbers):  # type: ignore[no-untyped-def]
    """Thrust, torque, and drag (N s/m) along the disc of every rotor in moving air; the slope of its flow."""
    lift, fall, lean, thin, over, profile, out, out_fall, out_lean, rest = air
    density, radius, spacing, inner = numbers[2], numbers[3], numbers[4], numbers[5]
    mass, wide, square = numbers[10], numbers[11], inner * inner
    flow_up, wind = above(upper(flow[0]), 0.0), lower(edge2)
    # what is left of the wake where the wind has not blown it off the lower disc
    swept = flow_up + upper(climb)
    swept = swept * swept
    jet = flow_up * numbers[6] * swept / (swept + upper(edge2) * (spacing * spacing) + TINY)
    back = above(lower(flow[0]) * square + flow[1] * (1.0 - square), 0.0) * numbers[7]
    through = flow[0] + climb + both(back, jet)
    around = flow[1] + lower(climb)
    inside = lift + lean * edge2 - fall * through
    outside = out + out_lean * wind - out_fall * around
    slopes = (
        both(upper(inside) * mass, lower(inside) * wide)
        - flow[0] * root(through * through + edge2) * (2.0 * mass),
        outside * numbers[12] - flow[1] * root(around * around + wind) * (2.0 * mass),
    )
    nothing = jet * 0.0
    along = lean * through + both(nothing, out_lean * around)
    power = inside * through + both(nothing, outside * around)
    thrust = inside + both(nothing, outside - rest * jet * jet)
    torque = (power * numbers[8] - (along - thin * 0.5) * edge2) * over + profile
    return thrust * density, torque * (density * radius), (along + thin) * density, slopes
