"""Which effects the residual demands: forward steps, each judged on held-out blocks, then doubts removed.

An effect is added only if (1) the held-out error falls, (2) the fall is far outside what coloured noise gives
(a chi-square test whose variance carries the residual's own autocorrelation, corrected for all looks),
(3) what it adds beyond anything the nuisance corrections can absorb is large enough to matter, and (4) its
parameters are physical. After every addition each member may be dropped or swapped for a better one.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.special import logit
from scipy.stats import norm

from coaxlink.residual.regression.problem import Option, Problem
from coaxlink.residual.result import Ambiguous, Step, probabilities
from coaxlink.residual.search.trial import Judge, Trial

MOST = 4
TIE = 0.04  # of the gain: a special case this close to the general one is preferred
LITTLE = 15.0  # of a log-likelihood ratio: less than this decides nothing
# where even the best leaves more than noise, its form is not exact and a likelihood says less: then a rival
# counts as an equal if it reaches most of the gain and does not lose steadily over the blocks
INEXACT = 1.25
RIVAL = 0.9
STEADY = 1.5
NESTED = {("rotor_drag", "wind"), ("mass_change", "battery_voltage")}  # (special case, general case)
WITHIN = {"wind": "rotor_drag"}  # the wind's drag is the rotors': beside it theirs would be counted twice


@dataclass
class Selection:
    """What was chosen and how it went."""

    members: list[Option] = field(default_factory=list)
    trace: list[Step] = field(default_factory=list)
    last: dict[str, Trial] = field(default_factory=dict)  # best failed trial of every effect, by name
    ambiguous: list[Ambiguous] = field(default_factory=list)
    doubtful: list[Option] = field(default_factory=list)  # members that a rival equals: not claimed
    problem: Problem | None = None  # whose options all these are

    @property
    def small(self) -> Trial | None:
        """What the data demand most of all that was left out for its size alone."""
        return max((t for t in self.last.values() if t.only_small), key=lambda t: t.gain, default=None)


def select(problem: Problem) -> Selection:
    """Choose effects for a problem; see the module's text."""
    judge, out = Judge(problem), Selection(problem=problem)
    for number in range(1, MOST + 1):
        if len(out.members) >= MOST:
            break
        out_of_play = {WITHIN.get(m.name, "") for m in out.members}
        trials = [t for t in judge.best_of_each(out.members) if t.option.name not in out_of_play]
        good = _eligible(trials)
        winner = _simplest(good) if good else None
        for t in trials:
            kept = winner is not None and t is winner
            why = "best on held-out blocks" if kept else (t.why_not or "another explains more")
            out.trace.append(Step(number, "add", t.option.name, t.gain, t.p_value, t.size, kept, why))
        out.last = {t.option.name: t for t in trials}
        if winner is None:
            break
        _note_tie(judge, out, winner, good)
        out.members.append(winner.option)
        _reconsider(judge, out, number)
    out.last = {t.option.name: t for t in judge.best_of_each(out.members)}
    doubtful = {name for a in out.ambiguous for name in a.names}
    out.doubtful = [m for m in out.members if m.name in doubtful]
    out.members = [m for m in out.members if m.name not in doubtful]
    return out


def _eligible(trials: list[Trial]) -> list[Trial]:
    """Those that pass every gate; none if the best real one is too small, for no worse one may stand in."""
    real = [t for t in trials if t.real]
    if not real or real[0].why_not is not None:
        return []
    return [t for t in real if t.why_not is None]


def _simplest(good: list[Trial]) -> Trial:
    """The best, unless a special case of it does as well within the tie margin."""
    best = good[0]
    for other in good[1:]:
        if _special_case(other, best) and other.gain >= (1.0 - TIE) * best.gain:
            return other
    return best


def _special_case(a: Trial, b: Trial) -> bool:
    """Whether b explains in general what a does; what comes gradually has numbers more, and is no such."""
    return (a.option.name, b.option.name) in NESTED and "over_s" not in a.option.shape


def _note_tie(judge: Judge, out: Selection, winner: Trial, good: list[Trial]) -> None:
    """Rivals that explain as much on the same blocks, and nothing more once the winner is in."""
    best = judge.sums([*out.members, winner.option])
    start = judge.sums(out.members)
    behind: dict[str, float] = {}  # nats
    for t in good:
        if t is winner or _special_case(t, winner) or _special_case(winner, t):
            continue
        other = judge.sums([*out.members, t.option])
        lead = other - best  # (B,) by block
        rows = judge.problem.residual.size
        likelihood = float(lead.sum()) * rows / max(float(best.sum()), 1e-12)
        spread = float(np.sqrt(np.sum((lead - lead.mean()) ** 2))) or 1e-12
        steady = float(lead.sum()) / spread > STEADY
        reached = float((start - other).sum()) >= RIVAL * float((start - best).sum())
        exact = float(best.sum()) / rows < INEXACT
        if likelihood > LITTLE and (exact or steady or not reached):
            continue
        if judge.trial([*out.members, winner.option], t.option).why_not is not None:
            # no further ahead than the blocks agree on
            agreed = float(logit(norm.cdf(lead.sum() / spread)))
            behind[t.option.name] = min(0.5 * likelihood, agreed)
    if behind:
        shares = probabilities([0.0, *behind.values()])
        out.ambiguous.append(Ambiguous((winner.option.name, *behind), "", probability=shares))


def _reconsider(judge: Judge, out: Selection, number: int) -> None:
    """Swap members for better ones, then drop what the others made needless."""
    if len(out.members) < 2:
        return
    for i in range(len(out.members)):
        rest = [m for k, m in enumerate(out.members) if k != i]
        now = float(judge.sums(out.members).sum())
        trials = _eligible(judge.best_of_each(rest))
        if not trials:
            continue
        best = _simplest(trials)
        name = out.members[i].name
        # another shape of the same effect needs no more than to be better
        least = LITTLE if best.option.name == name else max(LITTLE, TIE * best.gain)
        if best.option is not out.members[i] and best.total < now - least:
            out.trace.append(
                Step(
                    number,
                    "swap",
                    f"{name} -> {best.option.name}",
                    best.gain,
                    best.p_value,
                    best.size,
                    True,
                    "explains more beside the others",
                )
            )
            out.members = [*rest, best.option]
    _drop_needless(judge, out, number)


def _drop_needless(judge: Judge, out: Selection, number: int) -> None:
    for member in list(out.members):
        rest = [m for m in out.members if m is not member]
        if not rest:
            break
        again = judge.trial(rest, member)
        if again.why_not is not None:
            out.members = rest
            out.trace.append(
                Step(number, "drop", member.name, again.gain, again.p_value, again.size, True, again.why_not)
            )
