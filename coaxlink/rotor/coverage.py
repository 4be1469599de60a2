"""What a stand log covers and how well: speeds, repeats, noise, and how far its model is known."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.rotor.identification import CHANNELS, CORRELATED, Identification, speed_correlation
from coaxlink.rotor.polynomial import design_matrix

CELLS = 5  # a side: levels of each speed that a map wants (the paper has 11)
SAME = 0.01  # of the speed range: two rows at one condition
FULL = 0.9  # of the top speed: a map that reaches so far needs no extrapolation


@dataclass(frozen=True)
class Coverage:
    """What the rows of a log say about where they were measured."""

    upper: tuple[float, float]  # least and greatest normalised speed
    lower: tuple[float, float]
    cells: float  # share of a 5 x 5 map of both speeds in which a row lies; of 5 levels for a rotor alone
    correlation: float  # of both speeds, where both turn
    repeats: int  # conditions measured more than once
    repeatability: Mapping[
        str, float
    ]  # channel: N or N m between rows at one condition; absent without repeats
    noise: Mapping[str, float]  # channel: N or N m
    known_to: Mapping[str, float]  # channel: standard error of the model over the measured rows, the greatest

    def as_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return asdict(self)

    def lines(self) -> Iterator[str]:
        """In words."""
        pair = self.lower[1] > 0
        where = f"upper {self.upper[0]:.2f} to {self.upper[1]:.2f}"
        where += f", lower {self.lower[0]:.2f} to {self.lower[1]:.2f}" if pair else ""
        of = f"a {CELLS} x {CELLS} map" if pair else f"{CELLS} levels"
        yield f"speeds: {where} of the top speed, {100 * self.cells:.0f} % of {of}"
        units = {True: "N", False: "N m"}
        if self.repeats:
            scatter = ", ".join(
                f"{n} {v:.3g} {units[n.endswith('thrust')]}" for n, v in self.repeatability.items()
            )
            yield f"repeats: {self.repeats} conditions measured again, within {scatter}"
        else:
            yield "repeats: none; what one condition scatters by is not in the log"


def coverage(result: Identification) -> Coverage:
    """The coverage of the log behind an identification."""
    data = result.data
    u, v = data.speeds.upper, data.speeds.lower
    first, again = _repeats(u, v)
    repeatability = {}
    for load in data.measured:
        difference = (data.loads[load][first] - data.loads[load][again]) / np.sqrt(2)
        difference = difference[np.isfinite(difference)]
        if len(difference):
            repeatability[CHANNELS[load]] = float(np.sqrt(np.mean(difference**2)))
    return Coverage(
        _range(u), _range(v), _cells(u, v), speed_correlation(data.speeds), len(set(first.tolist())),
        repeatability,
        {CHANNELS[load]: result.noise_floor[CHANNELS[load]] for load in data.measured},
        {CHANNELS[load]: float(known_to(result, load).max()) for load in result.fits},
    )  # fmt: skip


def known_to(result: Identification, load: str) -> NDArray[np.float64]:
    """(rows,) standard error of a load's model at the rows that it was fitted on, N or N m."""
    data, fit = result.data, result.fits[load]
    mask = np.isfinite(data.loads[load])
    X = design_matrix(fit.terms, data.speeds.upper[mask], data.speeds.lower[mask])
    left = np.linalg.qr(X / np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-300))[0]
    y = data.loads[load][mask]
    scatter = np.sqrt(np.sum((y - X @ fit.coefficients) ** 2) / max(len(y) - X.shape[1], 1))
    return np.asarray(scatter * np.sqrt(np.minimum(np.sum(left**2, axis=1), 1.0)))


def for_the_table(result: Identification, load: str) -> str:
    """What terms that cannot be told apart mean for a table made of the model."""
    u, v = result.data.speeds.upper, result.data.speeds.lower
    unit = "N" if load.endswith("thrust_N") else "N m"
    sure = (
        f"the sum of them is known to {float(known_to(result, load).max()):.2g} {unit} where it was measured"
    )
    if speed_correlation(result.data.speeds) > CORRELATED:
        both = (u > 0) & (v > 0)
        ratio = v[both] / u[both]
        return (
            f"for a table: fly it only with both rotors between {_range(u)[0]:.2f} and {_range(u)[1]:.2f} of "
            f"the top speed and the lower one at {ratio.min():.2f} to {ratio.max():.2f} of the upper one's"
        )
    top = min(_range(s)[1] for s in (u, v) if np.any(s > 0))
    if top < FULL:
        return f"for a table: {sure}; fly it only below {top:.2f} of the top speed"
    return f"for a table: nothing, {sure}"


def _range(u: NDArray[np.float64]) -> tuple[float, float]:
    turning = u[u > 0]
    return (float(turning.min()), float(turning.max())) if len(turning) else (0.0, 0.0)


def _cells(u: NDArray[np.float64], v: NDArray[np.float64]) -> float:
    top = max(float(u.max()), float(v.max()), 1e-300)
    cell = [np.minimum((s / top * CELLS).astype(int), CELLS - 1) for s in (u, v)]
    pair = bool(np.any(v > 0)) and bool(np.any(u > 0))
    if pair:
        return len(set(zip(*cell, strict=True))) / CELLS**2
    return len(set((cell[0] if np.any(u > 0) else cell[1]).tolist())) / CELLS


def _repeats(u: NDArray[np.float64], v: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of rows at one condition, neighbours in time not counted: they are one measurement."""
    from scipy.spatial import cKDTree

    points = np.column_stack([u, v])
    step = max(1, len(points) // 4000)
    index = np.arange(0, len(points), step)
    pairs = cKDTree(points[index]).query_pairs(SAME, output_type="ndarray")
    pairs = index[pairs[pairs[:, 1] - pairs[:, 0] > 1]] if len(pairs) else np.zeros((0, 2), np.int64)
    return pairs[:, 0], pairs[:, 1]
