"""A vehicle as `exact.solver` wants it: polynomial arms over box bounds, in units of its own authority.

Coordinates of an arm are u, its upper rotor's speed, and s in 0 .. 1, which places the lower one's between

    v = low(u) + (high(u) - low(u)) s,    low(u) = a + b u,   high(u) = c + d u

`high` is what the lower rotor turns at its greatest command, a little more where the wake takes torque off
it; `low` what it turns at its least command, or the speed at which the wake would turn it: below, its thrust
falls as it speeds up (real pairs pull down by 2 to 6 N there), and its ESC drives nothing. Polynomials in
both speeds stay polynomials in u and s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import AXES
from coaxlink.errors import InputError
from coaxlink.load import Load
from coaxlink.mixer.coefficients import reduced_coefficients
from coaxlink.mixer.exact.solver import NEVER, Arms, State
from coaxlink.mixer.linear import reduced_matrix
from coaxlink.rotor import RotorModel
from coaxlink.rotor.polynomial import Polynomial
from coaxlink.vehicle import Vehicle, require_vehicle

Array = NDArray[np.float64]
CAPS = (1e6, 1e6, 1e4, 1e2)  # in full powers per full authority, by rank
SMALL = 1e-10  # of the largest: what rounding leaves of a surface that is none
WITHIN = 1e-5  # of the vehicle's authority: a miss that no sensor shows
# of full speed: what autopilots let rotors idle at (MOT_SPIN_MIN); a stand that began faster forbids no more
IDLE = 0.15
POINTS = 33  # of upper speeds for the lines
RATIOS = np.linspace(0.0, 0.9, 91)  # of lower over upper speed, for the windmilling one


@dataclass(frozen=True)
class Units:
    """From the vehicle's own axes, rotors and units to those of `exact.solver`."""

    order: NDArray[np.int64]  # (4,) index into AXES of each rank
    scale: Array  # (4,) N or N m of a unit, by rank
    power: float  # N m (sum of torque x speed) of a unit of power
    slots: NDArray[np.int64]  # (N,) which of the 2K coordinates is rotor n's
    lean: Array  # (K, T) as `power`: half of what a pair's upper rotor lifts more, of the full thrust


def windmilling(model: RotorModel, top: float) -> float:
    """Least lower over upper speed above which the lower rotor answers as a driven one; at most 0.9.

    Its thrust grows with its speed, at all upper speeds up to `top`; where a drive was measured, its torque
    is positive too, for an ESC does not brake.
    """
    u = np.linspace(0.15, 1.0, POINTS)[:, None, None] * top
    v = RATIOS[:, None] * u
    v = v + (top - v) * np.linspace(0.0, 1.0, 41)
    sound = model.lower_thrust.derivative("u_l")(u, v) > 0.0
    if model.drive is not None:
        sound &= model.lower_torque(u, v) >= 0.0
    every = sound.all(axis=(0, 2))
    return float(RATIOS[int(np.argmax(every))]) if every.any() else float(RATIOS[-1])


def scaled(
    vehicle: Vehicle, *, low: float, high: float, failed: Sequence[int], priority: Sequence[str]
) -> tuple[Arms, Units]:
    """A vehicle's arms, of numpy arrays; the options as for `ExactLaw`.

    Raises InputError on bounds out of order, an unknown rotor or axis.
    """
    require_vehicle(vehicle)
    airframe, model = vehicle.airframe, vehicle.model
    if not 0.0 <= low < high <= 1.0:
        raise InputError("exact", "bounds", f"0 <= low < high <= 1 expected, found {low} and {high}")
    if sorted(priority) != sorted(AXES):
        raise InputError("exact", "priority", f"each of {', '.join(AXES)} once expected, found {priority}")
    numbers = [r.number for r in airframe.rotors]
    for n in failed:
        if n not in numbers:
            raise InputError("exact", "failed", f"there is no rotor {n}")
    count = len(numbers)
    order = np.array([AXES.index(axis) for axis in priority])
    per_load = airframe.effectiveness()  # of thrusts and torques, (4, N) each
    most = vehicle.turned(np.full(count, high))
    full = airframe.loads(model, most)
    scale = (np.abs(per_load[0]) @ np.abs(full[0]) + np.abs(per_load[1]) @ np.abs(full[1]))[order]
    scale = np.where(scale > 1e-9, scale, 1.0)
    power = float(np.abs(full[1]) @ most)

    still = np.array([n in failed for n in numbers])
    pairs = [*airframe.pairs, *((i, -1) for i in airframe.singles)]
    lines = _lines(vehicle, pairs, low, high, still)
    lo, hi = np.zeros(2 * len(pairs)), np.zeros(2 * len(pairs))
    slots = np.zeros(count, np.int64)
    least = vehicle.turned(np.full(count, low))
    surfaces, powers, gains, leans = [], [], [], []
    for k, (a, b) in enumerate(pairs):
        slots[a] = 2 * k
        if not still[a]:
            lo[2 * k], hi[2 * k] = max(least[a], min(model.slowest, IDLE, 0.5 * most[a])), most[a]
        if b >= 0:
            slots[b] = 2 * k + 1
            hi[2 * k + 1] = 0.0 if still[b] else 1.0
        mine = [_over(model.surface(load), lines[k]) for load in Load]
        rotors = [(a, 0), (a, 1), (b, 0), (b, 1)]  # of the loads: rotor, thrust or torque
        sizes = [0.0 if r < 0 else airframe.gains[kind][r] for r, kind in rotors]
        wrench = [np.zeros(4) if r < 0 else per_load[kind][order, r] / scale for r, kind in rotors]
        few, gain = _fewest([z * c for z, c in zip(sizes, mine, strict=True)], np.array(wrench))
        surfaces.append(few)
        gains.append(gain)
        upper, lower = sizes[1] * _times_u(mine[1]), sizes[3] * _times_line(mine[3], lines[k])
        powers.append(_add(upper, lower) / power)
        leans.append(_add(sizes[0] * mine[0], -sizes[2] * mine[2]) * (0.5 * (b >= 0)) / full[0].sum())
    m = max(len(few) for few in surfaces)
    of_surface = _orders([c for few in surfaces for c in few])
    of_power = _orders([*powers, *leans])
    dense = np.zeros((len(pairs), m, (of_surface[0] + 1) * (of_surface[1] + 1)))
    gain = np.zeros((len(pairs), m, 4))
    for k, (few, g) in enumerate(zip(surfaces, gains, strict=True)):
        for n, c in enumerate(few):
            dense[k, n], gain[k, n] = _dense(c, of_surface), g[n]
    squares = np.zeros((2 * len(pairs), 4))
    reduced = np.linalg.pinv(reduced_matrix(airframe, reduced_coefficients(model))[order] / scale[:, None])
    squares[slots] = reduced
    arms = Arms(
        len(pairs), m, *of_surface, *of_power, dense, np.array([_dense(c, of_power) for c in powers]), gain,
        lo, hi, np.array(CAPS), squares, lines, np.where(hi > lo, 0.5 * (lo + hi), lo), np.array([WITHIN]),
    )  # fmt: skip
    lean = np.array([_dense(c, of_power) for c in leans])
    return arms, Units(order, scale, power, slots, lean)


def _lines(
    vehicle: Vehicle, pairs: Sequence[tuple[int, int]], low: float, high: float, still: NDArray[np.bool_]
) -> Array:
    """(K, 4) a, b, c, d of the module's lines."""
    count = len(still)
    out = np.zeros((len(pairs), 4))
    upper = np.array([rotor.level == "upper" for rotor in vehicle.airframe.rotors])
    commands = np.linspace(low, high, POINTS)[:, None]
    under = {end: vehicle.turned(np.where(upper, commands, np.full(count, end))) for end in (low, high)}
    for k, (a, b) in enumerate(pairs):
        if b < 0 or still[b]:
            continue
        u = np.zeros(POINTS) if still[a] else under[high][:, a]
        least, most = under[low][:, b], under[high][:, b]
        if still[a]:
            least, most = least[:1].repeat(POINTS), most[:1].repeat(POINTS)
        top = max(float(u[-1]), float(most[-1]))
        least = np.maximum(least, windmilling(vehicle.model, top) * u)
        out[k, :2] = _line_above(u, least)
        below, slope = _line_above(u[-1] - u[::-1], -most[::-1])  # through the end, and nowhere above
        out[k, 2:] = -below - slope * u[-1], slope
    return out


def _line_above(x: Array, y: Array) -> tuple[float, float]:
    """The line through the first point (x from 0 on) that is nowhere below the others."""
    rise = [(b - y[0]) / (a - x[0]) for a, b in zip(x[1:], y[1:], strict=True) if a - x[0] > 1e-9]
    slope = max(rise, default=0.0)
    return float(y[0] - slope * x[0]), float(slope)


# polynomials as arrays: [power of u][power of s]


def _over(load: Polynomial, line: Array) -> Array:
    """A load over both speeds as one over u and s."""
    a, b, c, d = line
    at_rest, span = np.array([a, b]), np.array([c - a, d - b])  # of the lower speed, over u
    orders = [max((e[i] for e in load.exponents), default=0) for i in (0, 1)]
    out = np.zeros((orders[0] + orders[1] + 1, orders[1] + 1))
    for (p, q), coefficient in zip(load.exponents, load.coefficients, strict=True):
        for r in range(q + 1):
            u = np.polynomial.polynomial.polypow(at_rest, q - r) if q > r else np.ones(1)
            u = np.convolve(u, np.polynomial.polynomial.polypow(span, r)) if r else u
            binomial = _binomial(q, r) * coefficient
            out[p : p + len(u), r] += binomial * u
    return out


def _binomial(n: int, k: int) -> float:
    from math import comb

    return float(comb(n, k))


def _times_u(c: Array) -> Array:
    return np.vstack([np.zeros((1, c.shape[1])), c])


def _times_line(c: Array, line: Array) -> Array:
    """Times the lower speed."""
    a, b, high, d = line
    out = np.zeros((c.shape[0] + 1, c.shape[1] + 1))
    out[:-1, :-1] += a * c
    out[1:, :-1] += b * c
    out[:-1, 1:] += (high - a) * c
    out[1:, 1:] += (d - b) * c
    return out


def _add(a: Array, b: Array) -> Array:
    out = np.zeros((max(a.shape[0], b.shape[0]), max(a.shape[1], b.shape[1])))
    out[: a.shape[0], : a.shape[1]] += a
    out[: b.shape[0], : b.shape[1]] += b
    return out


def _fewest(loads: Sequence[Array], wrench: Array) -> tuple[list[Array], Array]:
    """As few surfaces as make the wrench (4 loads, 4 axes) of these loads; and theirs (M, 4)."""
    left, size, right = np.linalg.svd(wrench, full_matrices=False)
    rank = max(int(np.sum(size > SMALL * max(size[0], 1e-300))), 1)
    shape = (max(c.shape[0] for c in loads), max(c.shape[1] for c in loads))
    padded = np.array([_add(np.zeros(shape), c) for c in loads])
    return list(np.tensordot(left[:, :rank].T, padded, 1)), size[:rank, None] * right[:rank]


def _orders(surfaces: Sequence[Array]) -> tuple[int, int]:
    """The highest powers that any of these has."""
    largest = max(float(np.abs(c).max(initial=0.0)) for c in surfaces)
    used = [np.nonzero(np.abs(c) > SMALL * largest) for c in surfaces]
    return (
        max(2, *(int(at[0].max(initial=0)) for at in used)),
        max(2, *(int(at[1].max(initial=0)) for at in used)),
    )


def _dense(c: Array, orders: tuple[int, int]) -> Array:
    out = np.zeros((orders[0] + 1, orders[1] + 1))
    rows, columns = min(c.shape[0], orders[0] + 1), min(c.shape[1], orders[1] + 1)
    out[:rows, :columns] = c[:rows, :columns]
    return out.ravel()


def standing(arms: Arms) -> State:
    """The solver's state, of numpy arrays: where it hovers, nothing remembered."""
    n, free = 2 * arms.size, np.zeros
    remembered = free((3, 4))
    remembered[:, 0] = NEVER
    return State(
        mu=free(4), x=arms.home.copy(), act=free(n, np.int64), price=free(4), gone=free(4, np.int64),
        miss=free(4),
        power=free(1), slope=free(n), jacobian=free((n, 4)), hessian=free((arms.size, 3)), own=free(n),
        reply=free((n, 4)), step=free(n), schur=free((4, 4)), factor=free((4, 4)), right=free(4),
        dual=free(4), before=free(4), low=free(n), high=free(n), kept=free(n), old_mu=remembered,
        old_price=free((3, 4)), old_gone=free((3, 4), np.int64), old_x=free((3, n)),
        old_act=free((3, n), np.int64), smooth=free(1), best=free(n), looked=free(9), looks=free(1),
    )  # fmt: skip
