"""Measured data against a model: find the residual, trace it to effects, report before and after."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.data.samples import Samples
from coaxlink.residual.answer import Judged, answer, held_out_residual
from coaxlink.residual.blocks import held_out, solve
from coaxlink.residual.courses import outrun
from coaxlink.residual.effects.base import Shape
from coaxlink.residual.felt_noise import felt_noise
from coaxlink.residual.flight import flight_frame, reduce_columns
from coaxlink.residual.flight_problem import (
    base_columns,
    corrected,
    flight_floor,
    flight_problem,
    flight_variables,
)
from coaxlink.residual.flight_problem import known_parts as known_in_flight
from coaxlink.residual.flight_suspects import flight_suspects
from coaxlink.residual.frames import Array, FlightFrame, StandFrame
from coaxlink.residual.joint import (
    SHORT,
    Fitter,
    Joint,
    Member,
    Part,
    composed,
    fit,
    member,
    needed,
    straight,
)
from coaxlink.residual.mass_or_thrust import Scales, doubt, scales
from coaxlink.residual.problem import Option, Problem
from coaxlink.residual.result import Ambiguous, Refinement, Step
from coaxlink.residual.reweigh import channel_errors, reweighed, settled_base, weighed_again
from coaxlink.residual.select import Selection, columns_of, select
from coaxlink.residual.speed_gain import wrong_gain
from coaxlink.residual.stand import LEAST_ROWS as LEAST_STAND_ROWS
from coaxlink.residual.stand import joined, stand_frame
from coaxlink.residual.stand_problem import known_parts as known_on_stand
from coaxlink.residual.stand_problem import stand_floor, stand_problem, stand_variables
from coaxlink.residual.sudden import with_onsets
from coaxlink.residual.suspects import find_suspects
from coaxlink.rotor import RotorModel

Progress = Callable[[str], None]
ROUNDS = 3  # of judging again
LEAST_ROWS = 80  # judged rows of a flight
PLAINER = 0.005  # a plain base that errs by no more than this share above a rich one is kept
MANY_ROWS, STRETCH = 20_000, 64  # of a stand log: a longer one is judged on every so many stretches
LONG, LONG_STAND = 200_000, 100_000  # judged rows times channels: beyond, other forms are not tried
FAR_OFF = 1.15  # of the noise: a fitted base is looked at again
BY_TORQUES = "the lift is off, roll and pitch torque are not"
DOUBTED = 1.5  # of the floor: a flight's choice that leaves more in a channel is judged once more
CLEARLY = 0.1  # of the logarithm of errors, channels together, that another choice must leave less
WORSE = 1.02  # of the held-out squares: a joint fit that is worse than the plain sum has gone astray


def refine(
    logs: Samples | Sequence[Samples],
    airframe: Airframe,
    model: RotorModel,
    *,
    progress: Progress = lambda _: None,
) -> Refinement:
    """Hold flight logs against a rotor model on its airframe.

    `model` may carry effects already: they are part of the prediction, and are fitted again where the log
    demands other numbers. `progress` is told each stage.
    Raises InputError when a log lacks what every flight needs.
    """
    several = [logs] if isinstance(logs, Samples) else list(logs)
    progress("aligning")
    bare = flight_frame(several, airframe, model)
    suspects, bad, mislabelled = flight_suspects(bare, several)
    if bad.any() and np.sum(~bad[bare.keep]) > LEAST_ROWS:
        bare = replace(bare, keep=bare.keep[~bad[bare.keep]])
    known, notes = known_in_flight(bare)
    frame = composed(bare, known)
    progress("fitting candidates")
    problem = with_onsets(flight_problem(frame), [], lambda c: reduce_columns(frame, c))
    progress("selecting")
    selection = Selection() if mislabelled else select(problem)
    further = with_onsets(problem, selection.members, lambda c: reduce_columns(frame, c))
    if selection.members and further is not problem:
        problem, selection = further, select(further)
    progress("fitting what was chosen together")

    def reduce(columns: Array) -> Array:
        return reduce_columns(frame, columns)

    joint, acting = _together(problem, selection, bare, known, reduce, base=base_columns)
    selection, joint, acting = _doubted(problem, selection, joint, acting, bare, known, reduce)
    doubts: tuple[Ambiguous, ...] = ()
    carried = bool({effect.name for effect, _ in known} & {"mass_change", "battery_voltage"})
    if not mislabelled and not {m.name for m in joint.members} & {"mass_change", "battery_voltage"}:
        seen = _scales(joint, acting, frame)
        mass = next((o for o in problem.options if o.name == "mass_change" and not o.shape), None)
        if seen.verdict == "mass" and mass is not None and not carried:
            selection.trace.append(Step(9, "add", mass.name, 0.0, 0.0, abs(seen.lift), True, BY_TORQUES))
            selection = replace(selection, members=[*selection.members, mass])
            joint, acting = _together(
                problem,
                selection,
                bare,
                known,
                lambda c: reduce_columns(frame, c),
                base=base_columns,
                all_of=True,
            )
        elif not carried:
            doubts = tuple(doubt(frame, seen))
    progress("judging")
    members = {m.name for m in joint.members}
    act = [part for part in known if part[0].name not in members]
    act += [(m.effect, m.parameters(bare)) for m in joint.members]
    floor = np.hypot(_flight_floor(acting, joint), felt_noise(bare, act))
    if airframe.motor_lag_s == 0.0:
        notes.append("motor_lag_s is not declared: a real lag of the motors will be found as rotor_lag")
    variables = flight_variables(frame)
    parts = (tuple(known), tuple(suspects), tuple(notes), not mislabelled, doubts)
    return answer(Judged(settled_base(problem), selection, joint, floor, variables, *parts), several)


def _doubted(
    problem: Problem,
    selection: Selection,
    joint: Joint,
    acting: FlightFrame,
    bare: FlightFrame,
    known: Sequence[Part],
    reduce: Callable[[Array], Array],
) -> tuple[Selection, Joint, FlightFrame]:
    """The choice judged once more, torques counting in full, where a channel is left far above its noise.

    Another one (a mass and a centre for a failing rotor) is taken only if it leaves little but noise.
    """
    q, kept = joint.problem, (selection, joint, acting)
    if not joint.members or selection.doubtful or problem.residual.size > SHORT or q.frame is not bare:
        return kept
    errors, floor = channel_errors(q, q.options), _flight_floor(acting, joint)
    if np.max(errors / floor) < DOUBTED:
        return kept
    again = select(reweighed(problem, floor))
    if (
        again.ambiguous
        or not again.members
        or {m.name for m in again.members} == {m.name for m in joint.members}
    ):
        return kept
    again.trace = [*selection.trace, *again.trace]
    other, then = _together(problem, again, bare, known, reduce, base=base_columns)
    now = channel_errors(other.problem, other.problem.options)
    less, left = float(np.sum(np.log(errors / now))), now / _flight_floor(then, other)
    return (again, other, then) if less > CLEARLY and np.max(left) < DOUBTED else kept


def _scales(joint: Joint, acting: FlightFrame, frame: FlightFrame) -> Scales:
    q = joint.problem  # everything found acts in `acting`
    final = solve(q.blocks, columns_of(q, list(q.options)), np.ones(q.blocks.count))
    named = dict(zip(q.base_names, final[q.base], strict=True))
    return scales(acting, named, q.block, lambda c: reduce_columns(frame, c))


def _flight_floor(frame: FlightFrame, joint: Joint) -> Array:
    """(6,) noise floor behind everything that was found, all of it acting in the frame."""
    q = joint.problem
    final = solve(q.blocks, columns_of(q, list(q.options)), np.ones(q.blocks.count))
    left = frame.measured - frame.predicted - corrected(frame, final[q.base], q.base_names)
    lags = [m.shape["lag_s"] for m in joint.members if m.name == "rotor_lag"]
    return flight_floor(frame, left, reduce_columns(frame, left), *lags)


def refine_stand(
    logs: Samples | Sequence[Samples],
    model: RotorModel | None = None,
    *,
    progress: Progress = lambda _: None,
) -> Refinement:
    """Hold stand logs against a rotor model, or without one against the coaxial model fitted to themselves.

    Raises InputError when speeds or loads are missing.
    """
    several = [logs] if isinstance(logs, Samples) else list(logs)
    progress("reading the stand")
    samples = joined(several)
    wrong = find_suspects(stand_frame(samples, model))
    suspects, mislabelled = wrong.suspects, wrong.mislabelled
    if not mislabelled:
        samples = samples.without(*wrong.columns)
    trusted = np.flatnonzero(np.logical_not(wrong.bad))
    thinned = max(1, round(len(trusted) / MANY_ROWS))
    if thinned > 1:  # stretches whole: neighbours tell the noise, and what lags or remembers sees every row
        trusted = trusted[(trusted // STRETCH) % thinned == 0]
    best: tuple[float, Judged] | None = None
    shed: Array | None = None
    # a base of high order may swallow an effect that a plain one leaves to be named; and how rich a base must
    # be is seen better once the effects are known
    for order, again in ((None, False),) if model is not None else ((None, False), (2, False), (None, True)):
        if again and (shed is None or best is None or not _far_off(best[1])):
            break
        progress("fitting candidates")
        bare = stand_frame(samples, model, order, shed if again else None, trusted)
        if best is not None and bare.model.terms() == best[1].problem.frame.model.terms():
            continue
        known, notes = known_on_stand(bare)
        if thinned > 1:
            notes.append(f"a long log: one stretch of {STRETCH} rows in {thinned} is judged")
        problem = stand_problem(composed(bare, known))
        progress("selecting")
        few = len(trusted) < LEAST_STAND_ROWS
        if few:
            notes.append(f"{len(trusted)} rows: held against the model; too few to identify any effect")
        gain = None if mislabelled or few else wrong_gain(problem)
        if gain is not None:
            suspects, mislabelled = (*suspects, gain), True
        selection = Selection() if mislabelled or few else select(problem)
        reduce = _present(bare)
        selection, start = _again(problem, selection, bare, known, reduce)
        joint, acting = _together(problem, selection, bare, known, reduce, start)
        if outrun_names := outrun(joint, acting, reduce):
            selection = _without(selection, outrun_names)
            joint, acting = _together(problem, selection, bare, known, reduce, start)
        error = _log_error(joint.problem)
        if best is None or error <= best[0] + PLAINER:
            shed = acting.predicted - problem.frame.predicted if selection.members else None
            floor = _stand_floor(bare, joint)
            parts = (tuple(known), suspects, tuple(notes), not mislabelled)
            best = error, Judged(problem, selection, joint, floor, stand_variables(bare), *parts)
    assert best is not None
    progress("judging")
    return answer(best[1], several)


def _without(selection: Selection, names: set[str]) -> Selection:
    """The selection less what a free course over time does as well."""
    why = "needless beside something that changes over time and was not logged"
    steps = [Step(9, "drop", name, 0.0, 1.0, 0.0, True, why) for name in sorted(names)]
    kept = [m for m in selection.members if m.name not in names]
    doubtful = [m for m in selection.doubtful if m.name not in names]
    doubts = [a for a in selection.ambiguous if not names & set(a.names)]
    trace = [*selection.trace, *steps]
    return replace(selection, members=kept, doubtful=doubtful, ambiguous=doubts, trace=trace)


def _far_off(j: Judged) -> bool:
    """Whether a load is left with clearly more than its noise."""
    q = j.joint.problem
    squares = held_out(q.blocks, columns_of(q, list(q.options)))[0].sum(axis=0)
    over = np.sqrt(squares / q.blocks.rows.sum()) * q.sigma / np.maximum(j.floor, 1e-12)
    return bool(np.max(over) > FAR_OFF)


def _present(frame: StandFrame) -> Callable[[Array], Array]:
    keep, present = frame.keep, list(frame.present)
    return lambda columns: np.asarray(columns[keep][:, present])


def _stand_floor(frame: StandFrame, joint: Joint) -> Array:
    q = joint.problem
    fits = held_out(q.blocks, columns_of(q, list(q.options)))[1]
    return stand_floor(frame, held_out_residual(q, fits))


def _log_error(p: Problem) -> float:
    """Mean over channels of the logarithm of the held-out error, in the channels' units."""
    squares = held_out(p.blocks, columns_of(p, list(p.options)))[0].sum(axis=0)
    return float(np.mean(np.log(np.maximum(np.sqrt(squares / p.blocks.rows.sum()) * p.sigma, 1e-12))))


def _again(
    problem: Problem,
    selection: Selection,
    bare: Any,
    known: Sequence[Part],
    reduce: Callable[[Array], Array],
) -> tuple[Selection, dict[str, Member]]:
    """The selection judged again about its own joint fit, until it stands; and its members there.

    A first choice is made in shapes of a grid. Once these have found their best form, some are needless (they
    had stood in for a misfit of another's form), and what the misfit hid may show.
    """
    settled: dict[str, Member] = {}
    barred: set[str] = set()
    rounds = ROUNDS if problem.residual.size < SHORT else 1
    for number in range(1, rounds + 1):
        if not selection.members:
            break
        claimed = Selection(members=selection.members)
        joint, _ = _together(problem, claimed, bare, known, reduce, settled)
        if len(joint.members) != len(selection.members) or joint.problem.frame is not bare:
            break  # the plain sum was better
        fitter = _fitter(problem, bare, known, {m.name for m in joint.members}, reduce)
        about = fitter.beside(joint)
        had = {m.name for m in joint.members}
        again = select(about, about.options[: len(had)], barred=barred, on_trial=number < rounds)
        same = {m.name for m in again.members} == had
        barred |= had - {m.name for m in again.members}
        settled = {m.name: m for m in joint.members}
        selection = replace(again, trace=[*selection.trace, *again.trace])
        if same:
            break
    return selection, settled


def _fitter(
    problem: Problem, bare: Any, known: Sequence[Part], names: set[str], reduce: Callable[[Array], Array]
) -> Fitter:
    return Fitter(problem, bare, [part for part in known if part[0].name not in names], reduce)


def _together(
    problem: Problem,
    selection: Selection,
    bare: Any,
    known: Sequence[Part],
    reduce: Callable[[Array], Array],
    settled: Mapping[str, Member] | None = None,
    *,
    base: Callable[[Any, Callable[[Array], Array]], Array] | None = None,
    all_of: bool = False,
) -> tuple[Joint, Any]:
    """Members and doubtful ones fitted together, and the frame with them acting.

    `settled` are members as an earlier fit left them: they start from there. `base(frame, reduce)` gives the
    base corrections of a frame, (rows, C, B): with effects in it they are others than without. `all_of`: none
    is dropped for being needless.
    """
    options = [*selection.members, *selection.doubtful]
    names = {o.name for o in options}
    # an effect that the model has and the log gives other numbers for starts from those it has
    had = {effect.name: parameters for effect, parameters in known}
    fitter = _fitter(problem, bare, known, names, reduce)
    plain = straight(problem, _of_grid(problem, options))
    if not options:
        if base is not None:
            plain = straight(settled_base(problem), [])
        return plain, fitter.acting([])
    start: list[Member] = []
    exact: Joint | None = None
    for o, m in zip(options, plain.members, strict=True):
        if settled and o.name in settled:
            start.append(settled[o.name])
            continue
        at = o.effect.inverse(bare, had[o.name]) if o.name in had else (m.shape, m.coefficients)
        start.append(member(bare, o.effect, *at))
    try:
        long = LONG_STAND if problem.noise_known else LONG
        joint = fit(fitter, start, alternatives=problem.residual.size < long)
        if base is not None:
            if problem.residual.size < LONG and not (all_of or selection.doubtful or names & set(had)):
                joint = needed(fitter, joint)
                selection.trace += _dropped(selection.members, joint)
            columns = base(fitter.acting(joint.members), reduce) / problem.sigma[:, None]
            again, _ = Fitter(problem, bare, fitter.fixed, reduce, columns).settle(joint.members)
            joint = again if _squares(again.problem) < _squares(joint.problem) else joint
            exact = weighed_again(
                joint, problem, bare, fitter.fixed, reduce, base, alternatives=problem.residual.size < LONG
            )
    except np.linalg.LinAlgError:  # numbers that no column tells apart
        return plain, fitter.acting(plain.members)
    ratio = _squares(joint.problem) / max(_squares(plain.problem), 1e-12)
    refused = any(m.effect.refuse(m.parameters(bare)) for m in joint.members)
    if not names & set(had) and (not ratio < WORSE or refused):
        joint = plain
    elif exact is not None and not any(m.effect.refuse(m.parameters(bare)) for m in exact.members):
        joint = exact
    return joint, fitter.acting(joint.members)


def _dropped(chosen: Sequence[Option], joint: Joint) -> list[Step]:
    """A line of the trace for each that the joint fit does not need."""
    kept = {m.name for m in joint.members}
    why = "not needed when the others act together"
    return [Step(9, "drop", o.name, 0.0, 1.0, 0.0, True, why) for o in chosen if o.name not in kept]


def _of_grid(problem: Problem, options: Sequence[Option]) -> list[Option]:
    """The problem's own options nearest to these, which may be of another problem."""
    out = []
    for o in options:
        mine = [x for x in problem.options if x.name == o.name]
        out.append(min(mine, key=lambda x: _distance(x.shape, o.shape)))
    return out


def _distance(a: Shape, b: Shape) -> float:
    return sum(abs(a.get(k, 9.0) - b.get(k, 9.0)) for k in {*a, *b})


def _squares(p: Problem) -> float:
    return float(held_out(p.blocks, columns_of(p, list(p.options)))[0].sum())


__all__ = ["Ambiguous", "Refinement", "refine", "refine_stand"]
