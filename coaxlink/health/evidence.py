"""Several flights as one linear model, and what further columns say beside it.

    y_k = P_k b_k + L_k a + w_k(t) F_k c + noise       a lasting, b_k of flight k alone, c a fault's size

All of it is one regression (`evidence.likelihood`). Its columns stand flight by flight, what lasts
behind them: flights touch one another through that alone, so the factor of one flight is a part of the whole
one's, and what the data say of a fault is a sum over flights but for what the lasting unknowns give way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from coaxlink.evidence.blocks import Block, joined
from coaxlink.evidence.likelihood import Base, Channel, Fit, fitted
from coaxlink.evidence.noise import autocorrelation_time
from coaxlink.frames import Array
from coaxlink.residual.diagnosis.flight_search import SETTLES

CHANNELS = (2, 3, 4, 5)  # force down, roll, pitch, yaw
CHUNK = 500  # rows whose products are held at once (memory)


@dataclass(frozen=True, kw_only=True)
class Rows:
    """One flight's judged rows of the four channels, N and N m, and what they may be made of."""

    target: Array  # (rows, 4)
    lasting: tuple[Block, ...]  # the same in all flights
    passing: tuple[Block, ...]  # of this flight alone
    time_s: Array  # (rows,)
    least: Array  # (4,) noise, the resolution
    noise: Array = field(default_factory=lambda: np.ones(len(CHANNELS)))  # (4,)
    together: float = 1.0  # rows that count as one

    @property
    def scale(self) -> Array:
        """(4,) by which rows are whitened; slow noise says of a constant its density at no frequency."""
        return 1.0 / (self.noise * np.sqrt(self.together))

    def hangs(self, rest: Array) -> float:
        """Rows of what is left (rows, 4) that hang together, in the channel in which most do."""
        step = np.diff(self.time_s)
        run = np.concatenate([[0], np.cumsum(step > 1.5 * np.median(step))]).astype(np.intp)
        return float(autocorrelation_time(rest, run).max())

    def beside(self, own: Sequence[Block]) -> tuple[Self, Array]:
        """With the noise that is left beside further blocks, and (rows, 4) what that is.

        From the least noise upwards: from above, what strains against its prior may hold it where it is.
        """
        f = replace(self, noise=self.least, together=1.0)
        fit = together([f], {0: own}, rounds=SETTLES)
        rest = fit.left[0] / f.scale
        return replace(f, noise=f.noise * fit.fit.noise, together=f.hangs(rest)), rest


@dataclass(frozen=True)
class Together:
    """Flights in one regression."""

    fit: Fit
    places: tuple[NDArray[np.intp], ...]  # of each flight's columns in it: its own, then those that last
    columns: tuple[Array, ...]  # (rows, 4, P) of each flight, whitened
    left: tuple[Array, ...]  # (rows, 4) of each flight, whitened
    lasting: int

    def half(self, flight: int, products: Array) -> tuple[Array, Array]:
        """What one flight's own columns, and those that last, take of further ones (`Fit.half`)."""
        mine = slice(flight * len(CHANNELS), (flight + 1) * len(CHANNELS))
        half = self.fit.half(products, self.places[flight], mine)
        return half[: len(half) - self.lasting], half[len(half) - self.lasting :]


def together(
    flights: Sequence[Rows],
    own: Mapping[int, Sequence[Block]],
    shared: Sequence[Sequence[Block]] = (),
    rounds: int = 0,
) -> Together:
    """The regression of flights, with further blocks `own` of some, and others that all have in common,
    `shared` (flights, blocks). Noise stays as it is for no rounds.
    """
    before: list[tuple[Array, Array]] = []
    behind: list[tuple[Array, Array]] = []
    for k, f in enumerate(flights):
        before.append(joined([*own.get(k, ()), *f.passing]))
        behind.append(joined([*f.lasting, *(shared[k] if shared else ())]))
    widths = [len(d) for _, d in before]
    lasting = len(behind[0][1])
    last = sum(widths) + np.arange(lasting)
    places, columns, channels = [], [], list[Channel]()
    for f, (mine, of_mine), (common, _), start in zip(
        flights, before, behind, np.cumsum([0, *widths]), strict=False
    ):
        x = np.concatenate([mine, common], axis=-1) * f.scale[:, None]
        places.append(np.concatenate([start + np.arange(mine.shape[-1]), last]))
        columns.append(x)
        lasts = np.arange(x.shape[-1]) >= len(of_mine)  # never one channel's own: they come last
        base = Base(x, np.concatenate([of_mine, behind[0][1]]), lasts)
        rows = np.full(len(CHANNELS), len(x) / f.together)
        channels += [ch.placed(places[-1]) for ch in base.beside([], f.target * f.scale, rows)]
    deviation = np.concatenate([*(d for _, d in before), behind[0][1]])
    ones = np.ones(len(flights) * len(CHANNELS))
    least = np.concatenate([f.least / f.noise for f in flights])
    fit = fitted(channels, deviation, ones, least, rounds)
    left = tuple(
        f.target * f.scale - x @ fit.values[p] for f, x, p in zip(flights, columns, places, strict=True)
    )
    return Together(fit, tuple(places), tuple(columns), left, lasting)


@dataclass(frozen=True)
class Statistics:
    """What flights say of groups of K further columns in R time profiles, beside a regression."""

    own: Array  # (R, groups, K, K) information, less what each flight's own columns give way
    half: Array  # (L, R, groups, K) what of it the lasting ones give way
    score: Array  # (R, groups, K)

    def __add__(self, other: Statistics) -> Statistics:
        """Of one column in several flights."""
        return Statistics(self.own + other.own, self.half + other.half, self.score + other.score)

    def always(self) -> Statistics:
        """In the first of the profiles alone."""
        return Statistics(self.own[:1], self.half[:, :1], self.score[:1])

    @property
    def information(self) -> Array:
        """(R, groups, K, K)."""
        return self.own - _squares(self.half)


class Further:
    """Groups of K columns (rows, 4, groups, K) of a flight in time profiles (R, rows), whitened."""

    def __init__(self, flight: Rows, columns: Array, profiles: Array) -> None:
        white = columns * flight.scale[:, None, None]
        squares = np.einsum("rcga,rcgb->rgab", white, white, optimize=True).reshape(len(white), -1)
        self._shape = (len(profiles), *columns.shape[2:])
        self._own = (profiles**2 @ squares).reshape(*self._shape, columns.shape[-1])
        self._flat, self._profiles = white.reshape(*white.shape[:2], -1), profiles
        usual = joined([*flight.passing, *flight.lasting])[0]
        self._usual = self._crossed(
            np.concatenate([flight.target[..., None], usual], axis=-1) * flight.scale[:, None]
        )

    def _crossed(self, x: Array) -> Array:
        """(P, R, groups K) products with other columns (rows, 4, P), some rows at a time."""
        out = np.zeros((len(self._profiles), x.shape[-1] * self._flat.shape[-1]))
        for start in range(0, len(x), CHUNK):
            some = slice(start, start + CHUNK)
            each = x[some].transpose(0, 2, 1) @ self._flat[some]
            out += self._profiles[:, some] @ each.reshape(len(each), -1)
        return out.reshape(len(out), x.shape[-1], self._flat.shape[-1]).transpose(1, 0, 2)

    def beside(self, all_of_it: Together, flight: int) -> Statistics:
        """What this flight says of them. Columns that it has there beyond its usual ones come first."""
        place, x = all_of_it.places[flight], all_of_it.columns[flight]
        new = x.shape[-1] + 1 - len(self._usual)
        cross = np.concatenate([self._crossed(x[..., :new]), self._usual[1:]])
        score = self._usual[0] - np.tensordot(all_of_it.fit.values[place], cross, 1)
        mine, lasting = (
            half.reshape(len(half), *self._shape)
            for half in all_of_it.half(flight, cross.reshape(len(cross), -1))
        )
        return Statistics(self._own - _squares(mine), lasting, score.reshape(self._shape))


def _squares(half: Array) -> Array:
    """(..., K, K) products of (P, ..., K)."""
    return np.stack([np.sum(half * half[..., [b]], axis=0) for b in range(half.shape[-1])], axis=-1)


def gained(reported: Statistics, deviation: Array) -> Array:
    """Log evidence that columns add (R, groups)."""
    scaled = reported.information * np.outer(deviation, deviation) + np.eye(len(deviation))
    pull = reported.score * deviation
    means = np.linalg.solve(scaled, pull[..., None])[..., 0]
    return 0.5 * (np.sum(pull * means, axis=-1) - np.linalg.slogdet(scaled)[1])
