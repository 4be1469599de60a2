"""Change points: the time at which an effect begins in mid-flight.

Blocks are contiguous in time, so the normal equations of a column that starts at a block's edge are sums over
the blocks behind it: every edge of every effect is tried at the cost of a small solve. Where a start in
mid-flight explains far more than a state that was always there, the effect is offered with that start too,
or, where that explains more still, as one that comes gradually: ice, a load that slides, a tank.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import numpy as np

from coaxlink.effects.onset import MARGIN_S
from coaxlink.effects.tracing import Array, Shape
from coaxlink.residual.regression.autocorrelation import autocorrelation_time
from coaxlink.residual.regression.blocks import accumulate
from coaxlink.residual.regression.joint_model import columns_of
from coaxlink.residual.regression.problem import Option, Problem

GAIN = 40.0  # of a log-likelihood ratio over the same effect without a beginning, all edges looked at
EDGE_BLOCKS = 3  # on either side
MOST = 3  # starts offered for each effect
# ramps that are tried about the best start: seconds over those flown, middles in ramps beside it
OVER, MIDDLE = (0.15, 0.3, 0.6, 0.9), (-0.25, 0.0, 0.25)
RAMP_GAIN = 15.0  # of a log-likelihood ratio over the sudden start: two numbers more, and twelve tried
AS_A_SAG = ("mass_change",)  # what changes the lift slowly is a supply as well, where no voltage was logged


def with_onsets(
    p: Problem, members: Sequence[Option], reduce: Callable[[Array], Array], barred: Collection[str] = ()
) -> Problem:
    """The problem with effects offered that begin in mid-flight; the same object where none is worth it.

    Those of `barred` names are not offered.
    """
    if len(np.unique(p.frame.log)) > 1 or p.blocks.count < 4 * EDGE_BLOCKS:
        return p
    offered = {
        (o.name, o.shape.get("rotor"), "speed_loss" in o.shape) for o in p.options if "onset_s" in o.shape
    }
    found: list[tuple[float, Option, float]] = []
    scan = _Scan(p, list(members))
    for option in p.options:
        if not option.effect.sudden or option.name in barred or "onset_s" in option.shape:
            continue
        gain, start = scan.best(option)
        if gain > GAIN:
            found.append((gain, option, start))
    found.sort(key=lambda f: -f[0])
    new: list[tuple[Option, Shape]] = []
    for name in {f[1].name for f in found}:
        for _, option, start in [f for f in found if f[1].name == name][:MOST]:
            key = (name, option.shape.get("rotor"), "speed_loss" in option.shape)
            if key not in offered:
                sharp = _sharper(p, scan, option, start, reduce)
                new.append((option, _ramped(p, scan, option, sharp, reduce)))
    return _offering(p, new, reduce) if new else p


class _Scan:
    """Gains of columns that start at a block's edge, beside the nuisance model and the members."""

    def __init__(self, p: Problem, members: list[Option]) -> None:
        self.p, self.use = p, columns_of(p, members)
        self.grams, self.moments = p.blocks.summed
        bounds = p.blocks.bounds[self.use]
        ridge = np.where(np.isfinite(bounds), (2.0 / np.maximum(np.abs(bounds), 1e-300)) ** 2, 1e-9)
        gram = self.grams[:, self.use[:, None], self.use].sum(axis=0) + np.diag(ridge)
        self.moment = self.moments[:, self.use].sum(axis=0)
        self.inverse = np.linalg.pinv(gram)
        self.left = float(p.blocks.power.sum() - self.moment @ self.inverse @ self.moment)
        rest = p.residual - p.design[:, :, self.use] @ (self.inverse @ self.moment)
        self.inflation = float(np.mean(autocorrelation_time(rest, p.block)))
        time = p.frame.time_s[p.frame.keep]
        self.starts = np.array([time[p.block == b].min() for b in range(p.blocks.count)])
        self.seconds = float(np.median(np.diff(self.starts)))

    def gain(self, cross: Array, square: Array, moment: Array) -> float:
        """Fall of the square sum by K columns with these products with base, themselves and residual."""
        left = moment - cross.T @ self.inverse @ self.moment
        own = square - cross.T @ self.inverse @ cross
        own = own + 1e-9 * (np.trace(own) + 1e-12) * np.eye(len(own))
        return float(left @ np.linalg.solve(own, left))

    def best(self, option: Option) -> tuple[float, float]:
        """Log-likelihood ratio of the best start over no start, and when it is, s."""
        at, use = option.columns, self.use
        # sums over the blocks from each on
        cross = np.cumsum(self.grams[:, use[:, None], at][::-1], axis=0)[::-1]
        square = np.cumsum(self.grams[:, at[:, None], at][::-1], axis=0)[::-1]
        moment = np.cumsum(self.moments[:, at][::-1], axis=0)[::-1]
        gains = np.array([self.gain(*x) for x in zip(cross, square, moment, strict=True)])
        edges = slice(EDGE_BLOCKS, len(gains) - EDGE_BLOCKS)
        k = EDGE_BLOCKS + int(np.argmax(gains[edges]))
        rows = self.p.residual.size
        rest = max(self.left - gains[k], 1e-9)
        return (gains[k] - gains[0]) * rows / rest / self.inflation, float(self.starts[k])

    def gain_of(self, columns: Array) -> float:
        """Of whitened columns (rows, C, K) as they are."""
        nuisance = self.p.design[:, :, self.use].reshape(-1, len(self.use)).astype(float)
        own = columns.reshape(-1, columns.shape[-1]).astype(float)
        return self.gain(nuisance.T @ own, own.T @ own, own.T @ self.p.residual.ravel())


def _sharper(
    p: Problem, scan: _Scan, option: Option, start: float, reduce: Callable[[Array], Array]
) -> Shape:
    """The option's shape with its start between the blocks' edges."""

    def gain(at: float) -> float:
        columns = reduce(option.effect.columns(p.frame, {**option.shape, "onset_s": at}))
        return scan.gain_of(columns / p.sigma[:, None])

    reach = scan.seconds
    for _ in range(3):
        places = start + reach * np.linspace(-1.0, 1.0, 7)
        start = float(places[int(np.argmax([gain(float(x)) for x in places]))])
        reach /= 3.0
    return {**option.shape, "onset_s": start}


def _ramped(
    p: Problem, scan: _Scan, option: Option, sudden: Shape, reduce: Callable[[Array], Array]
) -> Shape:
    """The shape as one that comes gradually, where that explains clearly more than its sudden start."""
    if option.name in AS_A_SAG and p.frame.voltage is None:
        return sudden

    def gain(shape: Shape) -> float:
        return scan.gain_of(reduce(option.effect.columns(p.frame, shape)) / p.sigma[:, None])

    flown = p.frame.time_s[p.frame.keep]
    first, last = float(flown[0]), float(flown[-1])
    ramps = []
    for share in OVER:
        over = share * (last - first)
        for middle in MIDDLE:
            begins = sudden["onset_s"] + (middle - 0.5) * over
            onset = float(np.clip(begins, first, last - MARGIN_S))
            ramps.append({**sudden, "onset_s": onset, "over_s": over})
    at_once, gains = gain(sudden), [gain(r) for r in ramps]
    best = int(np.argmax(gains))
    rest = max(scan.left - gains[best], 1e-9)
    more = (gains[best] - at_once) * p.residual.size / rest / scan.inflation
    return ramps[best] if more > RAMP_GAIN else sudden


def with_option(p: Problem, option: Option, shape: Shape, reduce: Callable[[Array], Array]) -> Problem:
    """The problem with an option in another shape as its last."""
    return _offering(p, [(option, shape)], reduce)


def _offering(p: Problem, new: Sequence[tuple[Option, Shape]], reduce: Callable[[Array], Array]) -> Problem:
    """The problem with more options."""
    options, pieces, at = list(p.options), [p.design], p.design.shape[-1]
    for option, shape in new:
        columns = reduce(option.effect.columns(p.frame, shape)) / p.sigma[:, None]
        pieces.append(columns.astype(p.design.dtype))
        options.append(Option(option.effect, shape, np.arange(at, at + columns.shape[-1])))
        at += columns.shape[-1]
    design = np.concatenate(pieces, axis=-1)
    bounds = np.concatenate([p.blocks.bounds, np.full(at - p.design.shape[-1], np.inf)])
    blocks = accumulate(design, p.residual, p.block, p.blocks.fold, bounds)
    return replace(p, design=design, blocks=blocks, options=tuple(options))
