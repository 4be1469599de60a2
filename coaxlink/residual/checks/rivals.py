"""Rivals: each effect given up in turn for every other one that could stand in for it.

The selection climbs: of two names for the same rows it takes the one that is ahead in a shape of its
grid, and then the other adds nothing. So every claimed effect is taken out again, each other one is put
in its place and moved to its best beside the rest, and the two are compared by the log likelihood of
held-out blocks: normal errors of unknown size in every channel, rows counted by what their residual's
correlation leaves of them. A held-out error charges a nat for every number that was fitted (Stone 1977),
the evidence half the logarithm of the rows (Schwarz 1978): what has more numbers pays the difference.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from coaxlink.frames import Array
from coaxlink.residual.regression.blocks import solve
from coaxlink.residual.regression.gates import autocorrelation_time
from coaxlink.residual.regression.irls import channel_errors
from coaxlink.residual.regression.joint_model import Joint, Member, of_grid
from coaxlink.residual.regression.problem import Option, Problem
from coaxlink.residual.search.select import NESTED
from coaxlink.residual.search.trial import ALPHA, Judge, Trial, columns_of

# the joint fit of options of the problem, members that were fitted before starting from where they were
Fitted = Callable[[Sequence[Option], Mapping[str, Member]], Joint]

APART = -float(np.log(ALPHA))  # nats: as improbable as the chance that the selection allows
STANDS_IN = 0.5  # of what an effect explains, in a shape of the grid: less is no rival


@dataclass(frozen=True)
class Rivalry:
    """An effect, and what could stand in for it: another one, or another form of one that is there already.

    `nats` is how far it is ahead of that, or what it still gains beside it, if that is more. Options are
    of the problem that was searched; `rest` are the other members, but for the one whose form changes.
    """

    option: Option
    rest: tuple[Option, ...]
    rival: Trial
    nats: float
    form: bool

    @property
    def equal(self) -> bool:
        """Whether the log does not tell the effect from another one."""
        return not self.form and self.nats < APART

    @property
    def lost(self) -> bool:
        """Whether the effect gives way: to one clearly ahead, or to a form that leaves it needless."""
        return self.nats < (APART if self.form else -APART)


def rivalries(problem: Problem, joint: Joint, fitted: Fitted, derived: Collection[str] = ()) -> list[Rivalry]:
    """Every member of a joint fit against the other effects of `problem`, which has each in all its forms.

    Members named in `derived` have another reason than a smaller error, and no rival.
    """
    judge, out = Judge(problem), []
    members = {m.name: m for m in joint.members}
    options = of_grid(problem, joint.problem.options)
    rows, best = _effective_rows(joint), _log_errors(joint)
    for mine in [o for o in options if o.name not in derived]:
        rest = [o for o in options if o is not mine]
        for others, rival in _rivals_of(judge, mine, rest):
            settled = {o.name: members[o.name] for o in others}
            swapped = fitted([*others, rival.option], settled)
            if rival.option.name not in {m.name for m in swapped.members}:
                continue  # physics does not allow it there
            left = _log_errors(swapped)
            more = _numbers(swapped) - _numbers(joint)
            nats = float(rows @ (left - best)) + more * (0.5 * np.log(np.sum(rows)) - 1.0)
            if nats < APART:  # what a name explains beside another is not what the other explains
                both = fitted([*others, rival.option, mine], {**settled, mine.name: members[mine.name]})
                nats = max(nats, float(rows @ (left - _log_errors(both))))
            out.append(Rivalry(mine, tuple(others), rival, nats, len(others) < len(rest)))
    return out


def _rivals_of(judge: Judge, mine: Option, rest: list[Option]) -> list[tuple[list[Option], Trial]]:
    """What could stand in for an effect beside others, by shapes of the grid, and those that then stay."""
    out = []
    without = judge.left(rest)
    worth = without - judge.left([*rest, mine])
    for trial in judge.best_of_each(rest):
        other = trial.option
        # what is a special case of another is explained by the other as well
        if other.name == mine.name or other.effect.accused or (mine.name, other.name) in NESTED:
            continue
        if without - trial.total >= STANDS_IN * worth:
            out.append((rest, trial))
    for o in rest:
        others = [x for x in rest if x is not o]
        form = judge.best_of_each(others, {o.name})[0]
        if dict(form.option.shape) != dict(o.shape):
            out.append((others, form))
    return out


def _log_errors(joint: Joint) -> Array:
    return np.log(np.maximum(channel_errors(joint.problem, joint.problem.options), 1e-300))


def _numbers(joint: Joint) -> int:
    """That were fitted beside the base."""
    return sum(len(o.columns) for o in joint.problem.options)


def _effective_rows(joint: Joint) -> Array:
    """(C,) rows over the correlation of what is left of them."""
    q = joint.problem
    fit = solve(q.blocks, columns_of(q, list(q.options)), np.ones(q.blocks.count))
    left = q.residual - q.design @ fit
    return np.asarray(float(q.blocks.rows.sum()) / autocorrelation_time(left, q.block))
