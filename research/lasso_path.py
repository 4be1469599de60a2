"""A 50-penalty LASSO path on the Gram matrix, beside scikit-learn's path and cvxpy's optimum.

    python research/lasso_path.py          (needs the `bench` extra for scikit-learn)

Nine terms of eq. 3, eq. 17's lower thrust with 0.5 N of noise, 121 and 100 000 rows. Times are the least and
the median of many calls in milliseconds, Gram matrix included: on a busy machine take the least.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from sklearn.linear_model import lasso_path as sklearn_path

from coaxlink.rotor.lasso import penalty_form
from coaxlink.rotor.path import gram, lambda_grid, lasso_path

PENALTIES = 50
CHECKED = (1, 10, 20, 30, 40, 49)


def design(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Standardised terms (rows, 9) and thrust (rows,)."""
    random = np.random.default_rng(0)
    u, v = random.uniform(0, 0.9, (2, rows))
    X = np.stack([u**a * v**b for a in range(3) for b in range(3)], axis=1)
    y = 2.755 * u**2 * v**2 + 64.721 * v**2 - 2.547 * u * v + 12.402 * v - 37.502 * u**2 + 0.801
    X = np.ascontiguousarray(X / np.sqrt((X**2).mean(axis=0)))
    return X, y + 0.5 * random.standard_normal(rows)


def timed(call: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Least and median time of a call, ms."""
    call()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(1e3 * (time.perf_counter() - start))
    return min(times), float(np.median(times))


def cost(X: np.ndarray, y: np.ndarray, b: np.ndarray, lam: float) -> float:
    """What is minimised."""
    return float(np.mean((X @ b - y) ** 2) / 2 + lam * np.abs(b).sum())


def main() -> None:
    """Print both sizes."""
    for rows in (121, 100_000):
        X, y = design(rows)
        lambdas = lambda_grid(gram(X, y)[1], PENALTIES)

        def ours(X: np.ndarray = X, y: np.ndarray = y, lambdas: np.ndarray = lambdas) -> np.ndarray:
            G, c = gram(X, y)
            return lasso_path(G, c, lambdas)

        def theirs(X: np.ndarray = X, y: np.ndarray = y, lambdas: np.ndarray = lambdas) -> np.ndarray:
            return sklearn_path(X, y, alphas=lambdas, precompute=X.T @ X, Xy=X.T @ y)[1].T

        path, reference = ours(), theirs()
        mine, sk = timed(ours, 200), timed(theirs, 10)
        start = time.perf_counter()
        exact = {i: penalty_form(X, y, lambdas[i]) for i in CHECKED}
        per_solve = 1e3 * (time.perf_counter() - start) / len(CHECKED)
        gap = max(
            abs(cost(X, y, path[i], lambdas[i]) / cost(X, y, b, lambdas[i]) - 1) for i, b in exact.items()
        )
        far = max(np.abs(path[i] - b).max() / np.abs(b).max() for i, b in exact.items() if b.any())
        worse = max(
            cost(X, y, r, lam) / cost(X, y, p, lam) - 1
            for r, p, lam in zip(reference, path, lambdas, strict=True)
        )
        print(f"{rows} rows, {PENALTIES} penalties, 9 terms")
        print(f"  ours           {mine[0]:9.3f} least {mine[1]:9.3f} median   ms")
        print(
            f"  scikit-learn   {sk[0]:9.3f} least {sk[1]:9.3f} median   ms, {sk[0] / mine[0]:.0f} times ours"
        )
        print(f"  cvxpy          {per_solve * PENALTIES:9.0f} for 50 solves        ms, ", end="")
        print(f"{per_solve * PENALTIES / mine[0]:.0f} times ours")
        print(f"  cost beside cvxpy's optimum {gap:.1e} (relative), coefficients {far:.1e}")
        print(f"  scikit-learn's cost above ours, at most {worse:.1e}\n")


if __name__ == "__main__":
    main()
