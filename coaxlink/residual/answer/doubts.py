"""Claims against their rivals: what another effect equals is a doubt."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from coaxlink.residual.answer.assemble import Judged, separable
from coaxlink.residual.checks.rivals import Fitted, Rivalry, rivalries
from coaxlink.residual.regression.problem import Problem
from coaxlink.residual.result import Ambiguous, Step, probabilities
from coaxlink.residual.search.select import Selection


def with_rivals(j: Judged, problem: Problem, fitted: Fitted, derived: Collection[str] = ()) -> Judged:
    """The judgement with claims that a rival equals withheld; `problem` has all effects in all their forms.

    Names in `derived` have another reason than a smaller error.
    """
    if not j.selection.members or j.selection.doubtful:
        return j
    return _doubted(j, problem, rivalries(problem, j.joint, fitted, derived), derived)


def _doubted(j: Judged, problem: Problem, found: list[Rivalry], derived: Collection[str]) -> Judged:
    """The judgement without claims that another effect equals: these are doubts."""
    doubts, trace = list(j.doubts), []
    asked = {r.option.name for r in found} | {m.name for m in j.selection.members}
    ahead = {name: tuple(r.nats for r in found if r.option.name == name) for name in asked - {*derived}}
    equals: dict[str, list[Rivalry]] = {}
    for r in found:
        t = r.rival
        why = f"{r.nats:.1f} nats behind {r.option.name}"
        why += " and it in their forms here" if r.form else " in its place"
        trace.append(Step(9, "rival", t.option.name, t.gain, t.p_value, t.size, False, why))
        if r.equal:
            equals.setdefault(r.option.name, []).append(r)
    for name, mine in equals.items():
        last = {r.rival.option.name: r.rival for r in mine}
        here = Selection(members=list(mine[0].rest), doubtful=[mine[0].option], last=last)
        behind = {r.rival.option.name: r.nats for r in mine}
        doubt = Ambiguous((name, *behind), "", probability=probabilities([0.0, *behind.values()]))
        doubts.append(separable(problem, here, doubt, j.variables))
    members = [m for m in j.selection.members if m.name not in equals]
    doubtful = [m for m in j.selection.members if m.name in equals]
    selection = replace(j.selection, members=members, doubtful=doubtful, trace=[*j.selection.trace, *trace])
    return replace(j, selection=selection, doubts=tuple(doubts), ahead=ahead)
