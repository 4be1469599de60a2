"""Noise with colour: every channel's own autoregressive model, taken out of both sides of the regression.

What rings, aliases or wanders from row to row is noise. A linear prediction from the rows before leaves it
white (Box and Jenkins), and a likelihood of what is left needs no correction for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz

from coaxlink.frames import Array

Index = NDArray[np.intp]

MOST_ORDER = 6
LEAST_ROWS_PER_ORDER = 25
STABLE = 0.98  # of the reflection coefficient: noise that never forgets is a drift


@dataclass(frozen=True)
class Colour:
    """(order,) coefficients of each channel's prediction from the rows before.

    `behind` (rows,) counts the rows before each that follow one another without a gap; None: all of them.
    """

    ahead: tuple[Array, ...]
    behind: Index | None = None

    def whiten(self, columns: Array) -> Array:
        """What the prediction leaves of (rows, C, ...); nil where too few rows lie before."""
        out = np.array(columns, float)
        for c, a in enumerate(self.ahead):
            for k, weight in enumerate(a, start=1):
                out[k:, c] -= weight * columns[:-k, c]
            if self.behind is not None:
                out[self.behind < len(a), c] = 0.0
        return out


def white(channels: int) -> Colour:
    """No colour."""
    return Colour(tuple(np.zeros(0) for _ in range(channels)))


def colour_of(left: Array, behind: Index | None = None) -> Colour:
    """The models of residuals (rows, C) in the order of time; the order is chosen by the evidence (BIC)."""
    models = (_predictor(left[:, c] - np.mean(left[:, c]), behind) for c in range(left.shape[1]))
    return Colour(tuple(models), behind)


def _predictor(values: Array, behind: Index | None) -> Array:
    rows = len(values)
    most = min(MOST_ORDER, rows // LEAST_ROWS_PER_ORDER)
    near = np.arange(rows) if behind is None else behind
    covariance = np.zeros(most + 1)
    for k in range(most + 1):
        pairs = near[k:] >= k  # without a gap between them
        share = (rows - k) / max(int(pairs.sum()), 1)
        covariance[k] = share * (values[: rows - k] @ (values[k:] * pairs)) / rows
    if most < 1 or not np.all(np.isfinite(covariance)) or covariance[0] <= 0.0:
        return np.zeros(0)
    best, least = np.zeros(0), rows * np.log(covariance[0])
    for order in range(1, most + 1):
        ahead = solve_toeplitz(covariance[:order], covariance[1 : order + 1])
        variance = covariance[0] - ahead @ covariance[1 : order + 1]
        if variance <= 0.0:
            break
        cost = rows * np.log(variance) + order * np.log(rows)
        if cost < least:
            best, least = np.asarray(ahead), cost
    return best
