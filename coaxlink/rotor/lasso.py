"""Eq. 4 of Berra, Trujillo and Heredia 2024 in both of its forms.

penalty     minimise |X b - y|^2 / 2 + lambda |b|_1        the whole path, by scikit-learn's LARS
tolerance   minimise |b|_1  such that  sqrt(mean((X b - y)^2)) <= eps  (the paper's) by cvxpy; eps in N or N m

Both work on the Gram matrix G = X'X, c = X'y, so their cost does not grow with the rows. cvxpy and
scikit-learn are imported where they are used: each takes a second that most verbs need not wait for.
"""

from __future__ import annotations

import contextlib
import warnings

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ZERO = 1e-7  # of the largest term's contribution: below it a coefficient is a solver's remainder
ROUNDED = 1e-12  # of the path's largest coefficient: what rounding leaves of one that has left the path
PIVOT = 1e-13  # of a term's own square: below it the terms before it give the same column
SCALE = 1e6  # largest correlation handed to LARS, whose steps end 1e-7 above zero


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

    Between the corners that LARS finds, the minimiser goes linearly with the penalty (Efron et al. 2004).
    A term that those before it already make up is left out for good.
    """
    from sklearn import config_context
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.linear_model import lars_path_gram

    top, size = float(np.abs(c).max(initial=0.0)), float(np.diag(G).mean())
    if top <= 0.0:
        return np.zeros((len(lambdas), len(c)))
    # looking at the arguments anew for each of a thousand paths is a tenth of the time
    with warnings.catch_warnings(), config_context(skip_parameter_validation=True):
        warnings.simplefilter("ignore", ConvergenceWarning)
        falling, _, corners = lars_path_gram(c * (SCALE / top), G / size, n_samples=1, method="lasso")
    corners = np.where(np.abs(corners) > ROUNDED * np.abs(corners).max(), corners, 0.0).T  # (K, p)
    wanted = np.clip(lambdas * (SCALE / top), falling[-1], falling[0])
    after = np.clip(np.searchsorted(-falling, -wanted), 1, len(falling) - 1)
    width = falling[after - 1] - falling[after]
    share = (falling[after - 1] - wanted) / np.where(width > 0, width, 1.0)
    path = corners[after - 1] + share[:, None] * (corners[after] - corners[after - 1])
    return np.asarray(path * (top / (SCALE * size)))


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
