"""Claims against their rivals: what another clearly beats gives way to it, what another equals is a doubt."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace

from coaxlink.frames import Array
from coaxlink.residual.answer.assemble import Judged, separable
from coaxlink.residual.checks.rivals import Beside, Fitted, Rivalry, rivalries
from coaxlink.residual.regression.joint_model import Joint
from coaxlink.residual.regression.problem import Problem
from coaxlink.residual.result import Ambiguous, Step, probabilities
from coaxlink.residual.search.select import Selection

SWAPS = 2


def with_rivals(
    j: Judged,
    problem: Problem,
    fitted: Fitted,
    *,
    floor: Callable[[Joint], Array] | None = None,
    beside: Beside | None = None,
    derived: Collection[str] = (),
) -> Judged:
    """The judgement with claims that a rival equals withheld; `problem` has all effects in all their forms.

    With `floor`, the noise behind a joint fit, and `beside` (see `rivals`), a claim that a rival beats by as
    much gives way to it first.
    Names in `derived` have another reason than a smaller error.
    """
    if not j.selection.members or j.selection.doubtful:
        return j
    found = rivalries(problem, j.joint, fitted, derived, beside=beside)
    for _ in range(SWAPS if floor else 0):
        lost = min((r for r in found if r.lost), key=lambda r: r.nats, default=None)
        if lost is None or floor is None:
            break
        j = _swapped(j, lost, fitted, floor)
        found = rivalries(problem, j.joint, fitted, derived, beside=beside)
    return _doubted(j, problem, found, derived)


def _swapped(j: Judged, r: Rivalry, fitted: Fitted, floor: Callable[[Joint], Array]) -> Judged:
    """The judgement with what is confounded with an effect in its place."""
    winner, settled = r.rival, {m.name: m for m in j.joint.members}
    members = [*r.rest, winner.option]
    joint = fitted(members, {o.name: settled[o.name] for o in r.rest})
    if r.form:
        action, name = "drop", r.option.name
        why = f"needless beside another form of {winner.option.name} ({r.nats:.1f} nats)"
    else:
        action, name = "swap", f"{r.option.name} -> {winner.option.name}"
        why = f"{-r.nats:.1f} nats ahead of it in its place"
    step = Step(9, action, name, winner.gain, winner.p_value, winner.size, True, why)
    selection = replace(j.selection, members=members, trace=[*j.selection.trace, step])
    return replace(j, selection=selection, joint=joint, floor=floor(joint))


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
