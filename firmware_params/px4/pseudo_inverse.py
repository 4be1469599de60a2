"""The pseudo-inverse as PX4 forms it: full-rank Cholesky in float32.

P. Courrieu, "Fast computation of Moore-Penrose inverse matrices", arXiv:0804.4809: with G G' = L L', rank r,
G+ = G' L (L'L)^-1 (L'L)^-1 L'. Rank and rounding decide what a nearly singular table becomes, so both follow
PX4: sums run one term after the other in float32, and a pivot counts when it exceeds n * eps * the largest
diagonal entry.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

EPS = np.finfo(np.float32).eps


def pseudo_inverse(matrix: Floats) -> Floats:
    """(N, M) pseudo-inverse of a float32 (M, N), M <= N; zeros where PX4 gives up on a singular one."""
    rows, columns = matrix.shape
    factor = full_rank_cholesky(_product(matrix, matrix.T))
    rank = factor.shape[1]
    core = _inverse(_product(factor.T, factor))
    if core is None or not rank:
        return np.zeros((columns, rows), np.float32)
    right = _product(_product(core, core), factor.T)
    return _product(matrix.T, _product(factor, right))


def full_rank_cholesky(square: Floats) -> Floats:
    """(M, r) lower factor of a positive semi-definite float32 (M, M), dependent columns left out."""
    size = square.shape[0]
    tolerance = np.float32(size) * EPS * square.diagonal().max()
    factor = np.zeros((size, size), np.float32)
    rank = 0
    for k in range(size):
        column = square[k:, k].copy()
        if rank:
            column -= _product(factor[k:, :rank], factor[k : k + 1, :rank].T)[:, 0]
        factor[k:, rank] = column
        if column[0] > tolerance:
            factor[k, rank] = np.sqrt(column[0])
            factor[k + 1 :, rank] = column[1:] / factor[k, rank]
            rank += 1
        else:
            factor[k:, rank] = 0.0
    return factor[:, :rank]


def _product(a: Floats, b: Floats) -> Floats:
    total = np.zeros((a.shape[0], b.shape[1]), np.float32)
    for j in range(a.shape[1]):
        total += np.outer(a[:, j], b[j])
    return total


def _inverse(square: Floats) -> Floats | None:
    """Inverse by elimination without pivoting (L'L has a positive diagonal), None when it is singular."""
    size = square.shape[0]
    upper, lower = square.copy(), np.eye(size, dtype=np.float32)
    for n in range(size):
        if abs(upper[n, n]) < EPS:
            return None
        for i in range(n + 1, size):
            lower[i, n] = upper[i, n] / upper[n, n]
            upper[i, n:] -= lower[i, n] * upper[n, n:]
    result = np.eye(size, dtype=np.float32)
    for i in range(size):
        for j in range(i):
            result[i] -= lower[i, j] * result[j]
    for i in reversed(range(size)):
        for j in range(i + 1, size):
            result[i] -= upper[i, j] * result[j]
        result[i] /= upper[i, i]
    return result if np.isfinite(result).all() else None
