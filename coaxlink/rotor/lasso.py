"""Eq. 4 of Berra, Trujillo and Heredia 2024 with cvxpy, in both of its forms.

penalty     minimise |X b - y|^2 / (2 n) + lambda |b|_1
tolerance   minimise |b|_1  such that  sqrt(mean((X b - y)^2)) <= eps     (the paper's; eps in N or N m)

Both work on the Gram matrix, so their cost does not grow with the rows. The compiled path (rotor.path) gives
the same optimum; the benchmarks hold one against the other.
"""

from __future__ import annotations

import contextlib
import warnings

import numpy as np
from numpy.typing import NDArray

ZERO = 1e-7  # of the largest term's contribution: below it a coefficient is a solver's remainder


class InfeasibleTolerance(ValueError):
    """No coefficients reach the tolerance; `least` is the smallest error that any reach."""

    def __init__(self, eps: float, least: float) -> None:
        self.eps, self.least = eps, least
        super().__init__(f"a tolerance of {eps:g} cannot be met: least squares leaves {least:.4g}")


def penalty_form(X: NDArray[np.float64], y: NDArray[np.float64], lam: float) -> NDArray[np.float64]:
    """(p,) coefficients of the penalty form for a design (n, p) and a target (n,)."""
    import cvxpy as cp

    root, target = _reduced(X, y)
    b = cp.Variable(X.shape[1])
    cost = cp.sum_squares(root @ b - target) / 2 + lam * cp.norm1(b)
    solve(cp.Problem(cp.Minimize(cost)))
    return _clean(X, b.value)


def tolerance_form(X: NDArray[np.float64], y: NDArray[np.float64], eps: float) -> NDArray[np.float64]:
    """(p,) coefficients of the tolerance form. Raises InfeasibleTolerance."""
    import cvxpy as cp

    root, target = _reduced(X, y)
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
    return _clean(X, b.value)


def _reduced(
    X: NDArray[np.float64], y: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(p, p) R and (p,) q with |R b - q|^2 = |X b - y|^2 / n - const, from a QR factorisation."""
    q, root = np.linalg.qr(X / np.sqrt(len(y)))
    return root, q.T @ (y / np.sqrt(len(y)))


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


def _clean(X: NDArray[np.float64], b: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """Interior-point solvers leave remainders where the optimum is zero: set those to zero."""
    if b is None:
        raise ArithmeticError("the solver found no optimum")
    share = np.abs(b) * np.sqrt(np.mean(X**2, axis=0))
    return np.where(share > ZERO * share.max(initial=0.0), b, 0.0)
