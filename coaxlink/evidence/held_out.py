"""A set of explanations about its best numbers: errors on rows that the fit did not see, and intervals.

Rows come in blocks, whole blocks are held out or drawn again: neighbours share their noise. Every coefficient
has a normal prior, as in the evidence that found it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

Array = NDArray[np.float64]
Index = NDArray[np.intp]

FOLDS, ASSIGNMENTS, FARTHEST = 6, 200, 40
ROUNDING = 1e-10  # of a diagonal: of products of columns that are nearly one


@lru_cache(maxsize=64)
def folds_of(count: int, folds: int = FOLDS) -> Index:
    """(count,) the fold of each block in a row: of random balanced ones, that which repeats itself least.

    A schedule repeats itself: were blocks dealt in turn, every pass of the same set-points could be held out
    at once, and the error be that of speeds the fit never saw.
    """
    random = np.random.default_rng(0)
    least, best = np.inf, np.arange(count) % folds
    for _ in range(ASSIGNMENTS if count > folds else 0):
        dealt = np.concatenate([random.permutation(folds) for _ in range(-(-count // folds))])[:count]
        apart = range(1, min(count // 2, FARTHEST) + 1)
        alike = [float(np.mean(dealt[k:] == dealt[:-k])) for k in apart]
        score = max(alike) + float(np.mean(alike)) + alike[0] * count  # neighbours never
        if score < least:
            least, best = score, dealt
    return best.astype(np.intp)


def contiguous_blocks(time_s: Array, run: Array | Index, *, least_s: float, count: int) -> Index:
    """(rows,) block numbers: contiguous pieces of runs, about `count` of them, none shorter than needed."""
    total = 0.0
    for number in np.unique(run):
        t = time_s[run == number]
        total += float(t[-1] - t[0]) if len(t) > 1 else 0.0
    length = max(least_s, total / count)
    out = np.zeros(len(time_s), np.intp)
    at = 0
    for number in np.unique(run):
        rows = np.flatnonzero(run == number)
        t = time_s[rows] - time_s[rows[0]]
        pieces = max(1, round(float(t[-1]) / length))
        local = np.minimum((t / max(float(t[-1]), 1e-9) * pieces).astype(np.intp), pieces - 1)
        out[rows] = at + local
        at += int(local.max()) + 1
    _, dense = np.unique(out, return_inverse=True)
    return dense.astype(np.intp)


@dataclass(frozen=True)
class Regression:
    """Columns (rows, C, P) on a target (rows, C), both in the channels' units, rows of a channel of `sigma`.

    `mean` and `deviation` (P,) are the coefficients' priors (inf: none), `block` (rows,) from 0.
    """

    columns: Array
    target: Array
    mean: Array
    deviation: Array
    sigma: Array  # (C,)
    block: Index

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.mean)

    def only(self, columns: Index) -> Regression:
        """With these columns (k,) alone."""
        gram, moment = self.products
        out = replace(
            self,
            columns=self.columns[..., columns],
            mean=self.mean[columns],
            deviation=self.deviation[columns],
        )
        out.__dict__["products"] = gram[:, columns[:, None], columns], moment[:, columns]
        return out

    @cached_property
    def products(self) -> tuple[Array, Array]:
        """(B, P, P) and (B, P) of every block, its channels together."""
        count = int(self.block.max()) + 1
        gram, moment = np.zeros((count, self.width, self.width)), np.zeros((count, self.width))
        order = np.argsort(self.block, kind="stable")
        ends = np.cumsum(np.bincount(self.block))
        for c, sigma in enumerate(self.sigma):
            use = np.flatnonzero(self.columns[:, c].any(axis=0))
            x, y = self.columns[order][:, c, use] / sigma, self.target[order, c] / sigma
            for b, (first, end) in enumerate(zip([0, *ends[:-1]], ends, strict=True)):
                mine = x[first:end]
                gram[b][np.ix_(use, use)] += mine.T @ mine
                moment[b, use] += mine.T @ y[first:end]
        return gram, moment

    @cached_property
    def values(self) -> Array:
        """(P,) of all rows."""
        return self._solved(np.ones(len(self.products[0])), self.mean)

    @cached_property
    def held_out(self) -> Array:
        """(rows, C) what is left of every row under the fit that did not see its block."""
        fold = folds_of(len(self.products[0]))
        out = np.empty_like(self.target)
        for f in np.unique(fold):
            rows = fold[self.block] == f
            out[rows] = self.target[rows] - self.columns[rows] @ self._solved(1.0 * (fold != f), self.mean)
        return out

    @property
    def errors(self) -> Array:
        """(C,) root mean square of what is held out."""
        return np.asarray(np.sqrt(np.mean(self.held_out**2, axis=0)))

    def drawn(self, draws: int, seed: int = 0) -> Array:
        """(draws, P) coefficients with whole blocks drawn again, and every prior mean as well.

        Blocks alone would give a number that its prior holds no width (randomize-then-optimize: Bardsley,
        Solonen, Haario and Laine 2014).
        """
        random, count = np.random.default_rng(seed), len(self.products[0])
        weights = random.multinomial(count, np.full(count, 1.0 / count), size=draws)
        spread = np.where(np.isfinite(self.deviation), self.deviation, 0.0)
        means = self.mean + spread * random.standard_normal((draws, self.width))
        return np.stack([self._solved(1.0 * w, m) for w, m in zip(weights, means, strict=True)])

    def _solved(self, weights: Array, mean: Array) -> Array:
        """(P,) of blocks by their weights (B,)."""
        gram, moment = (np.tensordot(weights, x, axes=1) for x in self.products)
        precision = 1.0 / np.maximum(self.deviation, 1e-150) ** 2
        moment = moment + precision * mean
        scale = np.sqrt(np.maximum(np.diagonal(gram) + precision, 1e-300))
        gram = (gram + np.diag(precision)) / np.outer(scale, scale) + ROUNDING * np.eye(self.width)
        _, solution, info = lapack.dposv(gram, moment / scale)
        if info:  # two columns that are one, in a part of a damaged log: the shortest
            solution = np.linalg.pinv(gram, rcond=1e-12, hermitian=True) @ (moment / scale)
        return np.asarray(solution / scale)


def error_interval(left: Array, block: Index, draws: int = 400, seed: int = 0) -> tuple[float, float]:
    """95 % interval of the root mean square of values (rows,), whole blocks drawn again."""
    random, rows = np.random.default_rng(seed), np.bincount(block)
    squares = np.bincount(block, left**2)
    pick = random.integers(0, len(rows), size=(draws, len(rows)))
    values = np.sqrt(squares[pick].sum(axis=1) / rows[pick].sum(axis=1))
    return float(np.quantile(values, 0.025)), float(np.quantile(values, 0.975))
