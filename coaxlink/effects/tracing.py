"""How an effect is traced in a log: what its module provides to the search."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Shape = Mapping[str, float]
Frame = TypeVar("Frame")
KEPT_ROWS = 40_000  # of columns that a frame keeps: megabytes


@dataclass(frozen=True)
class Tracing(Generic[Frame]):
    """One physical effect on top of the rotor model, linear in its coefficients once its shape is fixed.

    `shapes` lists the shapes worth trying (a height scale, a rotor number; `[{}]` where there is none);
    `columns` gives (rows, channels, K) of what unit coefficients add to the *measured minus predicted* side;
    Effects act in the order of their `stage`, each on the frame that the earlier ones left (`acting`): what
    slows a rotor changes the thrust that the ground then raises. `apply` does that where adding the columns
    to the loads is not enough. `free` gives the shape's continuous numbers and their physical limits, which
    the joint fit moves; `variants` other shapes and coefficients to start from there.

    `parameters` turns shape and coefficients (K,) into named physical numbers; `inverse` turns those back;
    `refuse` says why physics does not allow them, or None. `cause` is the variable (label, rows) that its
    picture of one channel is drawn over.
    """

    name: str
    physics: str
    source: str
    needs: tuple[str, ...]
    channels: tuple[str, ...]
    units: Mapping[str, str]
    missing: Callable[[Frame], str | None]
    shapes: Callable[[Frame], Sequence[Shape]]
    columns: Callable[[Frame, Shape], Array]
    parameters: Callable[[Frame, Shape, Array], dict[str, float]]
    inverse: Callable[[Frame, Mapping[str, float]], tuple[Shape, Array]]
    refuse: Callable[[Mapping[str, float]], str | None]
    cause: Callable[[Frame, Shape, str], tuple[str, Array]]
    sudden: bool = False  # may begin in mid-log: knows the shape number `onset_s`
    # parameters that say how much of it there is, and what each reads where there is none; {}: not asked
    nil: Callable[[Frame], Mapping[str, float]] = lambda _: {}
    stage: int = 5
    # of a shape, the coefficients that come with the effect and do not make it: a zero beside its drift
    carried: Callable[[Shape], tuple[int, ...]] = lambda _: ()
    apply: Callable[[Frame, Mapping[str, float]], Frame] | None = None
    free: Callable[[Frame, Shape], Mapping[str, tuple[float, float]]] = lambda _, __: {}
    variants: Callable[[Frame, Shape, Array], Sequence[tuple[Shape, Array]]] = lambda _, __, ___: ()

    def contribution(self, frame: Frame, parameters: Mapping[str, float]) -> Array:
        """(rows, channels) that the effect adds with these physical parameters."""
        shape, coefficients = self.inverse(frame, parameters)
        return np.asarray(self._columns_at(frame, shape) @ coefficients)

    def _columns_at(self, frame: Frame, shape: Shape) -> Array:
        """The columns; a short frame keeps the last ones: coefficients move more often than shapes."""
        last: list[tuple[object, Shape, Array]] = frame.last_columns  # type: ignore[attr-defined]
        if last and last[0][0] is self.columns and last[0][1] == shape:
            return last[0][2]
        columns = np.asarray(self.columns(frame, shape))
        if len(columns) < KEPT_ROWS:
            last[:] = [(self.columns, dict(shape), columns)]
        return columns

    def acting(self, frame: Frame, parameters: Mapping[str, float]) -> Frame:
        """The frame with the effect in its prediction."""
        if self.apply is not None:
            return self.apply(frame, parameters)
        predicted = frame.predicted + self.contribution(frame, parameters)  # type: ignore[attr-defined]
        return replace(frame, predicted=predicted)  # type: ignore[type-var]


def one_shape(_: object) -> Sequence[Shape]:
    """For effects without a shape."""
    return [{}]


def present(_: object) -> str | None:
    """For effects that every frame can show."""
    return None


def outside(name: str, value: float, low: float, high: float, unit: str = "") -> str | None:
    """Why a value is not physical, or None."""
    if low <= value <= high:
        return None
    return f"{name} = {value:.3g}{' ' + unit if unit else ''} is outside {low:g} .. {high:g}"
