"""Physical sense on request: what a rotor's load may not do, as constraints on a grid of speeds.

thrust  of the upper rotor is not negative and rises with its speed; the lower one's falls with the upper
        one's, in whose wake it works (it never lifts more than alone), and rises with its own
power   a rotor takes it: its torque is not negative and rises with its speed

What a lower rotor does with its own speed is required only where it is at least as fast as the upper one.
Slower, the wake may drive it: a blade element's thrust in a flow w goes with theta Omega^2 - w Omega / r. It
falls with Omega below w / (2 theta r), and the power changes sign with the thrust.

Each is a linear inequality in the coefficients at every point of a grid, from the log's slowest speeds to
u = 1 (what tables and mixers use) or its fastest: least squares under them is a small convex problem (cvxpy),
whose only optimum is the model nearest to the data among those that make sense.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from coaxlink.load import Load
from coaxlink.rotor.fit import Broken, LoadFit
from coaxlink.rotor.lasso import ZERO, solve
from coaxlink.rotor.polynomial import design_matrix, parse_term
from coaxlink.rotor.stand_data import LoadRows

IN_THE_WAKE = "rises with the upper rotor's speed"  # the one rule that no law needs to find its way
POINTS = 21  # a side of the grid
SLACK = 1e-9  # of the largest value: an equality met to rounding is met
Array = NDArray[np.float64]


def constrained(fit: LoadFit, rows: LoadRows, weights: Array) -> LoadFit:
    """The fit itself if it makes sense, else weighted least squares under the constraints on its terms.

    Where its own terms cannot make sense, the whole dictionary is tried. `broken` says which rules the free
    fit broke and where, `free` holds its coefficients; `moved` names the terms that the constraints pushed
    out of their intervals: there the data contradict the physics, or the stand does. `unmet` is true where
    nothing but zero meets the rules: then the free fit stays.
    """
    u, v = grid(rows.upper, rows.lower)
    held = dict(rules(rows.load, fit.terms, u, v))
    broken = tuple(found for name, C in held.items() if (found := violation(name, C, fit.coefficients, u, v)))
    if not broken:
        return fit
    every = np.concatenate(list(held.values()))
    X = rows.design(fit.terms)
    for support in (fit.coefficients != 0, np.ones(len(fit.terms), bool)):
        b = np.zeros(len(fit.terms))
        solution = nearest(X[:, support], rows.y, weights, every[:, support])
        if solution is None:
            continue
        b[support] = solution
        outside = tuple(
            t
            for t, x in zip(fit.terms, b, strict=True)
            if x and t in fit.intervals.bounds and not fit.intervals.holds({t: float(x)})
        )
        return replace(fit, coefficients=b, moved=outside, broken=broken, free=fit.coefficients)
    return replace(fit, broken=broken, unmet=True)


def grid(upper: Array, lower: Array) -> tuple[Array, Array]:
    """(points,) upper and lower speeds where the rules hold; a rotor that never varied keeps its speed."""
    sides = [
        np.linspace(x.min(), max(1.0, float(x.max())), POINTS) if np.ptp(x) > 0 else x[:1]
        for x in (upper, lower)
    ]
    u, v = np.meshgrid(*sides)
    return u.ravel(), v.ravel()


def rules(load: str, terms: tuple[str, ...], u: Array, v: Array) -> Iterator[tuple[str, Array]]:
    """What must hold of a load: its name and (points, p) rows C with C b >= 0, zero where it need not."""
    value = design_matrix(terms, u, v)
    if load.startswith("upper"):
        yield "is negative", value
        yield "falls with its own speed", _slope(terms, u, v, 0)
        return
    at_work = (v >= u)[:, None]
    yield "falls with its own speed", _slope(terms, u, v, 1) * at_work
    if load == Load.LOWER_THRUST.key:
        yield IN_THE_WAKE, -_slope(terms, u, v, 0)
    else:
        yield "is negative", value * at_work


def _slope(terms: tuple[str, ...], u: Array, v: Array, along: int) -> Array:
    """(points, p) derivative of every term along u_u (0) or u_l (1)."""
    columns = []
    for a, b in map(parse_term, terms):
        power = (a, b)[along]
        lowered = (max(a - 1, 0), b) if along == 0 else (a, max(b - 1, 0))
        columns.append(power * u ** lowered[0] * v ** lowered[1])
    return np.stack(columns, axis=1)


def violation(rule: str, C: Array, b: Array, u: Array, v: Array) -> Broken | None:
    """Where a rule is broken worst, and on what share of the grid."""
    values = C @ b
    limit = -SLACK * np.abs(values).max(initial=0.0)
    if not len(values) or values.min() >= limit:
        return None
    worst = int(np.argmin(values))
    return Broken(
        rule, float(-values[worst]), float(u[worst]), float(v[worst]), float(np.mean(values < limit))
    )


def nearest(X: Array, y: Array, weights: Array, C: Array) -> Array | None:
    """(p,) weighted least squares under C b >= 0, None when nothing but zero meets them."""
    import cvxpy as cp

    root = np.sqrt(weights / len(y))
    q, R = np.linalg.qr(X * root[:, None])
    scale = np.where((norm := np.sqrt(np.sum(R**2, axis=0))) > 0, norm, 1.0)
    target = q.T @ (y * root)
    size = float(np.linalg.norm(target)) or 1.0
    # rows of one length, and none that says 0 >= 0: a solver of the interior needs one
    C = C / scale
    length = np.linalg.norm(C, axis=1)
    C = C[length > SLACK * length.max(initial=0.0)]
    C = np.unique((C / np.linalg.norm(C, axis=1, keepdims=True)).round(12), axis=0)
    z = cp.Variable(X.shape[1])
    solve(cp.Problem(cp.Minimize(cp.sum_squares((R / scale) @ z - target / size)), [C @ z >= 0]))
    if z.value is None or not np.any(np.abs(z.value) > ZERO):
        return None
    return np.asarray(np.where(np.abs(z.value) > ZERO * np.abs(z.value).max(), size * z.value / scale, 0.0))
