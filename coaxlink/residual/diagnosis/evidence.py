"""The marginal likelihood of a linear model with Gaussian priors, its noise levels at their best.

log p(y | H) = log N(y; 0, N + X P X'), by one Cholesky of X' N^-1 X + P^-1 (Rasmussen and Williams 2006,
eq. 2.8 and 5.8); the noise level of every channel follows MacKay's fixed point (1992,
Bayesian interpolation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular
from scipy.linalg.lapack import dpotrf, dtrtri

from coaxlink.frames import Array

ROUNDS = 2
JITTER = 1e-11  # of a diagonal: rounding of the products
MORE_JITTER = (0.0, 1e-9, 1e-7)  # of it again, where many columns are nearly one: rounding grows with them


@dataclass(frozen=True)
class Sums:
    """What a regression needs of its rows, channel by channel: the columns that it touches, their products.

    `use` holds (P_c,) numbers of columns, of `width` in all, `gram` (P_c, P_c) X'X and `moment` (P_c,) X'y;
    `power` (C,) is y'y, `rows` (C,).
    """

    width: int
    use: Sequence[NDArray[np.intp]]
    gram: Sequence[Array]
    moment: Sequence[Array]
    power: Array
    rows: Array


@dataclass(frozen=True)
class Touched:
    """Of one channel the columns that are not nil, by number, with their rows (P_c, rows) and products."""

    use: NDArray[np.intp]
    rows: Array
    gram: Array


def by_channel(columns: Array) -> list[Touched]:
    """Of whitened columns (rows, C, P)."""
    out = []
    for c in range(columns.shape[1]):
        use = np.flatnonzero(columns[:, c].any(axis=0))
        rows = np.ascontiguousarray(columns[:, c, use].T)
        out.append(Touched(use, rows, rows @ rows.T))
    return out


def sums_of(
    base: Sequence[Touched], width: int, further: Sequence[Array], target: Array, rows: Array
) -> Sums:
    """Of `width` columns that stay as they are, then others (rows, C, K), on a target (rows, C), whitened, of
    which `rows` (C,) count.
    """
    starts = width + np.cumsum([0, *(x.shape[-1] for x in further)])
    uses, grams, moments = [], [], []
    for c, b in enumerate(base):
        touched = [np.flatnonzero(x[:, c].any(axis=0)) for x in further]
        own = [x[:, c, t].T for x, t in zip(further, touched, strict=True)]
        more = np.concatenate([np.zeros((0, len(target))), *own])
        cross = b.rows @ more.T
        uses.append(np.concatenate([b.use, *(t + at for t, at in zip(touched, starts[:-1], strict=True))]))
        grams.append(np.block([[b.gram, cross], [cross.T, more @ more.T]]))
        moments.append(np.concatenate([b.rows @ target[:, c], more @ target[:, c]]))
    power = np.sum(target**2, axis=0)
    return Sums(int(starts[-1]), uses, grams, moments, power, rows)


@dataclass(frozen=True)
class Fit:
    """A linear model at its best noise levels."""

    sums: Sums
    deviation: Array  # (P,) prior
    noise: Array  # (C,) standard deviations
    log_evidence: float
    values: Array  # (P,) posterior means

    @cached_property
    def factor(self) -> Array:
        """(P, P) lower Cholesky factor of the posterior precision, in units of the prior deviations."""
        gram = np.zeros((self.sums.width, self.sums.width))
        for use, own, noise in zip(self.sums.use, self.sums.gram, self.noise, strict=True):
            gram[np.ix_(use, use)] += own / noise**2
        gram *= np.outer(self.deviation, self.deviation)
        return _precision(gram)

    @cached_property
    def covariance(self) -> Array:
        """(P, P) posterior."""
        half = solve_triangular(self.factor, np.diag(self.deviation), lower=True, check_finite=False)
        return np.asarray(half.T @ half)


def fitted(sums: Sums, deviation: Array, noise: Array, least: Array, rounds: int = ROUNDS) -> Fit:
    """The model with its noise levels (C,) moved from `noise` to their best, none under `least`.

    Most columns speak of one channel alone: these are eliminated channel by channel, and a small system is
    left of the columns that channels share (Schur complement).
    """
    split = _Split(sums, deviation)
    for k in range(rounds + 1):
        log_evidence, values, used = split.at(noise)
        if k == rounds:
            break
        left = np.empty(len(noise))
        for c, (use, gram, moment) in enumerate(zip(sums.use, sums.gram, sums.moment, strict=True)):
            left[c] = sums.power[c] + (gram @ values[use] - 2.0 * moment) @ values[use]
        now = np.sqrt(np.maximum(left, 0.0) / np.maximum(sums.rows - used, 1.0))
        now = np.maximum(now, least)
        done = bool(np.all(np.abs(np.log(now / noise)) < 1e-3))
        noise = now
        if done and k > 0:
            rounds = k + 1
    return Fit(sums, deviation, noise, log_evidence, values)


class _Split:
    """The products of one regression, by the columns that one channel has for itself and those of several."""

    def __init__(self, sums: Sums, deviation: Array) -> None:
        self.sums, self.deviation = sums, deviation
        count = np.zeros(sums.width, int)
        for use in sums.use:
            count[use] += 1
        self.shared = np.flatnonzero(count > 1)
        place = np.cumsum(count > 1) - 1  # of a column among the shared ones
        self.channels = []
        for use, gram, moment in zip(sums.use, sums.gram, sums.moment, strict=True):
            scaled = gram * np.outer(deviation[use], deviation[use])
            mine, common = np.flatnonzero(count[use] == 1), np.flatnonzero(count[use] > 1)
            right = moment * deviation[use]
            self.channels.append(
                _Channel(
                    use[mine],
                    place[use[common]],
                    scaled[np.ix_(mine, mine)],
                    scaled[np.ix_(mine, common)],
                    scaled[np.ix_(common, common)],
                    right[mine],
                    right[common],
                )
            )

    def at(self, noise: Array) -> tuple[float, Array, Array]:
        """Log evidence, (P,) posterior means and (C,) numbers that each channel determined, at its noise."""
        weight = 1.0 / noise**2
        schur, right = np.eye(len(self.shared)), np.zeros(len(self.shared))
        log_det, explained = 0.0, 0.0
        halves = []
        for w, ch in zip(weight, self.channels, strict=True):
            low = _precision(w * ch.gram)
            half = solve_triangular(low, w * ch.cross, lower=True, check_finite=False)
            mine = solve_triangular(low, w * ch.moment, lower=True, check_finite=False)
            schur[np.ix_(ch.place, ch.place)] += w * ch.common - half.T @ half
            schur[ch.place, ch.place] += JITTER * w * np.diagonal(ch.common)
            right[ch.place] += w * ch.right - half.T @ mine
            log_det += 2.0 * float(np.sum(np.log(np.diag(low))))
            explained += float(mine @ mine)
            halves.append((low, half, mine))
        low = _cholesky(schur)
        shared = np.asarray(cho_solve((low, True), right, check_finite=False))
        log_det += 2.0 * float(np.sum(np.log(np.diag(low))))
        explained += float(right @ shared)
        inverse = np.asarray(cho_solve((low, True), np.eye(len(low)), check_finite=False))
        scaled, used = np.zeros(len(self.deviation)), np.empty(len(noise))
        scaled[self.shared] = shared
        for c, (ch, (own, half, mine)) in enumerate(zip(self.channels, halves, strict=True)):
            rest = mine - half @ shared[ch.place]
            scaled[ch.columns] = solve_triangular(own, rest, lower=True, trans=1, check_finite=False)
            # trace of the channel's products times the posterior covariance, block by block
            alone = dtrtri(own, lower=1)[0] if len(own) else own  # all its columns may be shared
            back = alone.T @ half
            several = half.T @ half + back.T @ back - weight[c] * ch.common
            used[c] = len(own) - np.sum(alone**2) - np.sum(inverse[np.ix_(ch.place, ch.place)] * several)
        level = float(self.sums.rows @ np.log(2.0 * np.pi * noise**2))
        quad = float(weight @ self.sums.power) - explained
        return -0.5 * (level + log_det + quad), scaled * self.deviation, used


@dataclass(frozen=True)
class _Channel:
    """Of one channel, in units of the prior deviations: its own columns, then the places of the shared ones.

    `gram` (own, own), `cross` (own, shared), `common` (shared, shared), `moment` (own,), `right` (shared,).
    """

    columns: NDArray[np.intp]
    place: NDArray[np.intp]
    gram: Array
    cross: Array
    common: Array
    moment: Array
    right: Array


def _precision(gram: Array) -> Array:
    """Of a gram matrix that may be written over: the factor with the priors, of unit deviation, in it."""
    each = np.arange(len(gram))
    gram[each, each] += 1.0 + JITTER * np.diagonal(gram)
    return _cholesky(gram)


def _cholesky(gram: Array) -> Array:
    """Lower factor. Raises LinAlgError where more than rounding keeps the matrix from having one."""
    if not gram.size:
        return gram
    for share in MORE_JITTER:
        factor, info = dpotrf(gram + share * np.diag(np.diagonal(gram)) if share else gram, lower=1, clean=1)
        if info == 0:
            return np.asarray(factor)
    raise np.linalg.LinAlgError("the normal equations are not positive definite")
