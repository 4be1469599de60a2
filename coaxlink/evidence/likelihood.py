"""The marginal likelihood of a linear model with Gaussian priors, its noise levels at their best.

log p(y | H) = log N(y; 0, N + X P X'), by X' N^-1 X + P^-1 (Rasmussen and Williams 2006, eq. 2.8 and 5.8);
the noise level of every channel follows MacKay's fixed point (1992, Bayesian interpolation).

What one channel has for itself, and every hypothesis shares, is turned to its principal directions once: at
any noise its posterior precision is diagonal, and a hypothesis costs one Schur complement of what channels
share and of what itself adds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotri, dtrtrs

from coaxlink.frames import Array

NOISE_ROUNDS = 2
JITTER = 1e-11  # of a diagonal: rounding of the products
MORE_JITTER = (0.0, 1e-9, 1e-7)  # of it again, where many columns are nearly one: rounding grows with them

Numbers = NDArray[np.intp]


@dataclass(frozen=True)
class Channel:
    """What one channel says of the columns that it has for itself, by their principal directions, and of
    those that it shares or that a hypothesis adds. In units of the prior deviations, at unit noise.
    """

    own: Numbers  # (P,) its own columns
    ways: Array  # (P, P) their principal directions
    strength: Array  # (P,) information of each direction
    shared: Numbers  # (S,) the other columns that it touches
    cross: Array  # (P, S) products of directions with these
    common: Array  # (S, S)
    moment: Array  # (P,) of directions with the target
    right: Array  # (S,)
    power: float  # of the target
    rows: float  # that count

    def placed(self, numbers: Numbers) -> Channel:
        """With its columns under other numbers."""
        return replace(self, own=numbers[self.own], shared=numbers[self.shared])


class Base:
    """Whitened columns (rows, C, P) with their prior deviations that every hypothesis shares.

    `apart` (P,) are columns that are in the Schur complement, whatever channels touch them.
    """

    def __init__(self, columns: Array, deviation: Array, apart: NDArray[np.bool_] | bool = False) -> None:
        self.deviation = deviation
        touched = np.asarray(columns.any(axis=0))  # (C, P)
        alone = (touched.sum(axis=0) == 1) & ~np.broadcast_to(apart, deviation.shape)
        self._parts = []
        for c, of in enumerate(touched):
            own, shared = np.flatnonzero(of & alone), np.flatnonzero((of & ~alone) | apart)
            mine, others = (deviation[n][:, None] * columns[:, c, n].T for n in (own, shared))
            strength, ways = np.linalg.eigh(mine @ mine.T)
            self._parts.append((own, ways, np.maximum(strength, 0.0), ways.T @ mine, shared, others))
        self._products = [(lead @ rows.T, rows @ rows.T) for _, _, _, lead, _, rows in self._parts]

    def beside(self, further: Sequence[tuple[Array, Array]], target: Array, rows: Array) -> list[Channel]:
        """With further columns (rows, C, K) and their deviations, on a target (rows, C), all whitened, of
        which `rows` (C,) count.
        """
        starts = len(self.deviation) + np.cumsum([0, *(len(d) for _, d in further)])
        each = [np.asarray(x.any(axis=0)) for x, _ in further]  # (C, K)
        out = []
        for c, (own, ways, strength, lead, shared, others) in enumerate(self._parts):
            touched = [np.flatnonzero(of[c]) for of in each]
            parts = [(x[:, c, t] * d[t]).T for (x, d), t in zip(further, touched, strict=True)]
            more, (cross, common) = np.concatenate([others[:0], *parts]), self._products[c]
            between, y = others @ more.T, target[:, c]
            out.append(
                Channel(
                    own=own,
                    ways=ways,
                    strength=strength,
                    shared=np.concatenate([shared, *(t + a for t, a in zip(touched, starts, strict=False))]),
                    cross=np.hstack([cross, lead @ more.T]),
                    common=np.block([[common, between], [between.T, more @ more.T]]),
                    moment=lead @ y,
                    right=np.concatenate([others @ y, more @ y]),
                    power=float(y @ y),
                    rows=float(rows[c]),
                )
            )
        return out


@dataclass(frozen=True)
class Fit:
    """A linear model at its best noise levels."""

    channels: Sequence[Channel]
    deviation: Array  # (P,) prior
    noise: Array  # (C,) standard deviations
    log_evidence: float
    values: Array  # (P,) posterior means
    shared: Numbers  # (S,) columns that are in the Schur complement
    low: Array  # (S, S) its lower Cholesky factor

    def half(self, products: Array, of: Numbers | None = None, channels: slice = slice(None)) -> Array:
        """(P, K) whose squares are what a model's columns take of further ones, of which they have `products`
        (P, K), weighted by the noise.

        `of` are the columns that products are of, in order, with the `channels` that touch them; None: all.
        Those in the Schur complement come last, in their order.
        """
        use = np.arange(len(self.deviation)) if of is None else of
        scaled = products * self.deviation[use][:, None]
        mine = np.isin(self.shared, use)
        rest, place = scaled[np.searchsorted(use, self.shared[mine])], np.cumsum(mine) - 1
        out = []
        for ch, (root, half) in zip(self.channels[channels], self._halves[channels], strict=True):
            own = (ch.ways.T @ scaled[np.searchsorted(use, ch.own)]) / root[:, None]
            rest[place[np.searchsorted(self.shared, ch.shared)]] -= half.T @ own
            out.append(own)
        return np.concatenate([*out, _forward(self.low[np.ix_(mine, mine)], rest)])

    @cached_property
    def _halves(self) -> list[tuple[Array, Array]]:
        """Of each channel (P,) roots of its directions' precisions, and (P, S) its products over these."""
        roots = [np.sqrt(1.0 + ch.strength / n**2) for ch, n in zip(self.channels, self.noise, strict=True)]
        return [
            (root, ch.cross / (n**2 * root)[:, None])
            for ch, n, root in zip(self.channels, self.noise, roots, strict=True)
        ]

    @cached_property
    def covariance(self) -> Array:
        """(P, P) posterior."""
        half = self.half(np.eye(len(self.deviation)))
        untouched = np.ones(len(self.deviation), bool)
        untouched[np.concatenate([self.shared, *(ch.own for ch in self.channels)])] = False
        return np.asarray(half.T @ half + np.diag(untouched * self.deviation**2))


def fitted(
    channels: Sequence[Channel], deviation: Array, noise: Array, least: Array, rounds: int = NOISE_ROUNDS
) -> Fit:
    """The model with its noise levels (C,) moved from `noise` to their best, none under `least`."""
    shared = np.unique(np.concatenate([ch.shared for ch in channels]))
    places = [np.searchsorted(shared, ch.shared) for ch in channels]
    for k in range(rounds + 1):
        schur, right = np.eye(len(shared)), np.zeros(len(shared))
        log_det, explained, gives = 0.0, 0.0, []
        for ch, place, s in zip(channels, places, noise, strict=True):
            w = s**-2.0
            precision = 1.0 + w * ch.strength
            give = (w / precision)[:, None] * ch.cross  # (P, S) what of a shared column its directions take
            taken = w * (ch.cross.T @ give)
            schur[place[:, None], place] += w * ch.common - taken
            schur[place, place] += JITTER * w * np.diagonal(ch.common)
            right[place] += w * (ch.right - give.T @ ch.moment)
            log_det += float(np.sum(np.log(precision)))
            explained += float(w**2 * np.sum(ch.moment**2 / precision))
            gives.append((precision, give, taken))
        low = _cholesky(schur)
        z = _forward(low, right)
        both = _forward(low, z, transposed=True)
        log_det += 2.0 * float(np.sum(np.log(np.diagonal(low))))
        explained += float(z @ z)
        power = float(sum(ch.power / s**2 for ch, s in zip(channels, noise, strict=True)))
        level = float(
            sum(ch.rows * np.log(2.0 * np.pi * s**2) for ch, s in zip(channels, noise, strict=True))
        )
        log_evidence = -0.5 * (level + log_det + power - explained)
        alone = [
            (ch.moment / (s**2 * precision)) - give @ both[place]
            for ch, place, s, (precision, give, _) in zip(channels, places, noise, gives, strict=True)
        ]
        if k == rounds:
            break
        inverse = _inverse(low)
        now = np.empty(len(noise))
        for c, (ch, place, (precision, give, taken)) in enumerate(zip(channels, places, gives, strict=True)):
            x, y = alone[c], both[place]
            left = ch.power + x @ (ch.strength * x - 2.0 * ch.moment) + y @ (ch.common @ y - 2.0 * ch.right)
            left += 2.0 * x @ (ch.cross @ y)
            # numbers that the channel determined: the trace of its products times the posterior covariance
            several = ch.common / noise[c] ** 2 - taken - give.T @ give
            used = np.sum(1.0 - 1.0 / precision) + np.sum(inverse[place[:, None], place] * several)
            now[c] = np.sqrt(max(left, 0.0) / max(ch.rows - used, 1.0))
        now = np.maximum(now, least)
        done = bool(np.all(np.abs(np.log(now / noise)) < 1e-3))
        noise = now
        if done and k > 0:
            rounds = k + 1
    values = np.zeros(len(deviation))
    values[shared] = both
    for ch, x in zip(channels, alone, strict=True):
        values[ch.own] = ch.ways @ x
    return Fit(channels, deviation, noise, log_evidence, values * deviation, shared, low)


def _cholesky(gram: Array) -> Array:
    """Lower factor. Raises LinAlgError where more than rounding keeps the matrix from having one."""
    if not gram.size:
        return gram
    for share in MORE_JITTER:
        factor, info = dpotrf(gram + share * np.diag(np.diagonal(gram)) if share else gram, lower=1, clean=1)
        if info == 0:
            return np.asarray(factor)
    raise np.linalg.LinAlgError("the normal equations are not positive definite")


def _forward(low: Array, right: Array, *, transposed: bool = False) -> Array:
    """What a lower factor, or its transpose, times this is `right`."""
    return np.asarray(dtrtrs(low, right, lower=1, trans=int(transposed))[0]) if right.size else right


def _inverse(low: Array) -> Array:
    """Of the matrix that a lower factor is of."""
    if not low.size:
        return low
    lower = dpotri(low, lower=1)[0]
    return np.asarray(lower + np.tril(lower, -1).T)
