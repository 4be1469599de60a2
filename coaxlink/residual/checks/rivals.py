"""Rivals: each effect given up in turn for every other one that could be confounded with it.

The selection climbs: of two names for the same rows it takes the one that is ahead in a shape of its
grid, and then the other adds nothing. So every claimed effect is taken out again, each other one is put
in its place and moved to its best beside the rest, and the two are compared by the log likelihood of
held-out blocks: normal errors of unknown size in every channel, rows counted by what their residual's
correlation leaves of them. A held-out error charges a nat for every number that was fitted (Stone 1977),
the evidence half the logarithm of the rows (Schwarz 1978): what has more numbers pays the difference.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from coaxlink.frames import Array
from coaxlink.residual.regression.autocorrelation import autocorrelation_time
from coaxlink.residual.regression.blocks import solve
from coaxlink.residual.regression.irls import channel_errors
from coaxlink.residual.regression.joint_model import Joint, columns_of, of_grid
from coaxlink.residual.regression.problem import Option, Problem
from coaxlink.residual.search.select import NESTED
from coaxlink.residual.search.trial import ALPHA, Judge, Trial

# the joint fit of options of the problem
Fitted = Callable[[Sequence[Option]], Joint]

APART = -float(np.log(ALPHA))  # nats: as improbable as the chance that the selection allows
CONFOUNDED = 0.5  # of what an effect explains, in a shape of the grid: less is no rival


@dataclass(frozen=True)
class Rivalry:
    """An effect, and what could be confounded with it: another one, or another form of one that is there
    already.

    `nats` is how far it is ahead of that, or what it still gains beside it, if that counts and is more than
    it is behind. Options are of the problem that was searched; `rest` are the other members, but for the one
    whose form changes.
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


def rivalries(problem: Problem, joint: Joint, fitted: Fitted, derived: Collection[str] = ()) -> list[Rivalry]:
    """Every member of a joint fit against the other effects of `problem`, which has each in all its forms.

    Members named in `derived` have another reason than a smaller error, and no rival.
    """
    judge, out = Judge(problem), []
    options = of_grid(problem, joint.problem.options)
    claimed = _Held.of(joint)
    for mine in [o for o in options if o.name not in derived]:
        rest = [o for o in options if o is not mine]
        screened = [(rest, trial) for trial in _in_its_place(problem, judge, rest, mine)]
        for others, rival in [*screened, *_of_other_forms(judge, rest)]:
            swapped = fitted([*others, rival.option])
            if rival.option.name not in {m.name for m in swapped.members}:
                continue  # physics does not allow it there
            instead, form = _Held.of(swapped), len(others) < len(rest)
            more = _numbers(swapped) - _numbers(joint)
            nats = claimed.ahead_of(instead) + more * (0.5 * np.log(np.sum(claimed.rows)) - 1.0)
            if nats < APART:  # what a name explains beside another is not what the other explains
                both = fitted([*others, rival.option, mine])
                own = _Held.of(both).ahead_of(instead)
                nats = own if own >= APART else nats
            out.append(Rivalry(mine, tuple(others), rival, nats, form))
    return out


def _in_its_place(problem: Problem, judge: Judge, stays: list[Option], mine: Option) -> list[Trial]:
    """What could be confounded with an effect beside those that stay, about whose fit the judge looks.

    They found their shapes beside the one that is given up; in a shape of the grid they leave so much that
    nothing else shows. And what a stand that sticks shows of an effect goes through the sticking.
    """
    mine = of_grid(judge.problem, [mine])[0]
    without = judge.left(stays)
    worth = without - judge.left([*stays, mine])
    out = []
    for trial in judge.best_of_each(stays):
        other = trial.option
        # what is a special case of another is explained by the other as well
        if other.name == mine.name or (mine.name, other.name) in NESTED:
            continue
        if without - trial.total >= CONFOUNDED * worth:
            # by its columns in the problem that was asked, not in the one beside the fit
            out.append(replace(trial, option=of_grid(problem, [other])[0]))
    return out


def _of_other_forms(judge: Judge, rest: list[Option]) -> list[tuple[list[Option], Trial]]:
    """Other forms of each effect that stays, and those that then stay as they are."""
    out = []
    for o in rest:
        others = [x for x in rest if x is not o]
        form = judge.best_of_each(others, {o.name})[0]
        if dict(form.option.shape) != dict(o.shape):
            out.append((others, form))
    return out


@dataclass(frozen=True)
class _Held:
    """What a joint fit leaves of held-out blocks."""

    log_errors: Array  # (C,)
    rows: Array  # (C,) over the correlation of what is left of them

    @classmethod
    def of(cls, joint: Joint) -> _Held:
        errors = channel_errors(joint.problem, joint.problem.options)
        return cls(np.log(np.maximum(errors, 1e-300)), _effective_rows(joint))

    def ahead_of(self, other: _Held) -> float:
        """Log likelihood ratio to another fit, rows counted as the better of both leaves them, by channel.

        What the worse one leaves hangs together because it misses something, and is no noise.
        """
        rows = np.where(self.log_errors < other.log_errors, self.rows, other.rows)
        return float(rows @ (other.log_errors - self.log_errors))


def _numbers(joint: Joint) -> int:
    """That were fitted beside the nuisance model."""
    return sum(len(o.columns) for o in joint.problem.options)


def _effective_rows(joint: Joint) -> Array:
    """(C,) rows over the correlation of what is left of them."""
    q = joint.problem
    fit = solve(q.blocks, columns_of(q), np.ones(q.blocks.count))
    left = q.residual - q.design @ fit
    return np.asarray(float(q.blocks.rows.sum()) / autocorrelation_time(left, q.block))
