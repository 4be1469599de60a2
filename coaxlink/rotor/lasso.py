"""Eq. 4 of Berra, Trujillo and Heredia 2024 in both of its forms.

penalty     minimise |X b - y|^2 / 2 + lambda |b|_1        the whole path, by least angle regression
tolerance   minimise |b|_1  such that  sqrt(mean((X b - y)^2)) <= eps  (the paper's) by cvxpy; eps in N or N m

Both work on the Gram matrix G = X'X, c = X'y, so their cost does not grow with the rows. cvxpy is imported
where it is used: it takes a second that most verbs need not wait for.
"""

from __future__ import annotations

import contextlib
import warnings

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ZERO = 1e-7  # of the largest term's contribution: below it a coefficient is a solver's remainder
ROUNDED = 1e-12  # of a correlation's fall with the penalty: nearer to it than rounding it never meets it
PIVOT = 1e-13  # of a term's own square: below it the terms before it give the same column
CORNERS = 500  # of one path, which a rounding error might otherwise walk for ever


class InfeasibleTolerance(ValueError):
    """No coefficients reach the tolerance; `least` is the smallest error that any reach."""

    def __init__(self, eps: float, least: float) -> None:
        self.eps, self.least = eps, least
        super().__init__(f"a tolerance of {eps:g} cannot be met: least squares leaves {least:.4g}")


def lambda_grid(c: Array, count: int, ratio: float = 1e-5) -> Array:
    """(count,) penalties from the smallest that leaves no term down to `ratio` of it, geometric."""
    top = max(float(np.abs(c).max(initial=0.0)), 1e-300)
    return np.geomspace(top, top * ratio, count)


def lasso_path(G: Array, c: Array, lambdas: Array) -> Array:
    """(L, p) minimisers of b'Gb / 2 - c'b + lambda |b|_1 for falling penalties (L,).

    Between two corners the minimiser goes linearly with the penalty. A term that those before it already make
    up is left out for good.
    """
    if not c.any():
        return np.zeros((len(lambdas), len(c)))
    falling, corners = corners_of_path(G, c)
    wanted = np.clip(lambdas, falling[-1], falling[0])
    after = np.clip(np.searchsorted(-falling, -wanted), 1, len(falling) - 1)
    width = falling[after - 1] - falling[after]
    share = (falling[after - 1] - wanted) / np.where(width > 0, width, 1.0)
    return np.asarray(corners[after - 1] + share[:, None] * (corners[after] - corners[after - 1]))


def corners_of_path(G: Array, c: Array) -> tuple[Array, Array]:
    """(K,) penalties from the largest down to 0 at which a term comes or goes, and (K, p) minimisers there.

    Least angle regression in its form for the LASSO (Efron, Hastie, Johnstone and Tibshirani 2004, sections
    2 and 3.1), from sums of squares alone: `c` must not be zero.
    """
    from scipy.linalg.lapack import dposv

    b, sign, free = np.zeros(len(c)), np.zeros(len(c)), np.ones(len(c), bool)
    penalty, joins, least = (
        float(np.abs(c).max()),
        int(np.argmax(np.abs(c))),
        float(np.diag(G).mean()) * PIVOT,
    )
    on, falling, corners, slope = list[int](), [penalty], [b.copy()], c
    for _ in range(CORNERS):
        if joins >= 0:
            on.append(joins)
            sign[joins], free[joins] = np.sign(slope[joins]), False
        factor, way, failed = dposv(G[on][:, on], sign[on])
        if joins >= 0 and (failed or factor[-1, -1] ** 2 <= least):
            on.pop()
            factor, way, failed = dposv(G[on][:, on], sign[on])
        fall = G[:, on] @ way  # of each correlation with what is left, a unit of penalty
        ends = np.full((3, len(c)), np.inf)  # where a term joins with plus, with minus; where one is at zero
        np.divide(np.maximum(penalty - slope, 0.0), 1 - fall, out=ends[0], where=free & (fall < 1 - ROUNDED))
        np.divide(np.maximum(penalty + slope, 0.0), 1 + fall, out=ends[1], where=free & (fall > ROUNDED - 1))
        back = way * sign[on] < 0.0
        ends[2, on] = np.where(back, np.abs(b[on]) / np.where(back, np.abs(way), 1.0), np.inf)
        how, term = divmod(int(np.argmin(ends)), len(c))
        step = min(float(ends[how, term]), penalty)
        b[on] += step * way
        penalty, joins = penalty - step, term
        if how == 2 and penalty > 0.0:
            on.remove(term)
            b[term], free[term], joins = 0.0, True, -1
        slope = c - G @ b
        falling.append(penalty)
        corners.append(b.copy())
        if penalty <= 0.0:
            break
    return np.array(falling), np.array(corners)


def refitted(G: Array, c: Array, path: Array) -> Array:
    """(L, p) least squares on each point's support (l1 shrinks; this undoes it); as it is when singular."""
    from scipy.linalg.lapack import dposv

    out = path.copy()
    on = path != 0.0
    as_before = np.append(False, (on[1:] == on[:-1]).all(axis=1))
    for i, same in enumerate(as_before.tolist()):
        if same:
            out[i] = out[i - 1]
            continue
        terms = np.flatnonzero(on[i])
        if not len(terms):
            continue
        part = G[terms[:, None], terms]
        factor, solution, failed = dposv(part, c[terms])
        if not failed and (factor.diagonal() ** 2 > PIVOT * part.diagonal()).all():
            out[i, terms] = solution
    return out


def tolerance_form(X: Array, y: Array, eps: float) -> Array:
    """(p,) coefficients of the tolerance form for a design (n, p) and a target (n,).

    Raises InfeasibleTolerance.
    """
    import cvxpy as cp

    q, root = np.linalg.qr(X / np.sqrt(len(y)))
    target = q.T @ (y / np.sqrt(len(y)))  # |R b - target|^2 = |X b - y|^2 / n - const
    least = np.linalg.lstsq(X, y, rcond=None)[0]
    floor = float(np.mean((X @ least - y) ** 2))
    if eps**2 < floor:
        raise InfeasibleTolerance(eps, float(np.sqrt(floor)))
    outside = max(float(np.mean(y**2) - target @ target), 0.0)  # what no combination of the terms explains
    if eps**2 - outside <= 1e-9 * eps**2:
        return np.asarray(least)
    b = cp.Variable(X.shape[1])
    bound = float(np.sqrt(eps**2 - outside))
    solve(cp.Problem(cp.Minimize(cp.norm1(b)), [cp.norm(root @ b - target) <= bound]))
    if b.value is None:
        raise ArithmeticError("the solver found no optimum")
    # interior-point solvers leave remainders where the optimum is zero
    share = np.abs(b.value) * np.sqrt(np.mean(X**2, axis=0))
    return np.where(share > ZERO * share.max(initial=0.0), b.value, 0.0)


def solve(problem: object) -> None:
    """Solve a small cvxpy problem to twelve digits, else to nine; its variables hold the result, or None."""
    import cvxpy as cp

    for digits in (1e-12, 1e-9):
        with warnings.catch_warnings(), contextlib.suppress(cp.SolverError):
            warnings.simplefilter("ignore")  # "may be inaccurate": the caller checks what it uses
            problem.solve(  # type: ignore[attr-defined]
                solver=cp.CLARABEL, tol_gap_abs=digits, tol_gap_rel=digits, tol_feas=digits
            )
            return
