"""Least squares on held-out blocks, all from the blocks' Gram matrices.

Once X_b' X_b and X_b' y_b are known for every block, a fit, its cross-validation, its robust variance and
its bootstrap cost nothing that grows with the rows. Base corrections are ridge-shrunk and stay inside their
bounds; effect columns are free.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]


FOLDS, ASSIGNMENTS, FARTHEST = 6, 200, 40
BEYOND = 1.0 + 1e-9  # of a bound
BATCH = 4096  # rows multiplied at once


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


@dataclass(frozen=True)
class Blocks:
    """Normal equations by block and channel, whitened by the channels' noise.

    Most columns touch one channel or a few: `gram[c][b]` is the Gram matrix of the columns `touched[c]` of
    the design in block b, channel c. `moment` is the design's (P,) product with the residual; `power` the
    residual's square sum; `rows` the judged rows of every block.
    """

    gram: tuple[Array, ...]  # of every channel (B, T, T)
    touched: tuple[Index, ...]  # of every channel (T,): the columns that are not zero there
    moment: Array  # (B, C, P)
    power: Array  # (B, C)
    rows: Array  # (B,)
    fold: NDArray[np.intp]  # (B,)
    # (P,) largest believable coefficient; inf for effects; twice its deviation, with a minus, for one that is
    # drawn from a normal distribution and has no limit
    bounds: Array

    @property
    def summed(self) -> tuple[Array, Array]:
        """(B, P, P) Gram matrices and (B, P) moments summed over the channels; made anew each time: large."""
        width = len(self.bounds)
        total = np.zeros((self.count, width, width))
        for gram, use in zip(self.gram, self.touched, strict=True):
            total[:, use[:, None], use] += gram
        return total, self.moment.sum(axis=1)

    @cached_property
    def total(self) -> tuple[Array, Array]:
        """(P, P) and (P,) of all blocks and channels: all that a fit needs."""
        return self.of(np.ones(self.count))

    def only(self, columns: Index) -> Blocks:
        """The normal equations of these columns (k,) alone, renumbered in their order."""
        place = np.full(len(self.bounds), -1, np.intp)
        place[columns] = np.arange(len(columns))
        mine = [np.flatnonzero(place[use] >= 0) for use in self.touched]
        return replace(
            self,
            gram=tuple(g[:, m[:, None], m] for g, m in zip(self.gram, mine, strict=True)),
            touched=tuple(place[use[m]] for use, m in zip(self.touched, mine, strict=True)),
            moment=self.moment[:, :, columns],
            bounds=self.bounds[columns],
        )

    @cached_property
    def trains(self) -> tuple[Array, Array]:
        """(folds, P, P) and (folds, P) of the blocks that each fold is fitted to."""
        grams, moments = zip(*(self.of(1.0 * (self.fold != f)) for f in np.unique(self.fold)), strict=True)
        return np.stack(grams), np.stack(moments)

    def of(self, weights: Array) -> tuple[Array, Array]:
        """(P, P) and (P,) of blocks by their weights (B,), summed over the channels."""
        total = np.zeros((len(self.bounds), len(self.bounds)))
        for gram, use in zip(self.gram, self.touched, strict=True):
            total[use[:, None], use] += np.tensordot(weights, gram, axes=1)
        return total, weights @ self.moment.sum(axis=1)

    @property
    def count(self) -> int:
        """Number of blocks."""
        return len(self.rows)


def accumulate(design: Array, residual: Array, block: Index, fold: Index, bounds: Array) -> Blocks:
    """Gram matrices of a whitened design (rows, C, P) and residual (rows, C); `block` (rows,) from 0."""
    rows = np.bincount(block)
    channels, width = design.shape[1:]
    moment = np.zeros((len(rows), channels, width))
    power = np.zeros((len(rows), channels))
    touched = tuple(np.flatnonzero(design[:, c].any(axis=0)) for c in range(channels))
    gram = tuple(np.zeros((len(rows), len(use), len(use))) for use in touched)
    order, start = np.argsort(block, kind="stable"), np.concatenate([[0], np.cumsum(rows)])
    for some in _batches(rows):
        number = np.arange(rows[some].max())
        inside = number < rows[some, None]  # (blocks, most rows of one): the rest is padded with zeros
        mine = order[np.where(inside, start[some, None] + number, 0)]
        for c, use in enumerate(touched):
            x, y = design[mine, c][..., use].astype(float), residual[mine, c, None].astype(float)
            x[~inside] = y[~inside] = 0.0
            flipped = x.swapaxes(1, 2)
            gram[c][some] = flipped @ x
            moment[some[:, None], c, use] = (flipped @ y)[..., 0]
            power[some, c] = (y.swapaxes(1, 2) @ y)[:, 0, 0]
    return Blocks(gram, touched, moment, power, rows.astype(float), fold, bounds)


def _batches(rows: Index) -> list[Index]:
    """Blocks in a row whose rows, each padded to the most of them, are few enough to multiply at once."""
    out: list[list[int]] = []
    most = 0
    for b, count in enumerate(rows):
        most = max(most, int(count))
        if not out or most * (len(out[-1]) + 1) > BATCH:
            out, most = [*out, []], int(count)
        out[-1].append(b)
    return [np.array(some, np.intp) for some in out]


def solve(blocks: Blocks, use: Index, weights: Array) -> Array:
    """Coefficients (P,), zero outside `use`, of the bounded ridge fit with block weights (B,)."""
    if np.all(weights == 1.0):
        grams, moments = blocks.total
        gram, moment = grams[use[:, None], use], moments[use]
    else:
        gram, moment = blocks.only(use).of(weights)
    return _spread(blocks, use, _bounded(gram, moment, blocks.bounds[use]))


def _spread(blocks: Blocks, use: Index, values: Array) -> Array:
    out = np.zeros(len(blocks.bounds))
    out[use] = values
    return out


def _bounded(gram: Array, moment: Array, bounds: Array) -> Array:
    """Ridge least squares (k,) of normal equations, bounded columns shrunk and kept inside."""
    scale, gram, moment, limit = scaled(gram, moment, bounds)
    value = solved(gram, moment[:, None])[:, 0]
    return np.asarray(_inside(gram, moment, limit, value) / scale)


def solved(gram: Array, moment: Array) -> Array:
    """Solutions (..., k, m) of normal equations (..., k, k); the shortest where columns say the same."""
    try:
        return np.asarray(np.linalg.solve(gram, moment), float)
    except (
        np.linalg.LinAlgError
    ):  # a column that stands still, or two that are one, in a part of a damaged log
        return np.asarray(np.linalg.pinv(gram, rcond=1e-12, hermitian=True) @ moment, float)


def scaled(gram: Array, moment: Array, bounds: Array) -> tuple[Array, Array, Array, Array]:
    """Scale (..., k) of normal equations, these with unit diagonals and the ridge, and the bounds."""
    # half a bound is one standard deviation of what a nuisance model may be off by
    ridge = np.where(np.isfinite(bounds), (2.0 / np.maximum(np.abs(bounds), 1e-300)) ** 2, 0.0)
    size = np.diagonal(gram, axis1=-2, axis2=-1) + ridge
    scale = np.sqrt(np.maximum(size, 1e-300))
    gram = gram / (scale[..., :, None] * scale[..., None, :])
    each = np.arange(len(bounds))
    gram[..., each, each] = size / scale**2 + 1e-10
    limit = np.asarray(np.where(bounds < 0.0, np.inf, bounds * scale), float)
    return scale, gram, moment / scale, limit


def _inside(gram: Array, moment: Array, limit: Array, value: Array) -> Array:
    """The free solution `value` (k,), those beyond their limit held there one after another."""
    fixed = np.zeros(len(limit), bool)
    for _ in range(len(limit)):
        beyond = ~fixed & (np.abs(value) > limit * BEYOND)
        if not beyond.any():
            break
        worst = int(np.argmax(np.where(beyond, np.abs(value) / limit, 0.0)))
        fixed[worst] = True
        value[worst] = np.sign(value[worst]) * limit[worst]
        free = ~fixed
        rows = gram[free]
        known = rows[:, fixed] @ value[fixed]
        value[free] = solved(rows[:, free], (moment[free] - known)[:, None])[:, 0]
    return value


def squares(blocks: Blocks, coefficients: Array, which: Array | None = None) -> Array:
    """(B, C) sum of squared whitened residuals under coefficients (P,); `which` (B,) bool picks blocks."""
    rows = np.arange(blocks.count) if which is None else np.flatnonzero(which)
    out = blocks.power[rows].copy()
    for channel, (gram, touched) in enumerate(zip(blocks.gram, blocks.touched, strict=True)):
        mine = np.flatnonzero(coefficients[touched] != 0.0)
        use = touched[mine]
        c = coefficients[use]
        square = (gram[rows[:, None, None], mine[:, None], mine] @ c) @ c
        out[:, channel] += square - 2.0 * blocks.moment[rows[:, None], channel, use] @ c
    return np.maximum(out, 0.0)


def held_out(blocks: Blocks, use: Index) -> tuple[Array, Array]:
    """(B, C) squared errors on blocks the fit did not see, and (folds, P) the coefficients of every fold."""
    out = np.zeros_like(blocks.power)
    fits = _fold_fits(blocks, use)
    for fold, fit in zip(np.unique(blocks.fold), fits, strict=True):
        test = blocks.fold == fold
        out[test] = squares(blocks, _spread(blocks, use, fit), test)
    return out, np.stack([_spread(blocks, use, fit) for fit in fits])


def _fold_fits(blocks: Blocks, use: Index) -> Array:
    """(folds, k) fits of all blocks but the fold's."""
    grams, moments = blocks.trains
    grams, moments, bounds = grams[:, use[:, None], use], moments[:, use], blocks.bounds[use]
    scale, gram, moment, limit = scaled(grams, moments, bounds)
    values = solved(gram, moment[..., None])[..., 0]
    for f in np.flatnonzero(np.any(np.abs(values) > limit * BEYOND, axis=1)):
        values[f] = _inside(gram[f], moment[f], limit[f], values[f])
    return np.asarray(values / scale)


def bootstrap(blocks: Blocks, use: Index, draws: int, seed: int = 0) -> Array:
    """(draws, P) coefficients with whole blocks drawn again, and every prior mean that is normal as well.

    Blocks alone would give a number that its prior holds no width (randomize-then-optimize: Bardsley,
    Solonen, Haario and Laine 2014).
    """
    random = np.random.default_rng(seed)
    weights = random.multinomial(blocks.count, np.full(blocks.count, 1.0 / blocks.count), size=draws)
    grams, moments = blocks.only(use).summed
    bounds = blocks.bounds[use]
    held = np.where(bounds < 0.0, 2.0 / np.maximum(np.abs(bounds), 1e-300), 0.0)  # one over the deviation
    means = held * random.standard_normal((draws, len(use)))
    fits = (
        _bounded(np.tensordot(w, grams, axes=1), w @ moments + mean, bounds)
        for w, mean in zip(1.0 * weights, means, strict=True)
    )
    return np.stack([_spread(blocks, use, fit) for fit in fits])


def error_interval(square_sums: Array, rows: Array, draws: int = 400, seed: int = 0) -> tuple[float, float]:
    """95 % interval of an rms error over blocks: (B,) square sums and rows."""
    random = np.random.default_rng(seed)
    pick = random.integers(0, len(rows), size=(draws, len(rows)))
    values = np.sqrt(square_sums[pick].sum(axis=1) / rows[pick].sum(axis=1))
    return float(np.quantile(values, 0.025)), float(np.quantile(values, 0.975))
