"""The compiled LASSO path and the two forms of eq. 4, against optimality conditions and each other."""

from __future__ import annotations

import numpy as np
import pytest
from rotor_bench import eq17, grid

from coaxlink.rotor.lasso import InfeasibleTolerance, penalty_form, tolerance_form
from coaxlink.rotor.path import gram, lambda_grid, lasso_path, refit

POWERS = [(a, b) for a in range(3) for b in range(3)]


def design(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.stack([u**a * v**b for a, b in POWERS], axis=1)


def lower_thrust(seed: int = 0, sigma: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    u, v = grid()
    return design(u, v), eq17(u, v)[2] + sigma * np.random.default_rng(seed).standard_normal(len(u))


def violation(G: np.ndarray, c: np.ndarray, lam: float, b: np.ndarray) -> float:
    """How far b is from the subgradient conditions of the LASSO, relative to the largest |c|."""
    slope = c - G @ b
    on = b != 0
    wrong = np.where(on, np.abs(slope - lam * np.sign(b)), np.maximum(np.abs(slope) - lam, 0))
    return float(wrong.max() / np.abs(c).max())


@pytest.mark.parametrize("rows", [1, 127, 128, 129, 1000])
def test_gram_is_the_product(rows: int) -> None:
    random = np.random.default_rng(rows)
    X, y, w = random.standard_normal((rows, 9)), random.standard_normal(rows), random.uniform(0, 2, rows)
    for weights, W in ((None, np.eye(rows)), (w, np.diag(w))):
        G, c = gram(np.asfortranarray(X), y, weights)
        np.testing.assert_allclose(G, X.T @ W @ X / rows, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(c, X.T @ W @ y / rows, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("seed", range(5))
def test_every_point_of_the_path_is_the_optimum(seed: int) -> None:
    random = np.random.default_rng(seed)
    n, p = 60, 12
    X = random.standard_normal((n, p)) @ random.standard_normal((p, p))
    y = X[:, :3] @ [3, -2, 1] + random.standard_normal(n)
    G, c = gram(X, y)
    lambdas = lambda_grid(c, 30, 1e-6)
    path = lasso_path(G, c, lambdas)
    assert max(violation(G, c, lam, b) for lam, b in zip(lambdas, path, strict=True)) < 1e-9
    assert not path[0].any()


def test_collinear_terms_do_not_stop_the_path() -> None:
    random = np.random.default_rng(1)
    X = random.standard_normal((40, 3))
    X = np.column_stack([X, X[:, 0], X[:, 1] + X[:, 2], np.zeros(40)])
    y = X[:, 0] + random.standard_normal(40)
    G, c = gram(X, y)
    lambdas = lambda_grid(c, 20, 1e-3)
    path = lasso_path(G, c, lambdas)
    assert np.isfinite(path).all()
    assert max(violation(G, c, lam, b) for lam, b in zip(lambdas, path, strict=True)) < 1e-6


def test_path_and_cvxpy_agree() -> None:
    X, y = lower_thrust()
    G, c = gram(X, y)
    for lam in (3.0, 0.3, 0.03, 0.003):
        mine = lasso_path(G, c, np.array([lam]))[0]
        theirs = penalty_form(X, y, lam)
        assert ((mine != 0) == (theirs != 0)).all()
        np.testing.assert_allclose(mine, theirs, rtol=1e-5, atol=1e-5)

        def cost(b: np.ndarray, lam: float = lam) -> float:
            return float(np.mean((X @ b - y) ** 2) / 2 + lam * np.abs(b).sum())

        assert cost(mine) == pytest.approx(cost(theirs), rel=1e-6)


def test_refit_is_least_squares_on_the_support() -> None:
    X, y = lower_thrust()
    G, c = gram(X, y)
    b = lasso_path(G, c, np.array([0.05]))[0]
    support = b != 0
    expected = np.linalg.lstsq(X[:, support], y, rcond=None)[0]
    np.testing.assert_allclose(refit(G, c, b)[support], expected, rtol=1e-6)


@pytest.mark.parametrize("eps", [0.6, 2.0, 10.0])
def test_tolerance_form_spends_all_of_its_tolerance(eps: float) -> None:
    X, y = lower_thrust()
    b = tolerance_form(X, y, eps)
    assert np.sqrt(np.mean((X @ b - y) ** 2)) == pytest.approx(eps, rel=1e-5)
    least = np.linalg.lstsq(X, y, rcond=None)[0]
    assert np.abs(b).sum() < np.abs(least).sum()
    # its Lagrange multiplier makes it a point of the penalty path: same support, same signs
    slope = X.T @ (y - X @ b) / len(y)
    lam = np.abs(slope).max()
    np.testing.assert_allclose(lasso_path(*gram(X, y), np.array([lam]))[0], b, atol=2e-3 * np.abs(b).max())


def test_tolerance_below_least_squares_is_refused_with_the_floor() -> None:
    X, y = lower_thrust()
    with pytest.raises(InfeasibleTolerance) as caught:
        tolerance_form(X, y, 0.1)
    assert caught.value.least == pytest.approx(0.5, abs=0.1)


def test_raw_terms_keep_the_linear_ones_at_ten_newton() -> None:
    """Contradiction 3: relaxing the tolerance does not leave the paper's squares."""
    X, y = lower_thrust(sigma=0.0)
    b = dict(zip(POWERS, tolerance_form(X, y, 10.0), strict=True))
    assert b[(0, 1)] > 15 and abs(b[(1, 0)]) > 5
    assert abs(b[(2, 0)]) < 5
