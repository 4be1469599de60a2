"""Physical sense on demand: what a rotor's load may not do, as constraints on a grid of speeds.

The upper rotor's thrust and torque are not negative and rise with its speed; the lower rotor's thrust rises
with its own speed and falls with the upper one's, in whose wake it works. Each is a linear inequality in the
coefficients at every point of the grid: least squares under them is a small convex problem (cvxpy).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from coaxlink.rotor.fit import LoadFit
from coaxlink.rotor.lasso import solve
from coaxlink.rotor.polynomial import design_matrix, parse_term

POINTS = 21  # a side of the grid, over the range of the data
SLACK = 1e-9  # of the largest value: an equality met to rounding is met


def constrained(
    fit: LoadFit,
    load: str,
    upper: NDArray[np.float64],
    lower: NDArray[np.float64],
    y: NDArray[np.float64],
    weights: NDArray[np.float64],
) -> LoadFit:
    """The fit itself if it makes sense, else least squares (rows,) under the constraints on its terms.

    Where its own terms cannot make sense, the whole dictionary is asked. `moved` names the terms that the
    constraints pushed out of their intervals: there the data contradict the physics, or the stand does.
    """
    every = _constraints(load, fit.terms, upper, lower)
    if _holds(every, fit.coefficients):
        return fit
    X = design_matrix(fit.terms, upper, lower)
    for support in (fit.coefficients != 0, np.ones(len(fit.terms), bool)):
        b = np.zeros(len(fit.terms))
        solution = _solve(X[:, support], y, weights, every[:, support])
        if solution is None:
            continue
        b[support] = solution
        outside = tuple(
            t
            for t, v in zip(fit.terms, b, strict=True)
            if v and t in fit.intervals.bounds and not fit.intervals.holds({t: float(v)})
        )
        return replace(fit, coefficients=b, moved=outside)
    return fit


def _constraints(
    load: str, terms: tuple[str, ...], upper: NDArray[np.float64], lower: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(m, p) rows C with C b >= 0 where the load makes sense; none for the lower rotor's torque."""
    u, v = (np.linspace(x.min(), x.max(), POINTS) for x in (upper, lower))
    u, v = (g.ravel() for g in np.meshgrid(u, v))
    if load.startswith("upper"):
        return np.concatenate([design_matrix(terms, u, v), _slope(terms, u, v, 0)])
    if load == "lower.thrust_N":
        return np.concatenate([_slope(terms, u, v, 1), -_slope(terms, u, v, 0)])
    return np.zeros((0, len(terms)))


def _slope(
    terms: tuple[str, ...], u: NDArray[np.float64], v: NDArray[np.float64], along: int
) -> NDArray[np.float64]:
    """(m, p) derivative of every term along u_u (0) or u_l (1)."""
    columns = []
    for a, b in map(parse_term, terms):
        power = (a, b)[along]
        lowered = (max(a - 1, 0), b) if along == 0 else (a, max(b - 1, 0))
        columns.append(power * u ** lowered[0] * v ** lowered[1])
    return np.stack(columns, axis=1)


def _holds(rows: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    values = rows @ b
    return not len(values) or bool(values.min() >= -SLACK * np.abs(values).max())


def _solve(
    X: NDArray[np.float64], y: NDArray[np.float64], weights: NDArray[np.float64], rows: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """(p,) weighted least squares under rows @ b >= 0, None when nothing but zero meets them."""
    import cvxpy as cp

    root = np.sqrt(weights / len(y))
    q, R = np.linalg.qr(X * root[:, None])
    scale = np.where((norm := np.sqrt(np.sum(R**2, axis=0))) > 0, norm, 1.0)
    z = cp.Variable(X.shape[1])
    problem = cp.Problem(
        cp.Minimize(cp.sum_squares((R / scale) @ z - q.T @ (y * root))), [(rows / scale) @ z >= 0]
    )
    solve(problem)
    if z.value is None or not np.any(np.abs(z.value) > 1e-9):
        return None
    return np.asarray(z.value / scale)
