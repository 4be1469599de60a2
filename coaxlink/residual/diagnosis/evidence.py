"""The marginal likelihood of a linear model with Gaussian priors, its noise levels at their best.

log p(y | H) = log N(y; 0, N + X P X'), by one Cholesky of X' N^-1 X + P^-1 (Rasmussen and Williams 2006,
eq. 2.8 and 5.8); the noise level of every channel follows MacKay's fixed point (1992,
Bayesian interpolation).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve
from scipy.linalg.lapack import dpotrf, dpotri

from coaxlink.frames import Array

ROUNDS = 2
JITTER = 1e-11  # of a diagonal: rounding of the products


@dataclass(frozen=True)
class Sums:
    """What a regression needs of its rows: per channel X'X (C, P, P), X'y (C, P), y'y (C,), rows (C,)."""

    gram: Array
    moment: Array
    power: Array
    rows: Array

    def beside(self, own: Array, cross: Array, moment: Array) -> Sums:
        """With columns more: their own (C, K, K) and cross (C, P, K) products, and moments (C, K)."""
        old, new = self.gram.shape[-1], own.shape[-1]
        gram = np.empty((len(self.power), old + new, old + new))
        gram[:, :old, :old], gram[:, old:, old:] = self.gram, own
        gram[:, :old, old:], gram[:, old:, :old] = cross, cross.swapaxes(1, 2)
        return Sums(gram, np.concatenate([self.moment, moment], axis=1), self.power, self.rows)


def sums_of(columns: Array, target: Array) -> Sums:
    """Of whitened columns (rows, C, P) and target (rows, C)."""
    by_channel = np.ascontiguousarray(columns.transpose(1, 2, 0))  # (C, P, rows)
    count, width = by_channel.shape[:2]
    gram, moment = np.zeros((count, width, width)), np.zeros((count, width))
    for c, x in enumerate(by_channel):
        use = np.flatnonzero(x.any(axis=1))
        gram[c][np.ix_(use, use)] = x[use] @ x[use].T
        moment[c, use] = x[use] @ target[:, c]
    return Sums(gram, moment, np.sum(target**2, axis=0), np.full(count, float(len(target))))


@dataclass(frozen=True)
class Fit:
    """A linear model at its best noise levels."""

    sums: Sums
    deviation: Array  # (P,) prior
    noise: Array  # (C,) standard deviations
    log_evidence: float
    values: Array  # (P,) posterior means
    factor: Array  # (P, P) lower Cholesky factor of the posterior precision, in units of the prior deviations


def fitted(sums: Sums, deviation: Array, noise: Array, least: Array, rounds: int = ROUNDS) -> Fit:
    """The model with its noise levels (C,) moved from `noise` to their best, none under `least`."""
    each = np.arange(len(deviation))
    for k in range(rounds + 1):
        weight = 1.0 / noise**2
        gram = np.tensordot(weight, sums.gram, 1) * np.outer(deviation, deviation)
        gram[each, each] += 1.0 + JITTER * np.diagonal(gram)
        factor, info = dpotrf(gram, lower=1, clean=1)
        if info != 0:
            raise np.linalg.LinAlgError("the normal equations are not positive definite")
        moment = (weight @ sums.moment) * deviation
        scaled = np.asarray(cho_solve((factor, True), moment, check_finite=False))
        values = scaled * deviation
        quad = weight @ sums.power - moment @ scaled
        log_det = 2.0 * float(np.sum(np.log(np.diag(factor))))
        level = float(sums.rows @ np.log(2.0 * np.pi * noise**2))
        log_evidence = -0.5 * (level + log_det + float(quad))
        if k == rounds:
            break
        left = sums.power - 2.0 * sums.moment @ values + (sums.gram @ values) @ values
        inverse = np.tril(dpotri(factor, lower=1)[0])
        inverse += np.tril(inverse, -1).T
        spread = inverse * np.outer(deviation, deviation)
        used = weight * np.tensordot(sums.gram, spread, 2)
        now = np.sqrt(np.maximum(left, 0.0) / np.maximum(sums.rows - used, 1.0))
        now = np.maximum(now, least)
        done = bool(np.all(np.abs(np.log(now / noise)) < 1e-3))
        noise = now
        if done and k > 0:
            rounds = k + 1
    return Fit(sums, deviation, noise, log_evidence, values, factor)
