"""Stretches of rows that another reading of the columns fits far better than their labels do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coaxlink.frames import Array
from coaxlink.residual.channels.stand import dictionary_of
from coaxlink.rotor.model import LOADS

Mask = NDArray[np.bool_]
LEAST_ROWS = 4
LEAST_GAIN = 60.0  # squared tolerances that one stretch must win
CAP = 25.0  # squared tolerances: a reading that is off by more is off, by however much
MOST = 12  # stretches
RICH = 100  # places that a polynomial of third order wants
LEAST_PLACES = 3  # a single change of speed, with a lag in it, may look like anything
WHOLE = 0.9  # of the rows: more than this is the whole log
PARTS: Sequence[tuple[tuple[float, float], ...]] = (
    ((0.0, 1.0),),
    ((0.0, 0.5),),
    ((0.5, 1.0),),
    ((0.25, 0.75),),
    ((0.0, 0.25), (0.75, 1.0)),
    ((0.0, 0.34),),
    ((0.33, 0.67),),
    ((0.66, 1.0),),
)


def stretches(gain: Array) -> list[slice]:
    """Runs of rows whose summed gain (rows,) is largest, each of at least `LEAST_GAIN`, best first."""
    out: list[slice] = []
    left = np.where(np.isfinite(gain), gain, -CAP)  # a row without a number belongs to no run
    for _ in range(MOST):
        start, end = largest_run(left)
        if float(np.sum(left[start:end])) < LEAST_GAIN:
            break
        out.append(slice(start, end))
        left[start:end] = -CAP  # a later one does not run across it
    return out


def largest_run(gain: Array) -> tuple[int, int]:
    """First row, and row behind the last, of the run whose summed gain (rows,) is largest.

    >>> largest_run(np.array([-1.0, 2.0, 3.0, -4.0, 1.0]))
    (1, 3)
    """
    path = np.concatenate([[0.0], np.cumsum(gain)])
    low = np.minimum.accumulate(path)
    end = int(np.argmax(path - low))
    return int(np.flatnonzero(path[: end + 1] == low[end])[-1]), end


def largest_excursion(values: Array) -> tuple[int, int]:
    """The same of the run that is furthest from the mean of (rows,), to either side."""
    path = np.cumsum(values - np.mean(values))
    first, last = sorted((int(np.argmin(path)), int(np.argmax(path))))
    return first + 1, last + 1


def nuisance_terms(speeds: Array, channel: int) -> list[str]:
    """Polynomial terms of a load over both speeds, of third order where rows (rows, 2) take places enough."""
    return dictionary_of(LOADS[channel], 3 if places(speeds) >= RICH else 2)


def parts_of(rows: int) -> list[Mask]:
    """Masks (rows,) of contiguous parts of a log: in one of them the labels may be right throughout."""
    at = (np.arange(rows) + 0.5) / rows
    return [np.logical_or.reduce([(a <= at) & (at < b) for a, b in part]) for part in PARTS]


def robust_fit(x: Array, y: Array, weights: Mask) -> Array:
    """(K,) coefficients of columns x (rows, K) for y (rows,) on the rows of a mask; a few outliers do not
    count (squares first, then ever more like absolute values)."""
    use = weights & np.isfinite(y)
    x, y = x[use], y[use]
    scale = np.sqrt(np.mean(x**2, axis=0)) + 1e-12
    fit = np.linalg.lstsq(x / scale, y, rcond=1e-6)[0]
    for _ in range(12):
        miss = np.abs(y - x / scale @ fit)
        spread = max(1.4826 * float(np.median(miss)), 1e-9 * (float(np.abs(y).max()) + 1e-12))
        w = np.sqrt(1.0 / np.maximum(miss / spread, 1.0))
        fit = np.linalg.lstsq(x / scale * w[:, None], y * w, rcond=1e-6)[0]
    return np.asarray(fit / scale)


def places(values: Array) -> int:
    """How many places rows (rows, 2) of speeds or throttles take, a fiftieth of full speed apart."""
    return len(np.unique(np.round(values * 50.0), axis=0))
