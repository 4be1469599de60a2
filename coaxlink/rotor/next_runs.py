"""What to measure next so that the table's error halves, as a schedule for the stand.

I-optimal, one point after the other (Atkinson, Donev and Tobias 2007, chapter 10): each next point is the one
that takes most from the mean variance of the model over the speeds that a table uses. Coefficients nothing is
known of have the size of their load as prior: speeds never run count as unknown, not as known.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.rotor.identification import Identification
from coaxlink.rotor.polynomial import design_matrix
from coaxlink.rotor.stand_data import unit_of

Array = NDArray[np.float64]
LEVELS = 9  # of each speed, from the slowest to the top
SLOWEST, TOP = 0.2, 1.0  # of the top speed: what a table uses
HALF = 0.5
MOST = 240  # points
HOLD_S = 3.0  # a point: speeds settle in a second, two seconds of rows are averaged
RATE_HZ = 10.0
SENSOR = 0.005  # of the greatest load: what stands' load cells are good to (Tyto's data sheets)


@dataclass(frozen=True)
class NextRuns:
    """Points to measure, and what they are expected to do."""

    points: Array  # (k, 2) throttles of the upper and the lower rotor, in the order to run
    times: NDArray[np.int64]  # (k,) how often each is measured
    share: float  # expected error of the model over the table's speeds, of the present one
    before: dict[str, float]  # load: mean standard error over the table's speeds now, N or N m
    after: dict[str, float]
    from_log: bool  # throttles as the log has them for these speeds; else the speeds themselves

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return HOLD_S * float(self.times.sum())

    def document(self) -> dict[str, Any]:
        """As a schedule file's document (sim/stand/schedule.py)."""
        pieces = [
            {"seconds": HOLD_S * int(n), "upper": round(float(u), 4), "lower": round(float(v), 4)}
            for (u, v), n in zip(self.points, self.times, strict=True)
        ]
        return {"rate_hz": RATE_HZ, "pieces": pieces}

    def as_json(self) -> dict[str, Any]:
        """What it is expected to do, as plain numbers."""
        return {"before": self.before, "after": self.after, "seconds": self.seconds, "share": self.share}

    def lines(self) -> Iterator[str]:
        """In words."""
        after = ", ".join(
            f"{load} {was:.2g} to {self.after[load]:.2g} {unit_of(load)}" for load, was in self.before.items()
        )
        yield f"{int(self.times.sum())} points, {self.seconds:.0f} s; the model's error over a table: {after}"
        if self.share > HALF:
            yield f"no more than {MOST} points are planned: they take it to {100 * self.share:.0f} %"
        if not self.from_log:
            yield "throttles are shares of the top speed: the log has none to compare with"


def next_runs(result: Identification) -> NextRuns:
    """The fewest points, chosen one by one, that halve the model's error over a table's speeds."""
    data = result.data
    pair = bool(np.any(data.speeds.lower > 0))
    steps = np.linspace(SLOWEST, TOP, LEVELS)
    spots = np.array([(a, b) for a in steps for b in (steps if pair else (0.0,))])
    loads = [_Load(result, load, spots) for load in result.fits]
    first = sum(load.mean_square() for load in loads)
    counts = np.zeros(len(spots), np.int64)
    while sum(load.mean_square() for load in loads) > HALF**2 * first and counts.sum() < MOST:
        best = int(np.argmax(np.sum([load.gains() for load in loads], axis=0)))
        for load in loads:
            load.add(best)
        counts[best] += 1
    chosen = np.flatnonzero(counts)
    order = _serpentine(spots[chosen])
    throttles, from_log = _throttles(result, spots[chosen][order])
    return NextRuns(
        throttles,
        counts[chosen][order],
        float(np.sqrt(sum(load.mean_square() for load in loads) / max(first, 1e-300))),
        {load.name: load.first for load in loads},
        {load.name: load.standard_error() for load in loads},
        from_log,
    )


class _Load:
    """The covariance of one load's coefficients, and what it means at every spot of the table."""

    def __init__(self, result: Identification, load: str, spots: Array) -> None:
        rows, fit = result.data.rows(load), result.fits[load]
        X = rows.design(fit.terms)
        self.name = load
        self._size = max(float(np.abs(rows.y).max()), 1e-300)
        degrees = max(len(rows.y) - X.shape[1], 1)
        scatter = float(np.sum((rows.y - X @ fit.coefficients) ** 2)) / degrees
        self._noise = max(scatter, (SENSOR * self._size) ** 2)
        precision = X.T @ X / self._noise + np.eye(X.shape[1]) / self._size**2
        self._covariance = np.linalg.inv(precision)
        self._spots = design_matrix(fit.terms, spots[:, 0], spots[:, 1])  # (s, p)
        self.first = self.standard_error()

    def standard_error(self) -> float:
        """Root mean variance over the spots, N or N m."""
        return float(np.sqrt(np.mean(np.sum(self._spots @ self._covariance * self._spots, axis=1))))

    def mean_square(self) -> float:
        """The same squared, of the load's size: thrust and torque count alike."""
        return (self.standard_error() / self._size) ** 2

    def gains(self) -> Array:
        """(s,) what a measurement at each spot takes from `mean_square`."""
        across = self._spots @ self._covariance @ self._spots.T  # (s, s)
        return np.mean(across**2, axis=0) / (self._noise + np.diag(across)) / self._size**2

    def add(self, spot: int) -> None:
        """Measure once at a spot."""
        x = self._spots[spot]
        projected = self._covariance @ x
        self._covariance = self._covariance - np.outer(projected, projected) / (self._noise + x @ projected)


def _serpentine(spots: Array) -> NDArray[np.int64]:
    """Order by the upper speed, the lower one up and down in turn: no step is long."""
    _, row = np.unique(spots[:, 0], return_inverse=True)
    return np.lexsort((np.where(row % 2, -spots[:, 1], spots[:, 1]), row))


def _throttles(result: Identification, speeds: Array) -> tuple[Array, bool]:
    """The throttles that gave these speeds in the log; the speeds themselves where it has none."""
    samples = result.data.samples
    out = speeds.copy()
    known = not result.data.speeds.from_throttle
    for column, side in enumerate(("upper", "lower")):
        u = getattr(result.data.speeds, side)
        if not np.any(u > 0):
            continue
        if not samples.has(f"{side}_throttle"):
            known = False
            continue
        levels = np.unique(np.round(u, 2))
        throttle = [np.median(samples[f"{side}_throttle"][np.abs(u - level) <= 0.01]) for level in levels]
        rising = np.maximum.accumulate(np.nan_to_num(throttle))
        slope = rising[-1] / max(float(levels[-1]), 1e-9)
        beyond = np.maximum(speeds[:, column] - levels[-1], 0.0) * slope
        out[:, column] = np.clip(np.interp(speeds[:, column], levels, rising) + beyond, 0.0, 1.0)
    return out, known or result.data.speeds.from_throttle
