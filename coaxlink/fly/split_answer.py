"""The split of least battery power from a hover in which the share of the upper rotors was stepped.

Every dwell (a share held, what settles left out) is one row: its mean watts over a polynomial of the share
beside columns of what else moves them: time (pack, warming, air), and what the caller measured of gusts, such
as vertical acceleration or tilt. The voltage is no such column: it answers to the watts. What is left over of
neighbouring dwells may be alike (AR(1), its correlation by restricted maximum likelihood over a grid).

The intervals are of profile likelihood: all values that coefficients within the t-ellipsoid give. So a least
at an edge, or none at all, widens them instead of breaking them (Fieller 1954 for the vertex of a parabola).
A scale of the current sensor changes watts, not the share; its offset makes the saving in per cent a little
smaller or larger.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.errors import InputError

LEVEL = 0.95  # of all intervals
DEGREE = 4  # of the share's polynomial at most
BEND_LEVEL = 0.95  # at which a power above the parabola is believed: one too few biases, one too many widens
DRIFT_S = 240.0  # one more power of time for so long a hover: packs and motors warm over minutes
SPARE = 6  # rows beyond the columns, below which no variance is believed
CORRELATIONS = np.linspace(0.0, 0.8, 17)
DIRECTIONS, RADII = 720, (0.25, 0.5, 0.75, 1.0)
GAP_S = 60.0  # between two flights, as the drift over time sees it
GRID = 201  # shares between the lowest and the highest flown

Array = NDArray[np.float64]
Interval = tuple[float, float]


@dataclass(frozen=True)
class Dwells:
    """One row a dwell."""

    time_s: Array  # (n,) its middle
    watts: Array  # (n,) mean
    share: Array  # (n,) of the thrust that the upper rotors were set to give, 0..1
    columns: Array  # (n, k) means of what else moves the watts

    def as_json(self) -> list[list[float]]:
        """Rows of time, watts, share and columns."""
        return np.column_stack([self.time_s, self.watts, self.share, self.columns]).tolist()

    @classmethod
    def of_json(cls, rows: Any, columns: int) -> Dwells:
        """As `as_json` wrote them. Raises ValueError or TypeError for what is no such rows."""
        table = np.asarray(rows, float)
        if (
            table.ndim != 2
            or len(table) == 0
            or table.shape[1] != 3 + columns
            or not np.isfinite(table).all()
        ):
            raise ValueError(f"rows of {3 + columns} numbers are expected")
        return cls(table[:, 0], table[:, 1], table[:, 2], table[:, 3:])


@dataclass(frozen=True)
class SplitAnswer:
    """What the hover says; fractions are of the watts with the split on board."""

    on_board: float  # share of the upper rotors
    watts: float  # with it
    share: float  # of least watts, within what was flown
    share_ci: Interval
    saving: float  # fraction
    saving_ci: Interval
    at_edge: bool  # the least may lie beyond what was flown
    dwells: int
    correlation: float  # of neighbouring dwells' residuals
    scatter: float  # W, of a dwell
    curve_share: tuple[float, ...]
    curve_watts: tuple[float, ...]  # fit at `curve_share`, the other columns at their means
    flown_share: tuple[float, ...]
    flown_watts: tuple[float, ...]  # the dwells, less what the other columns explain

    @property
    def worth_it(self) -> bool:
        """Whether another split than the one on board saves power, beyond chance."""
        return self.saving_ci[0] > 0.0

    def words(self) -> str:
        """The answer in one line."""
        low, high = (100 * v for v in self.saving_ci)
        if not self.worth_it:
            least = max(high, 0.1)  # a digit is all that is printed
            return f"nothing to gain beyond {least:.1f} %: a larger saving would not have been missed"
        edge = "; the least may lie beyond what was flown (`split_reach`)" if self.at_edge else ""
        return (
            f"least power with {self.share:.3f} ({self._interval()}) of the thrust from above, "
            f"on board {self.on_board:.3f}: saves {100 * self.saving:.1f} % ({low:.1f} to {high:.1f}), "
            f"{self.saving * self.watts:.0f} W of {self.watts:.0f}{edge}"
        )

    def _interval(self) -> str:
        """Of the share; an end that is the lowest or highest share flown is no end."""
        least, most = self.share_ci
        low, high = min(self.flown_share), max(self.flown_share)
        step = (high - low) / GRID
        if least > low + step and most < high - step:
            return f"{least:.3f} to {most:.3f}"
        if least > low + step:
            return f"{least:.3f} or more"
        return f"{most:.3f} or less" if most < high - step else "any that was flown"

    def as_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return {**asdict(self), "worth_it": self.worth_it}


def dwells_of(
    number: Array, time_s: Array, watts: Array, share: Array, settle_s: float, columns: Mapping[str, Array]
) -> Dwells:
    """Means of every dwell by its `number`, less its first `settle_s`; all arrays are (rows,).

    A dwell that holds less than `settle_s` of readings after settling is left out.
    """
    edges = np.flatnonzero(np.diff(number) != 0) + 1
    found = []
    for rows in np.split(np.arange(len(time_s)), edges):
        t = time_s[rows]
        rows = rows[t - t[0] >= settle_s]
        if len(rows) < 2 or time_s[rows[-1]] - time_s[rows[0]] < settle_s:
            continue
        extra = [float(np.mean(values[rows])) for values in columns.values()]
        found.append([time_s[rows].mean(), watts[rows].mean(), share[rows[0]], *extra])
    table = np.array(found, float).reshape(len(found), 3 + len(columns))
    return Dwells(table[:, 0], table[:, 1], table[:, 2], table[:, 3:])


def joined(flights: Sequence[Dwells]) -> Dwells:
    """Hovers one after the other, each with a level of its own: another pack, another hour."""
    starts = np.cumsum([0.0, *(float(one.time_s[-1]) + GAP_S for one in flights[:-1])])
    which = np.repeat(np.arange(len(flights)), [len(one.watts) for one in flights])
    own = (which[:, None] == np.arange(1, len(flights))).astype(float)
    time_s, watts, share, columns = (
        np.concatenate(parts)
        for parts in zip(*((one.time_s + start, one.watts, one.share, one.columns)
                           for one, start in zip(flights, starts, strict=True)), strict=True)
    )  # fmt: skip
    return Dwells(time_s, watts, share, np.column_stack([columns, own]))


def best_split(dwells: Dwells, on_board: float) -> SplitAnswer:
    """The share of least watts, and what it saves against `on_board`, with 95 % intervals.

    Raises InputError where too few dwells or shares were flown, or `on_board` is not among them.
    """
    low, high = _flown_range(dwells, on_board)
    fit = _fitted(dwells, on_board)
    shares = np.linspace(low, high, GRID)
    powers = np.vander((shares - on_board) / fit.unit, fit.degree + 1, increasing=True)[:, 1:]
    best, saved = _least(powers @ fit.beta, shares)
    region = fit.region() @ powers.T
    at, save = _least(region, shares)
    watts = fit.level
    edge = high - low
    # each watt of the answer is relative to the split on board; its own error is far below that of the saving
    return SplitAnswer(
        on_board=on_board,
        watts=watts,
        share=float(best),
        share_ci=(float(at.min()), float(at.max())),
        saving=float(saved) / watts,
        saving_ci=(float(save.min()) / watts, float(save.max()) / watts),
        at_edge=bool(at.min() < low + edge / GRID or at.max() > high - edge / GRID),
        dwells=len(dwells.watts),
        correlation=fit.correlation,
        scatter=fit.scatter,
        curve_share=tuple(shares[::10].tolist()),
        curve_watts=tuple((watts + powers[::10] @ fit.beta).tolist()),
        flown_share=tuple(dwells.share.tolist()),
        flown_watts=tuple(fit.cleaned.tolist()),
    )


def _fitted(dwells: Dwells, on_board: float) -> _Fit:
    """A parabola, or the highest power up to DEGREE that its own coefficient shows; two levels are spare."""
    fit = _Fit(dwells, on_board, 2)
    for degree in range(3, min(DEGREE, len(np.unique(dwells.share)) - 2) + 1):
        if len(dwells.watts) - degree - fit.others < SPARE:
            break
        higher = _Fit(dwells, on_board, degree)
        if abs(higher.beta[-1]) > _t(BEND_LEVEL, higher.spare) * higher.error(degree - 1):
            fit = higher
    return fit


class _Fit:
    """Generalised least squares of a polynomial of the share, about the share on board, and drift columns."""

    def __init__(self, dwells: Dwells, on_board: float, degree: int) -> None:
        self.degree, self.unit = degree, float(np.ptp(dwells.share)) / 2.0
        n = len(dwells.watts)
        form = np.vander((dwells.share - on_board) / self.unit, degree + 1, increasing=True)[:, 1:]
        drift = _drift(dwells)
        design = np.column_stack([form, np.ones(n), drift])
        self.others = design.shape[1] - degree
        self.spare = n - design.shape[1]
        if self.spare < SPARE:
            problem = f"{n} dwells for {design.shape[1]} columns: {SPARE} more are needed at least"
            raise InputError("the hover", "dwells", problem)
        fits = [self._by(rho, design, dwells.watts) for rho in CORRELATIONS]
        # the correlation is not known: coefficients over all of it, by its likelihood
        weights = np.exp(np.array([fit[0] for fit in fits]) - max(fit[0] for fit in fits))
        weights /= weights.sum()
        rhos, betas, covariances, variances = (
            np.array([fit[k] for fit in fits], dtype=float) for k in range(1, 5)
        )
        self.correlation, variance = float(weights @ rhos), float(weights @ variances)
        all_of_it = weights @ betas
        off = betas - all_of_it
        covariance = np.einsum("k,kij->ij", weights, covariances + off[:, :, None] * off[:, None, :])
        self.beta, self.covariance = all_of_it[:degree], covariance[:degree, :degree]
        self.level, self.scatter = float(all_of_it[degree]), math.sqrt(variance)
        self.cleaned = dwells.watts - drift @ all_of_it[degree + 1 :]

    def _by(self, rho: float, design: Array, watts: Array) -> tuple[float, float, Array, Array, float]:
        """Restricted likelihood, rho, coefficients, their covariance, variance of a dwell."""
        w = np.column_stack([design, watts])
        w = np.vstack([math.sqrt(1.0 - rho * rho) * w[:1], w[1:] - rho * w[:-1]])
        x, y = w[:, :-1], w[:, -1]
        inverse = np.linalg.pinv(x.T @ x)
        beta = inverse @ (x.T @ y)
        innovation = float(((y - x @ beta) ** 2).sum()) / self.spare
        _, spread = np.linalg.slogdet(x.T @ x)
        likelihood = 0.5 * (math.log(1.0 - rho * rho) - self.spare * math.log(innovation + 1e-12) - spread)
        return likelihood, float(rho), beta, innovation * inverse, innovation / (1.0 - rho * rho)

    def error(self, index: int) -> float:
        """Standard error of a coefficient of the share's polynomial."""
        return math.sqrt(float(self.covariance[index, index]))

    def region(self) -> Array:
        """(rows, degree) coefficients in the ellipsoid whose shadow on any direction is its t-interval."""
        way = np.random.default_rng(0).normal(size=(DIRECTIONS, self.degree))
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        root = np.linalg.cholesky(self.covariance + 1e-12 * np.eye(self.degree))
        shell = _t(LEVEL, self.spare) * way @ root.T
        return np.vstack([self.beta + radius * shell for radius in RADII])


def _least(watts: Array, shares: Array) -> tuple[Array, Array]:
    """Share of least watts, and how far below 0 they are there; `watts` (..., shares) over the board's."""
    return shares[np.argmin(watts, axis=-1)], -np.minimum(watts.min(axis=-1), 0.0)


def _drift(dwells: Dwells) -> Array:
    """(n, columns) powers of time, more for a longer hover, and the measured columns; centred, of size 1."""
    t = dwells.time_s
    span = max(float(np.ptp(t)), 1e-9)
    powers = np.polynomial.legendre.legvander(2.0 * (t - t[0]) / span - 1.0, 1 + int(span // DRIFT_S))[:, 1:]
    columns = np.column_stack([powers, dwells.columns])
    columns = columns - columns.mean(axis=0)
    size = columns.std(axis=0)
    return columns[:, size > 1e-12] / size[size > 1e-12]


def _flown_range(dwells: Dwells, on_board: float) -> Interval:
    levels = np.unique(dwells.share)
    if len(levels) < 3:
        raise InputError("the hover", "shares", f"three at least are needed, {len(levels)} flown")
    if not levels[0] <= on_board <= levels[-1]:
        problem = f"{on_board:.3f} on board, {levels[0]:.3f} to {levels[-1]:.3f} flown"
        raise InputError("the hover", "shares", problem)
    return float(levels[0]), float(levels[-1])


def _t(level: float, spare: int) -> float:
    from scipy.stats import t

    return float(t.ppf(0.5 + 0.5 * level, spare))
