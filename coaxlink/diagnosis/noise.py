"""Noise with colour: every channel's own autoregressive model, taken out of both sides of the regression.

What rings, aliases or wanders from row to row is noise. A linear prediction from the rows before leaves it
white (Box and Jenkins), and a likelihood of what is left needs no correction for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from coaxlink.frames import Array

MOST_ORDER = 6
LEAST_ROWS_PER_ORDER = 25
STABLE = 0.98  # of the reflection coefficient: noise that never forgets is a drift


@dataclass(frozen=True)
class Colour:
    """(order,) coefficients of each channel's prediction from the rows before."""

    ahead: tuple[Array, ...]

    def whiten(self, columns: Array) -> Array:
        """What the prediction leaves of (rows, C, ...)."""
        out = np.empty(columns.shape)
        for c, a in enumerate(self.ahead):
            taps = np.concatenate([[1.0], -a])
            out[:, c] = lfilter(taps, [1.0], columns[:, c], axis=0) if len(a) else columns[:, c]
        return out


def white(channels: int) -> Colour:
    """No colour."""
    return Colour(tuple(np.zeros(0) for _ in range(channels)))


def colour_of(left: Array) -> Colour:
    """The models of residuals (rows, C) in the order of time; the order is chosen by the evidence (BIC)."""
    return Colour(tuple(_predictor(left[:, c] - np.mean(left[:, c])) for c in range(left.shape[1])))


def _predictor(values: Array) -> Array:
    rows = len(values)
    most = min(MOST_ORDER, rows // LEAST_ROWS_PER_ORDER)
    covariance = np.array([values[: rows - k] @ values[k:] for k in range(most + 1)]) / rows
    if covariance[0] <= 0.0 or most < 1:
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
