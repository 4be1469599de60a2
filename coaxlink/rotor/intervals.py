"""Intervals for coefficients, and the terms that the data cannot tell apart.

They are those of the whole dictionary, not of the chosen support: an interval that forgets that its terms
were chosen on the same data is too narrow. Standard errors come from a bootstrap of residual blocks; a block
is one row unless neighbouring residuals are alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

DRAWS = 2000
CORRELATED = 0.9  # estimates that move together this closely are one direction of the data


@dataclass(frozen=True)
class Intervals:
    """95 % intervals of every coefficient of a dictionary."""

    bounds: Mapping[str, tuple[float, float]]  # N or N m
    estimate: Mapping[str, float]  # least squares on the whole dictionary
    standard_error: Mapping[str, float]
    indistinct: tuple[tuple[str, ...], ...]  # terms of which the data only determine a combination
    block_rows: int  # rows in a bootstrap block


def term_intervals(
    terms: Sequence[str],
    X: NDArray[np.float64],
    y: NDArray[np.float64],
    weights: NDArray[np.float64],
    *,
    seed: int = 0,
    draws: int = DRAWS,
) -> Intervals:
    """Intervals for the terms of a design (n, p), rows in the order they were measured; weights (n,)."""
    from scipy.stats import t as student

    root = np.sqrt(weights)
    A = X * root[:, None]
    scale = np.where((norm := np.sqrt(np.mean(A**2, axis=0))) > 0, norm, 1.0)
    inverse = np.linalg.pinv(A / scale) / scale[:, None]  # (p, n)
    b = inverse @ (y * root)
    spare = max(len(y) - X.shape[1], 1)
    residual = root * (y - X @ b)
    residual = residual * np.sqrt(len(y) / spare)  # least squares has taken p of the n degrees of freedom
    length = _block_length(residual)
    resampled = _resample(residual - residual.mean(), length, draws, np.random.default_rng(seed))
    error = (inverse @ resampled.T).std(axis=1)
    half = float(student.ppf(0.975, spare)) * error
    return Intervals(
        {t: (float(v - h), float(v + h)) for t, v, h in zip(terms, b, half, strict=True)},
        dict(zip(terms, map(float, b), strict=True)),
        dict(zip(terms, map(float, error), strict=True)),
        _indistinct(terms, inverse @ inverse.T, b, half),
        length,
    )


def _block_length(residual: NDArray[np.float64]) -> int:
    """1 for residuals whose neighbours have nothing in common, else the span over which they are alike."""
    n = len(residual)
    centred = residual - residual.mean()
    power = float(centred @ centred)
    if power <= 0 or n < 20:
        return 1
    lag1 = float(centred[1:] @ centred[:-1]) / power
    if abs(lag1) < 2.6 / np.sqrt(n):  # chance exceeds this once in a hundred
        return 1
    length = int(np.ceil((1 + abs(lag1)) / (1 - min(abs(lag1), 0.95)) * n ** (1 / 3) / 2))
    return int(np.clip(length, 2, n // 6))


def _resample(
    residual: NDArray[np.float64], length: int, draws: int, random: np.random.Generator
) -> NDArray[np.float64]:
    """(draws, n) residuals drawn in blocks, wrapping round the end."""
    n = len(residual)
    starts = random.integers(0, n, (draws, -(-n // length)))
    index = (starts[:, :, None] + np.arange(length)).reshape(draws, -1)[:, :n] % n
    return np.asarray(residual[index])


def _indistinct(
    terms: Sequence[str], covariance: NDArray[np.float64], b: NDArray[np.float64], half: NDArray[np.float64]
) -> tuple[tuple[str, ...], ...]:
    """Groups of terms that are undetermined one by one and whose estimates move together."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    alike = np.abs(covariance / np.outer(deviation, deviation)) > CORRELATED
    undetermined = np.abs(b) < half
    groups: list[set[int]] = []
    for i in np.flatnonzero(undetermined):
        joined = {int(i), *(int(j) for j in np.flatnonzero(alike[i] & undetermined))}
        for group in [g for g in groups if g & joined]:
            joined |= group
            groups.remove(group)
        groups.append(joined)
    return tuple(tuple(terms[i] for i in sorted(group)) for group in groups if len(group) > 1)
