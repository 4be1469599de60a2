"""How well a model is known: errors on rows held out, the noise beneath them, intervals of coefficients.

An interval that takes the chosen terms for granted is far too narrow: on 121 points at 0.5 N it holds u_u^2
of eq. 17's lower thrust in 36 draws of 100, because which terms stand beside it was decided on the same data.
So an interval is that of the whole dictionary, and only models whose every value lies inside its own interval
are chosen. Standard errors are those of a bootstrap of residual blocks, in closed form: what infinitely many
draws would give. A block is one row unless neighbouring residuals are alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NORMALISER = "max - min of the held-out measurements"  # the paper's Table 2 uses two and names neither
TOGETHER = 0.9  # estimates that move together this closely are one direction of the data
ROUNDING = 1e-6  # relative, of a fit on a Gram matrix: the root of a double's, times its condition
# a difference in one block alone is one standard error exactly: rounding must not decide about it
ONE_STANDARD_ERROR = 1.0 + 1e-9
SINGULAR = 1e-6  # of the largest singular value of the standardised terms


@dataclass(frozen=True)
class HeldOutError:
    """Error of one channel on rows that the fit did not use, as the paper's Table 2 gives it."""

    rmse: float  # N or N m
    nrmse: float  # rmse / (max - min of the held-out measurements)
    r: float  # Pearson correlation of measured and predicted
    held_out_rows: int

    def as_json(self) -> dict[str, float | int]:
        """Plain numbers for the JSON report."""
        return {"rmse": self.rmse, "nrmse": self.nrmse, "r": self.r, "held_out_rows": self.held_out_rows}


def held_out_error(measured: Array, predicted: Array) -> HeldOutError:
    """Error over the rows (n,) in which both are known (not NaN)."""
    known = np.isfinite(measured) & np.isfinite(predicted)
    y, p = measured[known], predicted[known]
    if not len(y):
        return HeldOutError(0.0, 0.0, 0.0, 0)
    rmse = float(np.sqrt(np.mean((y - p) ** 2)))
    span = float(np.ptp(y))
    spread = float(np.std(y) * np.std(p))
    r = float(np.mean((y - y.mean()) * (p - p.mean())) / spread) if spread > 0 else 0.0
    return HeldOutError(rmse, rmse / span if span > 0 else 0.0, r, len(y))


def standard_errors_above(errors: Array, other: Array) -> Array:
    """(m,) by how many standard errors of the paired difference over blocks (K, m) exceed others (K,)."""
    difference = errors - other[:, None]
    total = difference.sum(axis=0)
    count = len(difference)
    spread = difference.std(axis=0, ddof=1) * np.sqrt(count) if count > 1 else np.zeros(len(total))
    certain = np.where(total == 0.0, 0.0, np.copysign(np.inf, total))
    return np.where(spread > 0, total / np.where(spread > 0, spread, 1.0), certain)


def noise_floor(upper: Array, lower: Array, residual: Array) -> float:
    """Root mean square of the noise in one channel, from differences between nearest neighbours.

    Speeds and residual of a rich fit are (n,): what neighbours do not share is noise.
    """
    from scipy.spatial import cKDTree

    known = np.isfinite(residual)
    points = np.column_stack([upper[known], lower[known]])
    values = residual[known]
    if len(values) < 4:
        return 0.0
    _, index = cKDTree(points).query(points, k=2)
    own = np.arange(len(values))
    other = np.where(index[:, 0] == own, index[:, 1], index[:, 0])
    pairs = np.unique(np.sort(np.column_stack([own, other]), axis=1), axis=0)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    difference = values[pairs[:, 0]] - values[pairs[:, 1]]
    return float(np.sqrt(np.mean(difference**2) / 2))


@dataclass(frozen=True)
class Intervals:
    """95 % intervals of every coefficient of a dictionary."""

    bounds: Mapping[str, tuple[float, float]]  # N or N m; no entry for what the data leave open
    standard_error: Mapping[str, float]
    indistinct: tuple[tuple[str, ...], ...] = ()  # terms of which the data only determine a combination

    def as_json(self) -> dict[str, list[float]]:
        """The bounds as plain numbers."""
        return {term: list(bound) for term, bound in self.bounds.items()}

    def holds(self, values: Mapping[str, float]) -> bool:
        """Whether every coefficient of a model lies inside its interval, to the rounding of a Gram matrix.

        A log without noise has intervals of no width.
        """
        room = ROUNDING * max(map(abs, values.values()), default=0.0)
        unbounded = (-np.inf, np.inf)
        ranges = [(v, self.bounds.get(term, unbounded)) for term, v in values.items()]
        return all(low - room <= v <= high + room for v, (low, high) in ranges)


def term_intervals(terms: Sequence[str], X: Array, y: Array, weights: Array) -> Intervals:
    """Intervals for the terms of a design (n, p), rows in the order they were measured; weights (n,)."""
    from scipy.special import stdtrit

    root = np.sqrt(weights)
    A = X * root[:, None]
    scale = np.where((norm := np.sqrt(np.mean(A**2, axis=0))) > 0, norm, 1.0)
    left, singular, right = np.linalg.svd(A / scale, full_matrices=False)
    sound = singular > SINGULAR * singular.max(initial=0.0)
    inverse = (right[sound].T / singular[sound]) @ left[:, sound].T / scale[:, None]  # (p, n)
    open_terms = 1.0 - np.sum(right[sound] ** 2, axis=0) > 1e-6  # (p,) with a share in what no row tells
    b = inverse @ (y * root)
    degrees = max(len(y) - X.shape[1], 1)
    residual = root * (y - X @ b)
    residual = residual * np.sqrt(len(y) / degrees)  # least squares has taken p of the n degrees of freedom
    covariance = _block_covariance(inverse, residual, _block_length(residual))
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    half = float(stdtrit(degrees, 0.975)) * error
    determined = [i for i in range(len(terms)) if not open_terms[i]]
    return Intervals(
        {terms[i]: (float(b[i] - half[i]), float(b[i] + half[i])) for i in determined},
        {terms[i]: float(error[i]) for i in determined},
        _indistinct(terms, inverse @ inverse.T, b, half, open_terms),
    )


def _block_length(residual: Array) -> int:
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


def _block_covariance(inverse: Array, residual: Array, length: int) -> Array:
    """(p, p) covariance of inverse @ e over all e made of residual blocks that wrap round the end."""
    from scipy.linalg import toeplitz

    n = len(residual)
    centred = residual - residual.mean()
    alike = np.array([centred @ np.roll(centred, lag) / n for lag in range(length)])
    if length == 1:
        return np.asarray(alike[0] * inverse @ inverse.T)
    correlation = toeplitz(alike)
    total = np.zeros((len(inverse), len(inverse)))
    for start in range(0, n, length):
        part = inverse[:, start : start + length]
        total += part @ correlation[: part.shape[1], : part.shape[1]] @ part.T
    return total


def _indistinct(
    terms: Sequence[str], covariance: Array, b: Array, half: Array, open_terms: NDArray[np.bool_]
) -> tuple[tuple[str, ...], ...]:
    """Groups of terms that are undetermined one by one and whose estimates move together."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    alike = np.abs(covariance / np.outer(deviation, deviation)) > TOGETHER
    undetermined = (np.abs(b) < half) | open_terms
    alike |= np.outer(open_terms, open_terms)
    groups: list[set[int]] = []
    for i in np.flatnonzero(undetermined):
        joined = {int(i), *(int(j) for j in np.flatnonzero(alike[i] & undetermined))}
        for group in [g for g in groups if g & joined]:
            joined |= group
            groups.remove(group)
        groups.append(joined)
    return tuple(tuple(terms[i] for i in sorted(group)) for group in groups if len(group) > 1)
