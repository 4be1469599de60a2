"""The joint model: all chosen effects composed, as they act on one another, with free shapes.

The prediction is composed: what slows a rotor changes the thrust that the ground then raises. About the best
point, which the evidence finds, the problem is linear: held-out errors and intervals come from its blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from coaxlink.effects.tracing import Array, Shape, Tracing
from coaxlink.residual.regression.problem import Index, Option, Problem, from_design

Part = tuple[Tracing[Any], Mapping[str, float]]
ONSET = "onset_s"


@dataclass(frozen=True)
class Member:
    """An effect at a point: its shape, its coefficients, and which numbers of the shape are free."""

    effect: Tracing[Any]
    shape: Shape
    coefficients: Array  # (K,)
    keys: tuple[str, ...]  # free numbers of the shape
    whole: bool = False  # all of it is there, or nothing: its coefficient counts from one

    @property
    def name(self) -> str:
        """The effect's name."""
        return self.effect.name

    @property
    def point(self) -> Array:
        """(K + keys,) coefficients, then the shape's free numbers."""
        return np.array([*self.coefficients, *(self.shape[k] for k in self.keys)])

    @property
    def origin(self) -> Array:
        """(K + keys,) what a linear problem's numbers count from: coefficients nil, the shape as it is."""
        return np.array([*np.full(len(self.coefficients), self.whole), *(self.shape[k] for k in self.keys)])

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


def _same(a: Part, b: Part) -> bool:
    return a[0] is b[0] and a[1] == b[1]


@dataclass(frozen=True)
class Joint:
    """A problem about the best point of its members; option k of the problem is member k."""

    problem: Problem
    members: tuple[Member, ...]

    def named(self, k: int, values: Array) -> dict[str, float]:
        """Parameters of member k where the problem's coefficients (P,) are these."""
        mine = self.members[k]
        point = mine.origin + values[self.problem.options[k].columns]
        limits = mine.effect.free(self.problem.frame, mine.shape)
        for i, key in enumerate(mine.keys, start=len(mine.coefficients)):
            point[i] = np.clip(point[i], *limits[key])
        return mine.at(point).parameters(self.problem.frame)


def straight(problem: Problem) -> Joint:
    """Nothing added."""
    return Joint(replace(problem, options=()), ())


class Fitter:
    """Members of one problem; `bare` is the frame without them, `reduce` as the problem was built.

    `nuisance` (rows, C, B) are whitened base columns other than the problem's.
    """

    def __init__(
        self,
        problem: Problem,
        bare: Any,
        fixed: Sequence[Part],
        reduce: Callable[[Array], Array],
        nuisance: Array | None = None,
    ):
        self.problem, self.bare, self.fixed, self.reduce = problem, bare, fixed, reduce
        self._nuisance = problem.design[:, :, problem.nuisance] if nuisance is None else nuisance
        self._last: list[tuple[Part, Any]] = []  # what acted last, in order, and the frame it left

    def acting(self, members: Sequence[Member]) -> Any:
        """The frame with the members acting, from the first on that acts otherwise than it did last."""
        parts = [*self.fixed, *((m.effect, m.parameters(self.bare)) for m in members)]
        parts.sort(key=lambda part: part[0].stage)
        same = 0
        while same < min(len(parts), len(self._last)) and _same(parts[same], self._last[same][0]):
            same += 1
        del self._last[same:]
        frame = self._last[-1][1] if same else self.bare
        for effect, parameters in parts[same:]:
            frame = effect.acting(frame, parameters)
            self._last.append(((effect, parameters), frame))
        return frame

    def prediction(self, members: Sequence[Member]) -> Array:
        """(frame rows, channels) with the members acting."""
        return np.asarray(self.acting(members).predicted)

    def linear(self, members: Sequence[Member]) -> Joint:
        """The problem about these members: whitened residual, base columns, derivatives.

        Without a member's columns it is the problem without the member.
        """
        p, here = self.problem, self.prediction(members)
        sigma = p.sigma
        residual = self.reduce(self.bare.measured - here) / sigma
        columns, options, at = [], [], len(p.nuisance)
        for k, m in enumerate(members):
            point, origin = m.point, m.origin
            for j in range(len(point)):
                step = m.step(self.bare, j)
                moved = point.copy()
                moved[j] += step
                others = [m.at(moved) if i == k else o for i, o in enumerate(members)]
                slope = self.reduce(self.prediction(others) - here) / (sigma * step)
                columns.append(slope)
                residual = residual + slope * (point[j] - origin[j])
            options.append(Option(m.effect, m.shape, np.arange(at, at + len(point)), m.keys))
            at += len(point)
        design = np.concatenate(
            [self._nuisance, np.stack(columns, axis=-1).astype(self._nuisance.dtype)], axis=-1
        )
        return Joint(from_design(p, design, residual, options, frame=self.bare), tuple(members))


def columns_of(p: Problem, options: Sequence[Option] | None = None) -> Index:
    """Columns in use, of the nuisance model and of options: all of the problem's where none are given."""
    used = p.options if options is None else options
    return np.concatenate([p.nuisance, *(o.columns for o in used)]).astype(np.intp)
