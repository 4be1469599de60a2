"""Noise with colour: white, a slow wander and what rings, taken out of both sides of the regression.

Every channel's noise is white noise beside an Ornstein-Uhlenbeck process (a cell's wander, weather) seen
through a damped oscillation or two (a rig that rings, a filter). What the rows before foretell is taken off;
a likelihood of the innovations that are left needs no correction for it (Box and Jenkins 1970, ch. 7).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from coaxlink.frames import Array

COLOUR_ROUNDS = 2  # what is left of the best set says what the noise is (effort)
MOST_ORDER = 6  # of what rings: three oscillations
LEAST_ROWS_PER_ORDER = 25
# of the wander, grids of its likelihood: rows after which it is forgotten, as shares of the log (longer is a
# trend, and no noise), and the share of a surprise that is the wander's
FORGETS, GAINS = (0.005, 0.015, 0.05, 0.15), (0.01, 0.03, 0.1, 0.3)
LEAST_FORGETS = 4.0  # rows: faster is what rings


@dataclass(frozen=True)
class Colour:
    """Each channel's prediction from the rows before: `wander` (keeps, forgets) or None, then `ahead`
    (order,).

    Of white noise and a wander the innovations are e_k = y_k - keeps y_(k-1) + forgets e_(k-1) (ARMA(1, 1)).
    """

    ahead: tuple[Array, ...]
    wander: tuple[tuple[float, float] | None, ...]
    share: tuple[float, ...] = ()  # of each channel's rows that count; (): all

    @property
    def size(self) -> int:
        """Count of its numbers."""
        return sum(len(a) for a in self.ahead) + 2 * sum(w is not None for w in self.wander)

    def rows(self, count: int) -> Array:
        """(C,) that count, of so many."""
        return count * np.array(self.share or (1.0,) * len(self.ahead))

    def whiten(self, columns: Array) -> Array:
        """What the prediction leaves of (rows, C, ...)."""
        out = np.array(columns, float)
        if not out.size:
            return out
        if self.share:
            out *= np.sqrt(self.share).reshape(1, -1, *[1] * (out.ndim - 2))
        by_channel = out.reshape(len(out), out.shape[1], -1)
        if not self.size:
            return out
        touched = np.asarray(by_channel.any(axis=0))
        for c, (ahead, wander) in enumerate(zip(self.ahead, self.wander, strict=True)):
            use = np.flatnonzero(touched[c])
            if not len(use) or (wander is None and not len(ahead)):
                continue
            series = np.ascontiguousarray(by_channel[:, c, use].T)
            if wander is not None:
                series = lfilter([1.0, -wander[0]], [1.0, -wander[1]], series)
            white = series.copy()
            for k, weight in enumerate(ahead, start=1):
                white[:, k:] -= weight * series[:, :-k]
            by_channel[:, c, use] = white.T
        return out


def white(channels: int) -> Colour:
    """No colour."""
    return Colour((np.zeros(0),) * channels, (None,) * channels)


def tempered(times: Array) -> Colour:
    """White noise whose neighbours hang together: of `times` (C,) rows one counts.

    What a slow wander says of a constant is its spectral density at no frequency, the variance of a row times
    its integrated autocorrelation time.
    """
    plain = white(len(times))
    return Colour(plain.ahead, plain.wander, tuple(1.0 / t for t in times))


def autocorrelation_time(residual: Array, block: NDArray[np.intp]) -> Array:
    """(C,) variance inflation of sums of residuals (rows, C): 1 + 2 sum rho, summed while rho is positive."""
    same = [block[k:] == block[:-k] for k in range(1, 60) if k < len(block)]
    out = np.ones(residual.shape[1])
    for c in range(residual.shape[1]):
        r = residual[:, c]
        power = float(np.mean(r * r)) or 1.0
        for k, inside in enumerate(same, start=1):
            if inside.sum() < 30:
                break
            rho = float(np.mean(r[k:][inside] * r[:-k][inside])) / power
            if rho < 0.05:
                break
            out[c] += 2.0 * rho
    return out


def colour_of(left: Array) -> Colour:
    """The models of residuals (rows, C) in the order of time; how many numbers each has is chosen by BIC."""
    models = [_model(left[:, c] - np.mean(left[:, c])) for c in range(left.shape[1])]
    return Colour(tuple(m[0] for m in models), tuple(m[1] for m in models))


def _model(values: Array) -> tuple[Array, tuple[float, float] | None]:
    rows = len(values)
    if rows < 2 * LEAST_ROWS_PER_ORDER or not np.all(np.isfinite(values)) or not np.any(values):
        return np.zeros(0), None
    ahead, least = _predictor(values)
    wander = None
    tried = []
    for share in FORGETS:
        keeps = float(np.exp(-1.0 / max(share * rows, LEAST_FORGETS)))
        for gain in GAINS:
            pair = keeps, keeps * (1.0 - gain)
            surprise = lfilter([1.0, -pair[0]], [1.0, -pair[1]], values)
            tried.append((float(surprise @ surprise), pair, surprise))
    for _, pair, surprise in sorted(tried, key=lambda t: t[0])[:2]:
        other, cost = _predictor(surprise)
        if cost + 2.0 * np.log(rows) < least:
            ahead, least, wander = other, cost + 2.0 * np.log(rows), pair
    return ahead, wander


def _predictor(values: Array) -> tuple[Array, float]:
    """The autoregression of least cost (BIC), and this."""
    rows = len(values)
    most = min(MOST_ORDER, rows // LEAST_ROWS_PER_ORDER)
    covariance = np.array([values[: rows - k] @ values[k:] for k in range(most + 1)]) / rows
    best, least = np.zeros(0), float(rows * np.log(covariance[0]))
    for order in range(1, most + 1):
        ahead = np.asarray(solve_toeplitz(covariance[:order], covariance[1 : order + 1]))
        variance = covariance[0] - ahead @ covariance[1 : order + 1]
        if variance <= 0.0:
            break
        cost = float(rows * np.log(variance) + order * np.log(rows))
        if cost < least:
            best, least = ahead, cost
    return best, least
