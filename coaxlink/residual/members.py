"""Effects at a point, composed as they act on one another: what slows a rotor changes the thrust that the
ground then raises.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from coaxlink.effects import NotShown
from coaxlink.effects.tracing import Array, Shape, Tracing

Part = tuple[Tracing[Any], Mapping[str, float]]
ONSET = "onset_s"


@dataclass(frozen=True)
class Member:
    """An effect at a point: its shape, its coefficients, and which numbers of the shape are free."""

    effect: Tracing[Any]
    shape: Shape
    coefficients: Array  # (K,)
    keys: tuple[str, ...]  # free numbers of the shape

    @property
    def name(self) -> str:
        """The effect's name."""
        return self.effect.name

    @property
    def point(self) -> Array:
        """(K + keys,) coefficients, then the shape's free numbers."""
        return np.array([*self.coefficients, *(self.shape[k] for k in self.keys)])

    def at(self, point: Array) -> Member:
        """The member elsewhere."""
        count = len(self.coefficients)
        free = dict(zip(self.keys, map(float, point[count:]), strict=True))
        return replace(self, shape={**self.shape, **free}, coefficients=np.asarray(point[:count], float))

    def step(self, frame: Any, j: int) -> float:
        """How far number j of the point is moved for its derivative, inside its limits."""
        count = len(self.coefficients)
        if j < count:
            least = 1e-2 * float(np.max(np.abs(self.coefficients)))
            return 1e-3 * max(abs(float(self.coefficients[j])), least, 1e-9)
        low, high = self.effect.free(frame, self.shape)[self.keys[j - count]]
        value = float(self.shape[self.keys[j - count]])
        step = 1e-3 * max(abs(value), 0.02 * (high - low))
        return step if value + step <= high else -step

    def moved(self, frame: Any, values: Array, share: float) -> Member:
        """A share of the way to other values (K + keys,), no further than its limits."""
        point = self.point + share * (values - self.point)
        limits = self.effect.free(frame, self.shape)
        for i, key in enumerate(self.keys, start=len(self.coefficients)):
            low, high = limits[key]
            old, reach = self.shape[key], 0.25 * (high - low)
            if low > 0.0:  # a scale: no more than doubled or halved at once
                low, high = max(low, 0.5 * old), min(high, 2.0 * old)
            point[i] = np.clip(point[i], max(low, old - reach), min(high, old + reach))
        return self.at(point)

    def parameters(self, frame: Any) -> dict[str, float]:
        """Named physical numbers."""
        return self.effect.parameters(frame, self.shape, self.coefficients)


def member(frame: Any, effect: Tracing[Any], shape: Shape, coefficients: Array) -> Member:
    """An effect in a shape, with all that is continuous in it free."""
    return Member(effect, shape, np.asarray(coefficients, float), tuple(effect.free(frame, shape)))


def composed(frame: Any, parts: Sequence[Part]) -> Any:
    """The frame with effects in its prediction, in the order of their stages."""
    for effect, parameters in sorted(parts, key=lambda part: part[0].stage):
        frame = effect.acting(frame, parameters)
    return frame


def known_parts(
    frame: Any, effects: Sequence[Tracing[Any]], kind: str, absent: Callable[[Tracing[Any]], str | None]
) -> tuple[list[Part], list[str]]:
    """Which of a frame's `effects` its model carries already, and notes on those that this log cannot
    evaluate; `absent` says of one why it cannot, `kind` what it is a log of.
    """
    by_name = {e.name: e for e in effects}
    parts: list[Part] = []
    notes = []
    for known in frame.model.effects:
        effect = by_name.get(known.name)
        try:
            why = f"it is none of a {kind}" if effect is None else absent(effect)
            if effect is not None and why is None:
                parts.append((effect, effect.completed(frame, known.parameters)))
        except NotShown as error:
            why = str(error)
        if why is not None:
            notes.append(f"the model's effect {known.name} is left out: {why}")
    return parts, notes
