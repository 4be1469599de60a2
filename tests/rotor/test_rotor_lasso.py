"""Both forms of eq. 4, against optimality conditions and each other."""

from __future__ import annotations

import numpy as np
import pytest
from rotor_bench import eq17, grid

from coaxlink.rotor.lasso import (
    InfeasibleTolerance,
    lambda_grid,
    lasso_path,
    refitted,
    tolerance_form,
)
from coaxlink.rotor.selection import _Sums
from coaxlink.rotor.stand_data import LoadRows


def lower_thrust() -> tuple[np.ndarray, np.ndarray]:
    u, v = grid()
    X = np.stack([u**a * v**b for a in range(3) for b in range(3)], axis=1)
    return X, eq17(u, v)[2] + 0.5 * np.random.default_rng(0).standard_normal(len(u))


def violation(G: np.ndarray, c: np.ndarray, lam: float, b: np.ndarray) -> float:
    """How far b is from the subgradient conditions of the LASSO, relative to the largest |c|."""
    slope = c - G @ b
    on = b != 0
    wrong = np.where(on, np.abs(slope - lam * np.sign(b)), np.maximum(np.abs(slope) - lam, 0))
    return float(wrong.max() / np.abs(c).max())


def test_every_point_of_the_path_is_the_optimum() -> None:
    for seed in range(5):
        random = np.random.default_rng(seed)
        X = random.standard_normal((60, 12)) @ random.standard_normal((12, 12))
        y = X[:, :3] @ [3, -2, 1] + random.standard_normal(60)
        G, c = X.T @ X, X.T @ y
        for size in (1.0, 1e-6, 1e6):  # newtons or newton metres, few rows or many
            lambdas = np.append(lambda_grid(size * c, 30, 1e-6), 0.0)
            path = lasso_path(G, size * c, lambdas)
            assert max(violation(G, size * c, lam, b) for lam, b in zip(lambdas, path, strict=True)) < 1e-9
            assert not path[0].any() and path[-1].all()


def test_collinear_terms_do_not_stop_the_path() -> None:
    random = np.random.default_rng(1)
    X = random.standard_normal((40, 3))
    X = np.column_stack([X, X[:, 0], np.zeros(40)])
    y = X[:, 0] + random.standard_normal(40)
    G, c = X.T @ X, X.T @ y
    lambdas = lambda_grid(c, 20, 1e-3)
    path = lasso_path(G, c, lambdas)
    assert max(violation(G, c, lam, b) for lam, b in zip(lambdas, path, strict=True)) < 1e-9
    assert not lasso_path(G, 0 * c, lambdas).any()


def test_refit_is_least_squares_on_each_support() -> None:
    X, y = lower_thrust()
    G, c = X.T @ X, X.T @ y
    path = lasso_path(G, c, lambda_grid(c, 20))
    for b, found in zip(path, refitted(G, c, path), strict=True):
        support = b != 0
        expected = np.linalg.lstsq(X[:, support], y, rcond=None)[0]
        np.testing.assert_allclose(found[support], expected, rtol=1e-6)
        assert not found[~support].any()
    twins = np.ones((2, 2))
    np.testing.assert_array_equal(refitted(twins, np.ones(2), np.array([[0.3, 0.2]])), [[0.3, 0.2]])


def test_errors_of_a_block_are_those_of_a_path_that_has_not_seen_it() -> None:
    X, y = lower_thrust()
    fold = np.repeat(np.arange(11), 11)
    rows = LoadRows("lower.thrust_N", *grid(), y, fold)
    sums = _Sums(X, rows, np.ones(len(y)), range(11))
    scale = np.sqrt(np.mean(X**2, axis=0))
    Z, z = (X / scale)[fold != 4], y[fold != 4]
    path = refitted(Z.T @ Z, Z.T @ z, lasso_path(Z.T @ Z, Z.T @ z, sums.lambdas)) / scale
    expected = [np.sum((y - X @ b)[fold == 4] ** 2) for b in path]
    np.testing.assert_allclose(sums.error(sums.path([4]), 4), expected, rtol=1e-6)
    assert sums.path([4, 7]) is sums.path([7, 4])


def test_tolerance_form_spends_all_of_its_tolerance() -> None:
    X, y = lower_thrust()
    least = np.linalg.lstsq(X, y, rcond=None)[0]
    for eps in (0.6, 2.0, 10.0):
        b = tolerance_form(X, y, eps)
        assert np.sqrt(np.mean((X @ b - y) ** 2)) == pytest.approx(eps, rel=1e-5)
        assert np.abs(b).sum() < np.abs(least).sum()
        # its Lagrange multiplier makes it a point of the penalty path: same support, same signs
        lam = np.abs(X.T @ (y - X @ b)).max()
        path = lasso_path(X.T @ X, X.T @ y, np.array([lam]))
        np.testing.assert_allclose(path[0], b, atol=2e-3 * np.abs(b).max())
    floor = np.sqrt(np.mean((X @ least - y) ** 2))
    np.testing.assert_allclose(tolerance_form(X, y, floor * (1 + 1e-12)), least)


def test_tolerance_below_least_squares_is_refused_with_the_floor() -> None:
    X, y = lower_thrust()
    with pytest.raises(InfeasibleTolerance) as caught:
        tolerance_form(X, y, 0.1)
    assert caught.value.least == pytest.approx(0.5, abs=0.1)
