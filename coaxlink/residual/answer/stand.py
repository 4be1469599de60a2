"""Stand logs against a given model or one fitted to them: what is chosen, judged again, and said."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from coaxlink.data.samples import Samples
from coaxlink.effects import stand_effects
from coaxlink.effects.further_forms import in_all_forms
from coaxlink.frames import Array
from coaxlink.residual.answer.assemble import Judged, answer
from coaxlink.residual.answer.discrepancy_model import (
    OF_SPEED,
    floor_beside,
    log_error,
    with_discrepancy_model,
)
from coaxlink.residual.answer.doubts import with_rivals
from coaxlink.residual.channels.stand import ANY, LEAST_ROWS, ORDERS, Orders, joined, stand_frame
from coaxlink.residual.channels.stand_problem import known_parts, reducing, stand_problem, stand_variables
from coaxlink.residual.checks.posterior_check import undone
from coaxlink.residual.checks.residual_check import minor
from coaxlink.residual.checks.rivals import APART, nats_ahead
from coaxlink.residual.faults.stand_faults import find_suspects
from coaxlink.residual.faults.tachometer_gain import wrong_gain
from coaxlink.residual.regression.irls import channel_errors
from coaxlink.residual.regression.joint_model import SHORT, Joint, Member, Part, composed, of_grid
from coaxlink.residual.regression.problem import Option, Problem
from coaxlink.residual.result import Refinement
from coaxlink.residual.search.form_error import within_forms
from coaxlink.residual.search.joint_fit import fit_jointly, fitter_of
from coaxlink.residual.search.select import LITTLE, Selection, select
from coaxlink.residual.search.time_trend import explained_by_time
from coaxlink.residual.search.trial import Judge
from coaxlink.rotor import RotorModel

Progress = Callable[[str], None]
ROUNDS = 3  # of judging again
TRIED = 3  # effects that are moved to their best shape where none passes in a shape of the grid
PLAINER = 0.005  # a plain nuisance model that errs by no more than this share above a rich one is kept
MANY_ROWS, STRETCH = 20_000, 64  # of a stand log: a longer one is judged on every so many stretches
PLAIN, BENT = (2,), (3,)


class Try(NamedTuple):
    """A nuisance model fitted to the log itself, and what may be named beside it."""

    orders: Orders = ANY
    shed: str = ""  # whose share is taken off first: "all" effects, or the "steady" ones, all but a drift
    excess: float = 0.0  # times the noise, that some load must be left with, for such a try
    law: bool = False  # of the speeds: it is asked about, and the try counts only with it


TRIES = (
    Try(),
    Try((PLAIN, PLAIN)),
    Try((PLAIN, ORDERS), law=True),
    Try(shed="all", excess=1.05),
    Try(shed="all", excess=1.25),
    Try(shed="steady", excess=1.05),
)


def judge_stand(
    several: Sequence[Samples],
    model: RotorModel | None,
    progress: Progress,
) -> Refinement:
    """What these stand logs say of the given model, or of one fitted to them.

    Raises InputError when speeds or loads are missing.
    """
    progress("reading the stand")
    samples = joined(several)
    first = stand_frame(samples, model)
    wrong = find_suspects(first)
    suspects, mislabelled = wrong.suspects, wrong.mislabelled
    if not mislabelled:
        samples = samples.without(*wrong.columns)
    read = np.all(np.isfinite(first.measured) & np.isfinite(first.predicted), axis=1)
    trusted = np.flatnonzero(read & ~wrong.bad)
    if mislabelled and len(trusted) < LEAST_ROWS:  # nothing is claimed of them; what they leave is shown
        trusted = np.flatnonzero(read)
    thinned = max(1, round(len(trusted) / MANY_ROWS))
    if thinned > 1:  # stretches whole: neighbours tell the noise, and what lags or remembers sees every row
        trusted = trusted[(trusted // STRETCH) % thinned == 0]
    best: tuple[float, Judged] | None = None
    shed: dict[str, Array] = {}  # what effects make of the loads: all of them, and all but a drift
    tried: list[tuple[str, bool, dict[str, set[str]]]] = []
    # a nuisance of high order may swallow an effect that a plain one leaves to be named; and how rich a
    # nuisance must be is seen better once the effects are known
    for orders, again, excess, law in TRIES[:1] if model is not None else TRIES:
        if again and (again not in shed or best is None or not _far_off(best[1], excess)):
            continue
        progress("fitting candidates")
        bare = stand_frame(samples, model, orders, shed.get(again), trusted)
        any_name = law or model is not None or (best is not None and _of_speed(best[1].joint.members))
        nuisance = again, any_name, {load: set(named) for load, named in bare.model.terms().items()}
        if nuisance in tried:
            continue
        tried.append(nuisance)
        known, notes = known_parts(bare)
        if thinned > 1:
            notes.append(f"a long log: one stretch of {STRETCH} rows in {thinned} is judged")
        problem = stand_problem(composed(bare, known))
        if law and not _asks_for_a_law(problem):
            continue
        barred = () if any_name else OF_SPEED
        progress("selecting")
        few = len(trusted) < LEAST_ROWS
        if few:
            notes.append(f"{len(trusted)} rows: held against the model; too few to identify any effect")
        gain = None if mislabelled or few else wrong_gain(problem)
        if gain is not None:
            suspects, mislabelled = (*suspects, gain), True
        reduce = reducing(bare)
        selection = Selection() if mislabelled or few else select(problem, barred=barred)
        if not (law or mislabelled or few or selection.members or selection.doubtful):
            selection = _tried(problem, selection, bare, known, reduce, barred)
        selection, start, fitted = _again(problem, selection, bare, known, reduce, barred)
        joint, acting = fitted or fit_jointly(problem, selection, bare, known, reduce, start)
        for _round in range(ROUNDS):  # what goes may have kept another from being seen for what it is
            gone, why, anew = _needless(joint, acting, bare, reduce)
            if not gone:
                break
            selection = undone(selection, gone, why)
            if anew:
                selection, start, _ = _again(problem, selection, bare, known, reduce, {*gone, *barred})
            joint, acting = fit_jointly(problem, selection, bare, known, reduce, start)
        if law and not _of_speed(joint.members):
            continue
        if law:
            bent = stand_frame(samples, model, (BENT, ORDERS), shed.get(again), trusted)
            if not _sets_in(joint, selection, bent, reducing(bent)):
                continue
        error = log_error(joint)
        if best is None or error <= best[0] + PLAINER:
            shed = {"all": acting.predicted - problem.frame.predicted} if selection.members else {}
            steady = [(m.effect, m.parameters(bare)) for m in joint.members if m.name != "sensor_drift"]
            if (
                0 < len(steady) < len(joint.members)
            ):  # the drift may be confounded with what the nuisance model lacks
                shed["steady"] = composed(bare, [*known, *steady]).predicted - problem.frame.predicted
            floor = floor_beside(bare, joint)
            parts = (tuple(known), suspects, tuple(notes), not mislabelled)
            best = error, Judged(problem, selection, joint, floor, stand_variables(bare), *parts)
    assert best is not None
    progress("judging")
    judged = best[1]
    if (
        judged.problem.frame.free_nuisance
        and judged.labelled
        and len(judged.problem.frame.keep) >= LEAST_ROWS
    ):
        judged = with_discrepancy_model(judged)
    judged = _against_rivals(judged)
    return answer(judged, several)


def _tried(
    problem: Problem,
    selection: Selection,
    bare: Any,
    known: Sequence[Part],
    reduce: Callable[[Array], Array],
    barred: Collection[str],
) -> Selection:
    """Where nothing passes every gate in a shape of the grid: what does in its best, alone or with another.

    What a wrong shape leaves, and what a second effect does, hangs together in time as noise does not:
    neither of two large effects is beyond chance while the other is not there.
    """
    every = Judge(problem).best_of_each([])
    promising = [t.option for t in every if t.gain > LITTLE and t.option.name not in barred]
    sets = [[o] for o in promising[:TRIED]] + [list(pair) for pair in combinations(promising[:TRIED], 2)]
    for options in sets:
        joint, _ = fit_jointly(problem, Selection(members=options), bare, known, reduce)
        if joint.problem.frame is not bare or len(joint.members) != len(options):
            continue
        about = fitter_of(problem, bare, known, {o.name for o in options}, reduce).beside(joint)
        judge, mine = Judge(about), about.options[: len(options)]
        if all(judge.trial([x for x in mine if x is not o], o).why_not is None for o in mine):
            return replace(selection, members=options)
    return selection


def _against_rivals(j: Judged) -> Judged:
    """With doubts for the claims that another effect, in any of its forms, equals."""
    frame, names = j.problem.frame, {m.name for m in j.joint.members}
    known = [part for part in j.known if part[0].name not in names]
    if not j.selection.members:
        return j
    # of a long log the plain forms: the others' columns are many
    long = j.problem.residual.size > SHORT
    every = [effect if long else in_all_forms(frame, effect) for effect in stand_effects()]
    problem = stand_problem(composed(frame, known), every)

    def fitted(options: Sequence[Option], settled: Mapping[str, Member]) -> Joint:
        chosen = Selection(members=list(options))
        return fit_jointly(problem, chosen, frame, known, reducing(frame), settled)[0]

    def beside(joint: Joint) -> Problem:
        there = {m.name for m in joint.members}
        return fitter_of(problem, frame, known, there, reducing(frame)).beside(joint)

    judged = with_rivals(j, problem, fitted, floor=lambda joint: floor_beside(frame, joint), beside=beside)
    return judged if {m.name for m in judged.joint.members} <= names else _still_there(judged, fitted)


def _still_there(j: Judged, fitted: Callable[[Sequence[Option], Mapping[str, Member]], Joint]) -> Judged:
    """The judgement without what took another's place and does not stand there itself."""
    frame = j.problem.frame
    acting = composed(frame, [(m.effect, m.parameters(frame)) for m in j.joint.members])
    judge, options = Judge(j.joint.problem), list(j.joint.problem.options)
    refused = {
        o.name for o in options if judge.trial([x for x in options if x is not o], o).why_not is not None
    }
    gone = refused or explained_by_time(j.joint, acting, reducing(frame)) or minor(j.joint, j.floor)
    if not gone:
        return j
    selection = undone(j.selection, gone, "took another's place, and does not stand there")
    settled = {m.name: m for m in j.joint.members}
    joint = fitted([*selection.members, *selection.doubtful], settled)
    return replace(j, selection=selection, joint=joint, floor=floor_beside(frame, joint))


def _needless(
    joint: Joint, acting: Any, bare: Any, reduce: Callable[[Array], Array]
) -> tuple[set[str], str, bool]:
    """Names that go, why, and whether what made them may show when the choice is made without them."""
    gone = explained_by_time(joint, acting, reduce)
    if gone:
        return gone, "needless beside something that changes over time and was not logged", False
    gone = within_forms(joint, bare)
    if gone:
        return gone, "no more than the form of a larger one misses", False
    return minor(joint, floor_beside(bare, joint)), "leaves most of what is there, or does harm", True


def _asks_for_a_law(problem: Problem) -> bool:
    """Whether a law of the speeds explains anything at all here by itself."""
    return any(t.gain > LITTLE for t in Judge(problem).best_of_each([]) if t.option.name in OF_SPEED)


def _sets_in(joint: Joint, selection: Selection, bent: Any, reduce: Callable[[Array], Array]) -> bool:
    """Whether a law of the speeds is ahead of a map that bends over all of them, as pairs without one do."""
    known, _ = known_parts(bent)
    problem = stand_problem(composed(bent, known))
    there = {o.name for o in problem.options} - OF_SPEED
    others = of_grid(problem, [m for m in selection.members if m.name in there])
    return nats_ahead(joint, fit_jointly(problem, Selection(members=others), bent, known, reduce)[0]) > APART


def _of_speed(members: Sequence[Member]) -> bool:
    """Whether one of these effects is a law of the speeds."""
    return any(m.name in OF_SPEED for m in members)


def _far_off(j: Judged, bar: float) -> bool:
    """Whether a load is left with more than so many times its noise."""
    q = j.joint.problem
    return bool(np.max(channel_errors(q, q.options) / np.maximum(j.floor, 1e-12)) > bar)


def _again(
    problem: Problem,
    selection: Selection,
    bare: Any,
    known: Sequence[Part],
    reduce: Callable[[Array], Array],
    barred: Collection[str] = (),
) -> tuple[Selection, dict[str, Member], tuple[Joint, Any] | None]:
    """The selection judged again about its own joint fit, until it stands; its members there; that fit.

    A first choice is made in shapes of a grid. Once these have found their best form, some are needless (they
    had was confounded with a misfit of another's form), and what the misfit hid may show. No fit comes back
    where another from there may still find a better form.
    """
    settled: dict[str, Member] = {}
    barred = {*barred}
    rounds = ROUNDS if problem.residual.size < SHORT else 1
    for number in range(1, rounds + 1):
        if not selection.members:
            break
        claimed = Selection(members=selection.members)
        began = {
            o.name: set(settled[o.name].shape if o.name in settled else o.shape) for o in claimed.members
        }
        joint, acting = fit_jointly(problem, claimed, bare, known, reduce, settled)
        if len(joint.members) != len(selection.members) or joint.problem.frame is not bare:
            break  # the plain sum was better
        fitter = fitter_of(problem, bare, known, {m.name for m in joint.members}, reduce)
        about = fitter.beside(joint)
        had = {m.name for m in joint.members}
        again = select(about, about.options[: len(had)], barred=barred, on_trial=number < rounds)
        same = {m.name for m in again.members} == had
        barred |= had - {m.name for m in again.members}
        settled = {m.name: m for m in joint.members}
        selection = replace(again, trace=[*selection.trace, *again.trace])
        if same:
            # from a better form there may be a better one still
            stands = not again.doubtful and all(set(m.shape) == began[m.name] for m in joint.members)
            return selection, settled, (joint, acting) if stands else None
    return selection, settled, None
