"""The regression that a refinement is: whitened residual, nuisance, and every effect's columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.effects.tracing import Array, Shape, Tracing
from coaxlink.residual.regression.blocks import Blocks, accumulate, folds_of

Index = NDArray[np.intp]
LONG_ROWS = 2000  # memory, no judgement: a longer design is kept in single precision (6e-8)


@dataclass(frozen=True)
class Option:
    """An effect in one shape, and where its columns stand in the design."""

    effect: Tracing[Any]
    shape: Shape
    columns: Index
    keys: tuple[str, ...] = ()  # numbers of the shape that the last columns move from where they are

    @property
    def name(self) -> str:
        """The effect's name."""
        return self.effect.name


@dataclass(frozen=True)
class Problem:
    """Everything the selection needs; rows are judged rows, errors are in units of `sigma`."""

    frame: Any
    channels: tuple[str, ...]
    units: tuple[str, ...]
    reference: Array  # (C,) load that a size is a share of
    sigma: Array  # (C,) whitening scale
    design: Array  # (rows, C, P) whitened
    residual: Array  # (rows, C) whitened
    block: Index  # (rows,)
    blocks: Blocks
    nuisance: Index
    nuisance_names: tuple[str, ...]
    options: tuple[Option, ...]
    impossible: tuple[tuple[str, str], ...]  # effects that cannot be tried, and why


def build(
    *,
    frame: Any,
    channels: Sequence[str],
    units: Sequence[str],
    reference: Array,
    residual: Array,
    sigma: Array,
    corrections: Sequence[tuple[str, float, Array]],
    effects: Sequence[Tracing[Any]],
    reduce: Callable[[Array], Array],
    block: Index,
) -> Problem:
    """Assemble the design. `corrections` are (name, bound, reduced (rows, C) columns), `reduce` maps what an
    effect adds on the frame's rows onto judged rows, `residual` (rows, C) is measured minus predicted."""
    # long logs are kept in single precision: the sums over them are not
    kind = np.float32 if len(residual) > LONG_ROWS else np.float64
    pieces = [(np.stack([c for _, _, c in corrections], axis=-1) / sigma[:, None]).astype(kind)]
    bounds = [b for _, b, _ in corrections]
    options: list[Option] = []
    impossible: list[tuple[str, str]] = []
    at = len(bounds)
    for effect in effects:
        why = effect.missing(frame)
        if why is not None:
            impossible.append((effect.name, why))
            continue
        first = len(options)
        for shape in effect.shapes(frame):
            columns = reduce(effect.columns(frame, shape))
            if not np.isfinite(columns).all():
                continue  # damaged readings
            pieces.append((columns / sigma[:, None]).astype(kind))
            width = columns.shape[-1]
            options.append(Option(effect, shape, np.arange(at, at + width)))
            bounds += [np.inf] * width
            at += width
        if len(options) == first:
            impossible.append((effect.name, "what the log reads gives no numbers for it"))
    design = _side_by_side(pieces)
    whitened = residual / sigma
    count = int(block.max()) + 1
    blocks = accumulate(design, whitened, block, folds_of(count), np.array(bounds))
    return Problem(
        frame=frame,
        channels=tuple(channels),
        units=tuple(units),
        reference=reference,
        sigma=sigma,
        design=design,
        residual=whitened,
        block=block,
        blocks=blocks,
        nuisance=np.arange(len(corrections)),
        nuisance_names=tuple(name for name, _, _ in corrections),
        options=tuple(options),
        impossible=tuple(impossible),
    )


def _side_by_side(pieces: list[NDArray[Any]]) -> NDArray[Any]:
    """Designs (rows, C, k) next to one another; they are let go one by one, for all of them are many."""
    design = np.empty((*pieces[0].shape[:2], sum(x.shape[-1] for x in pieces)), pieces[0].dtype)
    end = design.shape[-1]
    while pieces:
        last = pieces.pop()
        design[..., end - last.shape[-1] : end] = last
        end -= last.shape[-1]
    return design


def from_design(
    p: Problem, design: Array, residual: Array, options: Sequence[Option], *, frame: Any
) -> Problem:
    """The same rows, blocks and base with other columns behind the nuisance model; all whitened."""
    bounds = np.concatenate(
        [p.blocks.bounds[p.nuisance], np.full(design.shape[-1] - len(p.nuisance), np.inf)]
    )
    blocks = accumulate(design, residual, p.block, p.blocks.fold, bounds)
    return replace(
        p, frame=frame, design=design, residual=residual, blocks=blocks, options=tuple(options), impossible=()
    )


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
