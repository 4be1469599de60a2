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
    `begins` are predictions from fewer rows, behind a gap: coefficients, and the deviation of the noise over
    that of the prediction's error (Levinson's recursion).
    """

    ahead: tuple[Array, ...]
    behind: Index | None = None
    begins: tuple[tuple[tuple[Array, float], ...], ...] = ()

    @property
    def size(self) -> int:
        """Count of its numbers."""
        return sum(len(a) for a in self.ahead)

    def whiten(self, columns: Array) -> Array:
        """What the prediction leaves of (rows, C, ...), of the noise's own size also behind a gap."""
        out = np.array(columns, float)
        for c, a in enumerate(self.ahead):
            for k, weight in enumerate(a, start=1):
                out[k:, c] -= weight * columns[:-k, c]
            for k, (few, scale) in enumerate(self._begins(c)):
                at = np.flatnonzero(self.behind == k)
                out[at, c] = columns[at, c]
                for j, weight in enumerate(few, start=1):
                    out[at, c] -= weight * columns[at - j, c]
                out[at, c] *= scale
        return out

    @property
    def log_scale(self) -> float:
        """Log of the density's change by the rows behind gaps that were scaled."""
        if self.behind is None:
            return 0.0
        counts = np.bincount(np.minimum(self.behind, MOST_ORDER), minlength=MOST_ORDER + 1)
        each = (
            counts[k] * np.log(s) for c in range(len(self.ahead)) for k, (_, s) in enumerate(self._begins(c))
        )
        return float(sum(each))

    def _begins(self, channel: int) -> tuple[tuple[Array, float], ...]:
        return self.begins[channel] if self.begins and self.behind is not None else ()


def white(channels: int) -> Colour:
    """No colour."""
    return Colour(tuple(np.zeros(0) for _ in range(channels)))


def colour_of(left: Array, behind: Index | None = None) -> Colour:
    """The models of residuals (rows, C) in the order of time; the order is chosen by the evidence (BIC)."""
    models = [_predictor(left[:, c] - np.mean(left[:, c]), behind) for c in range(left.shape[1])]
    ahead, begins = tuple(m[0] for m in models), tuple(m[1] for m in models)
    return Colour(ahead, behind, begins)


def _predictor(values: Array, behind: Index | None) -> tuple[Array, tuple[tuple[Array, float], ...]]:
    rows = len(values)
    most = min(MOST_ORDER, rows // LEAST_ROWS_PER_ORDER)
    near = np.arange(rows) if behind is None else behind
    covariance = np.zeros(most + 1)
    for k in range(most + 1):
        pairs = near[k:] >= k  # without a gap between them
        share = (rows - k) / max(int(pairs.sum()), 1)
        covariance[k] = share * (values[: rows - k] @ (values[k:] * pairs)) / rows
    if most < 1 or not np.all(np.isfinite(covariance)) or covariance[0] <= 0.0:
        return np.zeros(0), ()
    ladder = [(np.zeros(0), float(covariance[0]))]
    best, least = 0, rows * np.log(covariance[0])
    for order in range(1, most + 1):
        ahead = solve_toeplitz(covariance[:order], covariance[1 : order + 1])
        variance = covariance[0] - ahead @ covariance[1 : order + 1]
        if variance <= 0.0:
            break
        cost = rows * np.log(variance) + order * np.log(rows)
        ladder.append((np.asarray(ahead), float(variance)))
        if cost < least:
            best, least = order, cost
    final = ladder[best][1]
    return ladder[best][0], tuple((a, float(np.sqrt(final / v))) for a, v in ladder[:best])
