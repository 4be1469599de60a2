"""The LASSO path on the Gram matrix, compiled and exact.

minimise over b   b'Gb / 2 - c'b + lambda |b|_1,   G = X'WX / n,  c = X'Wy / n

(Berra, Trujillo and Heredia 2024, eq. 4, in its penalty form.) Each point is found by feature-sign search
from the one before: small linear systems on the active terms, exact to rounding. Coordinate descent takes
over where terms are collinear. Past the Gram matrix the cost does not depend on the number of rows.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

SWEEPS = 100_000
TILE = 128  # rows
TOLERANCE = 1e-10  # of the largest |c|, on the optimality conditions


def gram(
    X: NDArray[np.float64], y: NDArray[np.float64], weights: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(p, p) X'WX / n and (p,) X'Wy / n of a design (n, p), a target (n,) and weights (n,)."""
    if weights is not None:
        root = np.sqrt(weights)
        X, y = X * root[:, None], y * root
    G, c = _gram(np.ascontiguousarray(X, np.float64), np.ascontiguousarray(y, np.float64))
    return G, c


@njit(cache=True, fastmath=True)
def _gram(X, y):  # type: ignore[no-untyped-def]
    """In tiles that stay in cache, on one thread: a threaded product waits for its slowest part."""
    n, p = X.shape
    G, c = np.zeros((p, p)), np.zeros(p)
    tile = np.empty((p + 1, TILE))
    for start in range(0, n, TILE):
        rows = min(TILE, n - start)
        for i in range(rows):
            for j in range(p):
                tile[j, i] = X[start + i, j]
            tile[p, i] = y[start + i]
        for j in range(p + 1):
            for k in range(min(j, p - 1) + 1):
                total = 0.0
                for i in range(rows):
                    total += tile[j, i] * tile[k, i]
                if j < p:
                    G[j, k] += total
                else:
                    c[k] += total
    for j in range(p):
        for k in range(j):
            G[k, j] = G[j, k]
    return G / n, c / n


def lambda_grid(c: NDArray[np.float64], count: int = 50, ratio: float = 1e-5) -> NDArray[np.float64]:
    """(count,) penalties from the smallest that leaves no term down to `ratio` of it, geometric."""
    top = max(float(np.abs(c).max(initial=0.0)), 1e-300)
    return np.geomspace(top, top * ratio, count)


@njit(cache=True)
def _solve_active(G, c, lam, sign, active, count, out):  # type: ignore[no-untyped-def]
    """Solve G_AA b = c_A - lam sign_A by Cholesky; False when G_AA is singular to rounding."""
    L = np.zeros((count, count))
    z = np.zeros(count)
    for i in range(count):
        for j in range(i + 1):
            total = G[active[i], active[j]]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                if total <= 1e-13 * G[active[i], active[i]]:
                    return False
                L[i, i] = np.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    for i in range(count):
        total = c[active[i]] - lam * sign[active[i]]
        for k in range(i):
            total -= L[i, k] * z[k]
        z[i] = total / L[i, i]
    for i in range(count - 1, -1, -1):
        total = z[i]
        for k in range(i + 1, count):
            total -= L[k, i] * out[k]
        out[i] = total / L[i, i]
    return True


@njit(cache=True)
def _best_step(G, c, lam, b, target, active, count):  # type: ignore[no-untyped-def]
    """Move b towards `target` on the active set, to the lowest of the points where a sign would flip."""
    p = len(c)
    start = b.copy()
    best_value = np.inf
    for candidate in range(count + 1):
        t = 1.0
        if candidate < count:
            j = active[candidate]
            if start[j] * target[candidate] >= 0:
                continue
            t = start[j] / (start[j] - target[candidate])
        point = np.zeros(p)
        for i in range(count):
            point[active[i]] = start[active[i]] + t * (target[i] - start[active[i]])
        if candidate < count:
            point[active[candidate]] = 0.0
        value = 0.5 * point @ (G @ point) - c @ point + lam * np.abs(point).sum()
        if value < best_value:
            best_value = value
            b[:] = point


@njit(cache=True)
def _feature_sign(G, c, lam, b, tolerance):  # type: ignore[no-untyped-def]
    """Feature-sign search (Lee et al. 2006) from b; False when it stalls on collinear terms."""
    p = len(c)
    active = np.zeros(p, np.int64)
    sign = np.sign(b)
    target = np.zeros(p)
    for _ in range(20 * p + 20):
        count = 0
        for j in range(p):
            if sign[j] != 0.0:
                active[count] = j
                count += 1
        if count and not _solve_active(G, c, lam, sign, active, count, target):
            return False
        flips = False
        for i in range(count):
            flips = flips or target[i] * sign[active[i]] < 0
        if flips:
            _best_step(G, c, lam, b, target, active, count)
            for j in range(p):
                sign[j] = np.sign(b[j])
            continue
        for i in range(count):
            b[active[i]] = target[i]
        worst, entering = lam + tolerance, -1
        for j in range(p):
            if sign[j] == 0.0:
                gradient = c[j]
                for i in range(count):
                    gradient -= G[j, active[i]] * target[i]
                if abs(gradient) > worst:
                    worst, entering = abs(gradient), j
                    entering_sign = np.sign(gradient)
        if entering < 0:
            return True
        sign[entering] = entering_sign
    return False


@njit(cache=True)
def _descend(G, c, lam, b, tolerance):  # type: ignore[no-untyped-def]
    """Coordinate descent: slow, but at home on collinear terms too."""
    p = len(c)
    slope = c - G @ b
    for _ in range(SWEEPS):
        largest = 0.0
        for j in range(p):
            if G[j, j] <= 0.0:
                continue
            old = b[j]
            pull = slope[j] + G[j, j] * old
            new = 0.0
            if pull > lam:
                new = (pull - lam) / G[j, j]
            elif pull < -lam:
                new = (pull + lam) / G[j, j]
            if new != old:
                change = new - old
                b[j] = new
                for k in range(p):
                    slope[k] -= G[k, j] * change
                largest = max(largest, abs(change) * G[j, j])
        if largest < tolerance:
            return


@njit(cache=True)
def lasso_path(G, c, lambdas):  # type: ignore[no-untyped-def]
    """(L, p) minimisers for falling penalties (L,), each started from the one before."""
    out = np.zeros((len(lambdas), len(c)))
    b = np.zeros(len(c))
    tolerance = TOLERANCE * np.abs(c).max()
    for i in range(len(lambdas)):
        trial = b.copy()
        if _feature_sign(G, c, lambdas[i], trial, tolerance):
            b[:] = trial
        else:
            _descend(G, c, lambdas[i], b, tolerance)
        out[i] = b
    return out


@njit(cache=True)
def refit(G, c, b):  # type: ignore[no-untyped-def]
    """(p,) least squares on the support of b (L1 shrinks; this undoes it); b itself when singular."""
    p = len(c)
    active = np.zeros(p, np.int64)
    count = 0
    for j in range(p):
        if b[j] != 0.0:
            active[count] = j
            count += 1
    solution = np.zeros(max(count, 1))
    if count == 0 or not _solve_active(G, c, 0.0, np.zeros(p), active, count, solution):
        return b.copy()
    out = np.zeros(p)
    for i in range(count):
        out[active[i]] = solution[i]
    return out


@njit(cache=True)
def refit_path(G, c, path):  # type: ignore[no-untyped-def]
    """(L, p) least squares on each point's support; equal neighbours are solved once."""
    out = np.zeros(path.shape)
    for i in range(len(path)):
        same = i > 0
        if same:
            for j in range(path.shape[1]):
                if (path[i, j] != 0.0) != (path[i - 1, j] != 0.0):
                    same = False
                    break
        out[i] = out[i - 1] if same else refit(G, c, path[i])
    return out


@njit(cache=True)
def block_errors(G_blocks, c_blocks, yy_blocks, lambdas):  # type: ignore[no-untyped-def]
    """(K, L) weighted squared error on each block of the refitted path found without it.

    The blocks' Gram matrices (K, p, p), (K, p) and squares (K,) are sums over rows, not means.
    """
    K = len(yy_blocks)
    G_all, c_all = G_blocks.sum(axis=0), c_blocks.sum(axis=0)
    out = np.zeros((K, len(lambdas)))
    for k in range(K):
        rows_left = G_all - G_blocks[k]
        target_left = c_all - c_blocks[k]
        path = refit_path(rows_left, target_left, lasso_path(rows_left, target_left, lambdas))
        for i in range(len(lambdas)):
            b = path[i]
            out[k, i] = max(yy_blocks[k] - 2 * (c_blocks[k] @ b) + b @ (G_blocks[k] @ b), 0.0)
    return out
