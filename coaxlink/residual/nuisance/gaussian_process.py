"""The loads of a pair as a Gaussian process over both speeds: what the polynomials of a fit leave.

A log without a rotor model is judged beside a nuisance that was fitted to it. Where polynomials do not
follow the pair, what they miss is no effect, and the error that is left is not the effects' fault. Here it
is a random function: a load grows with the square of the speeds (similarity, Leishman 2006, ch. 2), its
coefficient bends with the ratio of the two speeds, most where the lower rotor is slow in a strong wake, and
slowly with the speed (Reynolds number). How strongly and how fast it bends is what predicts held-out blocks
best, as densities (Rasmussen and Williams 2006, eq. 2.25, 5.4.2). The process also says where the log does
not tell what the pair does: its own deviation there, from the blocks that were not held out, is larger than
the noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from coaxlink.effects.tracing import Array
from coaxlink.residual.nuisance.speed_ratio_surface import REST
from coaxlink.rotor.polynomial import design_matrix

Index = NDArray[np.intp]
INDUCING = 100  # points of the speeds that the process hangs on (Rasmussen and Williams 2006, eq. 8.14)
MOST = 60  # columns of a load
# lengths: of the ratio, of both speeds, of the upper one's own
BENDS, SLOPES, OWN = (0.1, 0.2, 0.4, 0.8), (0.5, 2.0), (0.15, 0.3, 0.6)
SIZES = (0.003, 0.01, 0.03, 0.1, 0.3)  # of the reference load, at full speed
FORGOTTEN = 0.05  # of the noise: what the columns that are left out would add
CURVATURE_ROWS = 4000  # rows that tell how it bends


@dataclass(frozen=True)
class Process:
    """A Gaussian process of one load, as columns beside polynomial terms that they hold nothing of."""

    lower: bool  # of a lower rotor: over both speeds; else over the upper one's own
    lengths: tuple[float, ...]
    points: Array  # (M, 2) speeds
    mixing: Array  # (M + 1, k) of the kernel's columns at the points, and of a lower rotor at rest
    terms: tuple[str, ...]
    share: Array  # (T, k) of the columns that the polynomials have already
    scale: float  # of a coefficient, as a bound: minus two deviations (it is shrunk, and free)

    def columns(self, speeds: Array) -> Array:
        """(rows, k) at speeds (rows, 2)."""
        raw = _raw(speeds, self.points, self.lengths, self.lower) @ self.mixing
        return np.asarray(raw - design_matrix(self.terms, *speeds.T) @ self.share)

    def __call__(self, speeds: Array) -> Array:
        """(rows,) of the load before any reading: nothing."""
        return np.zeros(len(speeds))


def find_process(
    speeds: Array,
    load: Array,
    fold: Index,
    noise: float,
    reference: float,
    terms: tuple[str, ...],
    lower: bool,
) -> tuple[Process, Array]:
    """The process of a load (rows,) at speeds (rows, 2), and how far off the nuisance itself may be (rows,).

    The latter is a deviation in units of `noise`, of every row from the blocks of the other folds; `fold`
    (rows,) is the fold of a row, `reference` the load that a size is a share of.
    """
    thin = np.arange(0, len(load), max(1, len(load) // CURVATURE_ROWS))
    points = _spread(speeds, INDUCING)
    poly = design_matrix(terms, *speeds[thin].T)
    best: tuple[float, Process] | None = None
    for lengths in product(BENDS, SLOPES) if lower else product(OWN):
        whitened = _whitened(points, lengths, lower)
        raw = _raw(speeds[thin], points, lengths, lower) @ whitened
        weight, turned = np.linalg.eigh(raw.T @ raw / len(thin))
        weight, turned = weight[::-1], turned[:, ::-1]
        for size in SIZES:
            forgotten = np.cumsum((weight * (size * reference / noise) ** 2)[::-1])[::-1]
            count = min(MOST, max(1, int(np.sum(forgotten > FORGOTTEN**2))))
            columns = raw @ turned[:, :count]
            left, variance = _held_out(poly, columns * size * reference, load[thin], fold[thin], noise)
            density = -float(np.mean(left**2 / (1.0 + variance) + np.log1p(variance)))
            if best is None or density > best[0]:
                share = np.asarray(np.linalg.lstsq(poly, columns, rcond=1e-10)[0], float)
                mixing = whitened @ turned[:, :count]
                scale = -2.0 * size * reference
                best = density, Process(lower, lengths, points, mixing, terms, share, scale)
    assert best is not None
    process = best[1]
    columns = process.columns(speeds) * (-0.5 * process.scale)
    _, variance = _held_out(design_matrix(terms, *speeds.T), columns, load, fold, noise)
    return process, np.sqrt(variance)


def _spread(speeds: Array, count: int) -> Array:
    """(at most count, 2) of the speeds, each the farthest from those before."""
    place = np.column_stack([_bend(speeds), np.hypot(*speeds.T)])
    at, apart = int(np.argmax(place[:, 1])), np.full(len(place), np.inf)
    chosen = [at]
    for _ in range(min(count, len(place)) - 1):
        apart = np.minimum(apart, np.hypot(*(place - place[at]).T))
        at = int(np.argmax(apart))
        if apart[at] < 1e-6:
            break
        chosen.append(at)
    return speeds[chosen]


def _bend(speeds: Array) -> Array:
    """(rows,) of the ratio of the speeds, finest where the lower rotor is slow; it spans 1.7."""
    angle = np.arctan2(np.maximum(speeds[:, 1], 0.0), np.maximum(speeds[:, 0], 1e-12))
    return np.asarray(np.log(angle + 0.02) / 2.5)


def _raw(speeds: Array, points: Array, lengths: tuple[float, ...], lower: bool) -> Array:
    """(rows, M + 1) the kernel between speeds (rows, 2) and points (M, 2), and a lower rotor at rest."""
    u = np.maximum(speeds, 0.0)
    if not lower:
        own, at = u[:, 0], points[:, 0]
        return np.column_stack([_kernel(own, at, lengths[0]) * np.outer(own, at) ** 2, np.zeros(len(own))])
    bend, at_bend = _bend(u), _bend(points)
    whole, at_whole = np.hypot(*u.T), np.hypot(*points.T)
    similar = _kernel(bend, at_bend, lengths[0]) * _kernel(whole, at_whole, lengths[1])
    rest = np.where(u[:, 1] < REST, u[:, 0] ** 2, 0.0)
    return np.column_stack([similar * np.outer(whole, at_whole) ** 2, rest])


def _kernel(a: Array, b: Array, length: float) -> Array:
    """Matern, twice differentiable (Rasmussen and Williams 2006, eq. 4.17)."""
    d = np.sqrt(5.0) * np.abs(a[:, None] - b[None]) / length
    return np.asarray((1.0 + d + d * d / 3.0) * np.exp(-d))


def _whitened(points: Array, lengths: tuple[float, ...], lower: bool) -> Array:
    """(M + 1, k) that makes the kernel's columns features of unit variance; rest stays as it is."""
    kernel = _raw(points, points, lengths, lower)[:, :-1]
    value, vector = np.linalg.eigh(
        0.5 * (kernel + kernel.T) + 1e-9 * np.trace(kernel) * np.eye(len(points)) / len(points)
    )
    use = value > 1e-7 * value[-1]
    out = np.zeros((len(points) + 1, int(use.sum()) + 1))
    out[:-1, :-1] = vector[:, use] / np.sqrt(value[use])
    out[-1, -1] = 1.0
    return out


def _held_out(poly: Array, columns: Array, load: Array, fold: Index, noise: float) -> tuple[Array, Array]:
    """(rows,) errors in units of the noise of rows that a fit did not see, and its variance there.

    Polynomials are free; `columns` have a coefficient of unit variance each.
    """
    x, y = np.column_stack([poly, columns]) / noise, load / noise
    prior = np.diag(np.concatenate([np.full(poly.shape[1], 1e-6), np.ones(columns.shape[1])]))
    gram, moment = x.T @ x + prior, x.T @ y
    left, variance = np.zeros(len(y)), np.zeros(len(y))
    for f in np.unique(fold):
        mine = fold == f
        inverse = np.linalg.pinv(gram - x[mine].T @ x[mine], rcond=1e-14, hermitian=True)
        left[mine] = y[mine] - x[mine] @ (inverse @ (moment - x[mine].T @ y[mine]))
        variance[mine] = np.einsum("ij,jk,ik->i", x[mine], inverse, x[mine], optimize=True)
    return left, np.maximum(variance, 0.0)
