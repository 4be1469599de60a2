"""The joint model: all chosen effects composed, as they act on one another, with free shapes.

The selection works with effects that add up, in shapes from a grid. Here the prediction is composed (what
slows a rotor changes the thrust that the ground then raises) and coefficients and continuous shape numbers
are moved together with the nuisance corrections by Gauss-Newton steps. At the end the problem is linear
again, about the best point: held-out errors and intervals come from the same blocks as before.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from coaxlink.effects.tracing import Array, Shape, Tracing
from coaxlink.residual.regression.autocorrelation import autocorrelation_time
from coaxlink.residual.regression.blocks import held_out_sum, least_of, solve
from coaxlink.residual.regression.problem import Index, Option, Problem, from_design

Part = tuple[Tracing[Any], Mapping[str, float]]
STEPS = 5
ONSET = "onset_s"
FORMS = 3  # of a member, each from the one before
SHORT = 40_000  # judged rows times channels: candidates are taken through the members
HALVINGS = (1.0, 0.5, 0.2, 0.05)
SETTLED = 1e-4  # of the square sum
BETTER, AS_GOOD = 0.98, 1.02  # of the held-out squares
RICHER = 15.0  # of a log-likelihood ratio: what another form or a freer one must gain


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


def _frozen(m: Member) -> Member:
    """Without a free beginning: a fit that does not see the rows about it knows nothing of it."""
    return replace(m, keys=tuple(k for k in m.keys if k != ONSET))


def _thawed(m: Member, frame: Any) -> Member:
    """With its beginning free."""
    late = ONSET in m.shape and ONSET not in m.keys and ONSET in m.effect.free(frame, m.shape)
    return replace(m, keys=(*m.keys, ONSET)) if late else m


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


def straight(problem: Problem, options: Sequence[Option]) -> Joint:
    """The options as the selection has them: shapes of the grid, columns added up."""
    chosen = replace(problem, options=tuple(options))
    values = solve(problem.blocks, columns_of(chosen), np.ones(problem.blocks.count))
    members = tuple(Member(o.effect, o.shape, values[o.columns], ()) for o in options)
    return Joint(chosen, members)


class Fitter:
    """Moves members of one problem; `bare` is the frame without them, `reduce` as the problem was built.

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
        self._fitted_nuisance = nuisance is not None
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

    def settle(self, members: Sequence[Member]) -> tuple[Joint, float]:
        """Gauss-Newton from here: the linear problem about the best point, and its held-out square sum."""
        best = self.linear([_thawed(m, self.bare) for m in members])
        least = self._least(members)
        for _ in range(STEPS):
            blocks = best.problem.blocks
            values = solve(blocks, columns_of(best.problem), np.ones(blocks.count))
            for share in HALVINGS:
                pairs = zip(best.members, best.problem.options, strict=True)
                moved = tuple(m.moved(self.bare, m.origin + values[o.columns], share) for m, o in pairs)
                now = self._least(moved)
                if now < least:
                    break
            else:
                break
            done = now > least * (1.0 - SETTLED)
            best, least = self.linear(moved), now
            if done:
                break
        if any(ONSET in m.keys for m in best.members):
            best = self.linear([_frozen(m) for m in best.members])
        return best, _score(best)

    def _least(self, members: Sequence[Member]) -> float:
        """Square sum with the members exactly where they stand, the nuisance model at its best."""
        p = self.problem
        residual = self.reduce(self.bare.measured - self.prediction(members)) / p.sigma
        return least_of(self._gram, p.blocks.bounds[p.nuisance], self._nuisance, residual)

    @cached_property
    def _gram(self) -> Array:
        """(B, B) of the nuisance model columns."""
        p, nuisance = self.problem, self._nuisance
        if self._fitted_nuisance:
            return np.einsum("rci,rcj->ij", nuisance, nuisance, optimize=True)
        return np.asarray(p.blocks.total[0][p.nuisance[:, None], p.nuisance])


def columns_of(p: Problem, options: Sequence[Option] | None = None) -> Index:
    """Columns in use, of the nuisance model and of options: all of the problem's where none are given."""
    used = p.options if options is None else options
    return np.concatenate([p.nuisance, *(o.columns for o in used)]).astype(np.intp)


def of_grid(problem: Problem, options: Sequence[Option]) -> list[Option]:
    """The problem's own options nearest to these, which may be of another problem."""
    out = []
    for o in options:
        mine = [x for x in problem.options if x.name == o.name]
        out.append(min(mine, key=lambda x: _distance(x.shape, o.shape)))
    return out


def _distance(a: Shape, b: Shape) -> float:
    return sum(abs(a.get(k, 9.0) - b.get(k, 9.0)) for k in {*a, *b})


def _score(joint: Joint) -> float:
    """Held-out square sum about the point the problem is linear at, base free, members as they stand."""
    return float(held_out_sum(joint.problem.blocks, columns_of(joint.problem)).sum())


def _inflation(p: Problem) -> float:
    """How much less the rows say than independent ones would, where what is left hangs together in time."""
    values = solve(p.blocks, columns_of(p), np.ones(p.blocks.count))
    left = p.residual - p.design @ values
    return float(np.max(autocorrelation_time(left, p.block)))


def fit(fitter: Fitter, members: Sequence[Member], alternatives: bool = True) -> Joint:
    """The best joint fit from these members, other forms of each tried if they gain enough.

    Members whose numbers another's better form makes unphysical are dropped with it.
    """
    best, score = fitter.settle(members)
    astray = _refused(fitter, best)
    if (
        astray
    ):  # a shape and its coefficient that the data hardly tell apart: the shape stays as it was chosen
        trial, now = fitter.settle([replace(m, keys=()) if m.name in astray else m for m in members])
        if not _refused(fitter, trial):
            best, score = trial, now
    if not alternatives:
        return best
    rows = fitter.problem.residual.size / _inflation(best.problem)
    for name in [m.name for m in members]:
        for _ in range(FORMS):
            better = _other_form(fitter, best, score, name, rows)
            if better is None:
                break
            best, score = better
    return best


def _other_form(
    fitter: Fitter, best: Joint, score: float, name: str, rows: float
) -> tuple[Joint, float] | None:
    """The joint fit with a member in the best of its other forms, and its score; None: none gains enough."""
    mine = next((m for m in best.members if m.name == name), None)
    if mine is None:
        return None
    improved: Shape = {}
    for shape, coefficients in mine.effect.variants(fitter.bare, mine.shape, mine.coefficients):
        if improved and set(shape) == set(improved):
            continue  # this form from another start
        other = member(fitter.bare, mine.effect, shape, coefficients)
        trial, now = fitter.settle([other if m.name == name else m for m in best.members])
        refused = _refused(fitter, trial)
        if refused and name not in refused:
            trial, now = fitter.settle([m for m in trial.members if m.name not in refused])
            refused = _refused(fitter, trial)
        richer = (score - now) * rows / max(score, 1e-12) > RICHER
        # of as few numbers: whichever predicts better
        richer = richer or (len(other.keys) <= len(mine.keys) and now < BETTER * score)
        # a form that physics allows takes the place of one it does not
        allowed = now < AS_GOOD * score and bool(_refused(fitter, best))
        if not refused and (richer or allowed):
            best, score, improved = trial, now, shape
    return (best, score) if improved else None


def needed(fitter: Fitter, joint: Joint) -> Joint:
    """The joint fit without members that it does not need: weakest first, the others fitted again."""
    while len(joint.members) > 1:
        score = _score(joint)
        rows = fitter.problem.residual.size / _inflation(joint.problem)
        trials = [fitter.settle([m for m in joint.members if m is not drop]) for drop in joint.members]
        least = min(trials, key=lambda t: t[1])
        if (least[1] - score) * rows / max(score, 1e-12) > RICHER or _refused(fitter, least[0]):
            break
        joint = least[0]
    return joint


def _refused(fitter: Fitter, joint: Joint) -> set[str]:
    """Members whose numbers physics does not allow, as they stand or as the linear problem has them."""
    p = joint.problem
    values = solve(p.blocks, columns_of(p), np.ones(p.blocks.count))
    return {
        m.name
        for k, m in enumerate(joint.members)
        if m.effect.refuse(m.parameters(fitter.bare)) or m.effect.refuse(joint.named(k, values))
    }
