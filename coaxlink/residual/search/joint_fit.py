"""The joint fit: the chosen effects and the nuisance at once, from the selection's grid to free shapes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from coaxlink.frames import Array
from coaxlink.residual.regression.blocks import held_out
from coaxlink.residual.regression.irls import channel_errors, reweighted_fit, settled_nuisance
from coaxlink.residual.regression.joint_model import (
    Fitter,
    Joint,
    Member,
    Part,
    columns_of,
    fit,
    member,
    needed,
    of_grid,
    straight,
)
from coaxlink.residual.regression.problem import Option, Problem
from coaxlink.residual.result import Step
from coaxlink.residual.search.select import Selection

LONG = 200_000  # judged rows times channels: beyond, other forms are not tried
WORSE = 1.02  # of the held-out squares: a joint fit that is worse than the plain sum has gone astray


def fitter_of(
    problem: Problem, bare: Any, known: Sequence[Part], names: set[str], reduce: Callable[[Array], Array]
) -> Fitter:
    return Fitter(problem, bare, [part for part in known if part[0].name not in names], reduce)


def fit_jointly(
    problem: Problem,
    selection: Selection,
    bare: Any,
    known: Sequence[Part],
    reduce: Callable[[Array], Array],
    *,
    nuisance: Callable[[Any, Callable[[Array], Array]], Array],
    all_of: bool = False,
) -> tuple[Joint, Any]:
    """Members and doubtful ones fitted jointly, and the frame with them acting.

    `nuisance(frame, reduce)` gives the nuisance corrections of a frame, (rows, C, B): with effects in it they
    are others than without. `all_of`: none is dropped for being needless.
    """
    options = [*selection.members, *selection.doubtful]
    names = {o.name for o in options}
    # an effect that the model has and the log gives other numbers for starts from those it has
    had = {effect.name: parameters for effect, parameters in known}
    fitter = fitter_of(problem, bare, known, names, reduce)
    plain = straight(problem, of_grid(problem, options))
    if not options:
        return straight(settled_nuisance(problem), []), fitter.acting([])
    start: list[Member] = []
    needless: list[Step] = []
    for o, m in zip(options, plain.members, strict=True):
        at = o.effect.inverse(bare, had[o.name]) if o.name in had else (m.shape, m.coefficients)
        start.append(member(bare, o.effect, *at))

    def allowed(j: Joint) -> bool:
        return not any(m.effect.refuse(m.parameters(bare)) for m in j.members)

    try:
        joint = fit(fitter, start, alternatives=problem.residual.size < LONG)
        if problem.residual.size < LONG and not (all_of or selection.doubtful or names & set(had)):
            joint = needed(fitter, joint)
            needless = _dropped(selection.members, joint)
        columns = nuisance(fitter.acting(joint.members), reduce) / problem.sigma[:, None]
        again, _ = Fitter(problem, bare, fitter.fixed, reduce, columns).settle(joint.members)
        joint = again if squares_of(again.problem) < squares_of(joint.problem) else joint
        rest = (problem, bare, fitter.fixed, reduce, nuisance)
        exact = reweighted_fit(joint, *rest, alternatives=problem.residual.size < LONG)
    except np.linalg.LinAlgError:  # numbers that no column tells apart
        return plain, fitter.acting(plain.members)
    # a fit that went astray may still have led the one weighed by what channels are left with to a good end
    better = allowed(exact) and _leaves(exact) < _leaves(plain)
    sound = allowed(joint) and squares_of(joint.problem) < WORSE * max(squares_of(plain.problem), 1e-12)
    if allowed(exact) and (sound or better or names & set(had)):
        joint = exact
    elif not (sound or names & set(had)):
        joint = plain
    kept = {m.name for m in joint.members}
    selection.trace += [step for step in needless if step.name not in kept]
    return joint, fitter.acting(joint.members)


def _dropped(chosen: Sequence[Option], joint: Joint) -> list[Step]:
    """A line of the trace for each that the joint fit does not need."""
    kept = {m.name for m in joint.members}
    why = "not needed in the joint fit"
    return [Step(9, "drop", o.name, 0.0, 1.0, 0.0, True, why) for o in chosen if o.name not in kept]


def _leaves(joint: Joint) -> float:
    """Sum of the logarithms of every channel's held-out error."""
    return float(np.sum(np.log(channel_errors(joint.problem, joint.problem.options))))


def squares_of(p: Problem) -> float:
    return float(held_out(p.blocks, columns_of(p))[0].sum())
