"""A log as channels: what was measured less what the model gives, row by row, and what may belong to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.effects.tracing import Array, Shape, Tracing
from coaxlink.evidence.blocks import Block, beside, waves
from coaxlink.residual.members import Part

# what an effect adds to a load, before any data: one standard deviation over the reference load
EFFECT_SIZE = 0.1
OVER_SPEED = 0.6  # correlation length of what a form may miss over a rotor's speed, in its range
LOADS = "loads"  # a free form's channel: all of them


@dataclass(frozen=True)
class Channels:
    """Everything that hypotheses about one log share."""

    frame: Any  # with what the model knows of already
    bare: Any  # without it
    known: tuple[Part, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    reference: Array  # (C,) load that a share is of
    target: Array  # (rows, C) measured less predicted
    block: NDArray[np.intp]  # (rows,) unit of independence
    least_noise: Array  # (C,) resolution
    variables: Mapping[str, Array]  # (rows,) by name, what was recorded
    speeds: Mapping[int, tuple[Array, ...]]  # of each channel, (rows,) the speeds that its load grows with
    weights: Array  # (rows, C) the load itself, in the channel's unit
    nuisance: tuple[Block, ...]
    surface: tuple[Block, ...]
    forms: Mapping[str, Callable[[], Block]]  # free forms by name
    effects: tuple[Tracing[Any], ...]
    reduce: Callable[[Array], Array]
    notes: tuple[str, ...] = ()
    impossible: tuple[tuple[str, str], ...] = ()
    # discrepancies of the rotor map beyond `surface`, by name: one of them, or none, is in every hypothesis
    maps: Mapping[str, Callable[[], tuple[Block, ...]]] = field(default_factory=dict)
    map: str = ""
    grid: list[tuple[Tracing[Any], Shape, Array]] = field(default_factory=list)  # filled by the first search

    @property
    def count(self) -> int:
        """Number of channels."""
        return len(self.names)

    @cached_property
    def over_speeds(self) -> tuple[tuple[Array, Array], ...]:
        """Of each channel a process over the speeds that its load goes with, of unit variance (`waves`)."""
        out = []
        for c, name in enumerate(self.names):
            speeds = self.speeds[c] if name.startswith("lower") else self.speeds[c][:1]
            moving = [speeds[0], *(u for u in speeds[1:] if np.ptp(u) > 0.0)]
            out.append(beside(*(waves(u, OVER_SPEED) for u in moving)))
        return tuple(out)

    def with_map(self, name: str) -> Channels:
        """With another of the map's discrepancies; "": none."""
        own = self.surface[: len(self.surface) - (len(self.maps[self.map]()) if self.map else 0)]
        return replace(self, surface=(*own, *(self.maps[name]() if name else ())), map=name)

    def usual(self, columns: Array) -> Array:
        """(K,) prior deviations of an effect's coefficients: what makes EFFECT_SIZE of the reference load."""
        size = np.sqrt(np.mean(columns**2, axis=0)) / self.reference[:, None]  # (C, K)
        return np.asarray(EFFECT_SIZE / np.maximum(size.max(axis=0), 1e-12))


def possible(frame: Any, effects: Sequence[Tracing[Any]]) -> tuple[list[Tracing[Any]], list[tuple[str, str]]]:
    """Effects that this log can show, and why it cannot show the others."""
    able, unable = [], []
    for effect in effects:
        why = effect.missing(frame)
        if why is None:
            able.append(effect)
        else:
            unable.append((effect.name, why))
    return able, unable
