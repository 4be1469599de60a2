"""Measured data against a model: find the residual, trace it to effects, report before and after."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.data.samples import Samples
from coaxlink.residual.answer import Judged, answer, held_out_residual
from coaxlink.residual.blocks import held_out, solve
from coaxlink.residual.courses import outrun
from coaxlink.residual.drag_in_wind import drag_beside
from coaxlink.residual.felt_noise import felt_noise
from coaxlink.residual.flight import flight_frame, reduce_columns
from coaxlink.residual.flight_problem import (
    base_columns,
    flight_problem,
    flight_variables,
    floor_behind,
)
from coaxlink.residual.flight_problem import known_parts as known_in_flight
from coaxlink.residual.flight_suspects import flight_suspects
from coaxlink.residual.forms import within_forms
from coaxlink.residual.frames import Array, FlightFrame, StandFrame
from coaxlink.residual.joint import (
    SHORT,
    Joint,
    Member,
    Part,
    composed,
)
from coaxlink.residual.mass_or_thrust import Scales, behind_voltage, doubt, scales, whole_mass
from coaxlink.residual.problem import Problem
from coaxlink.residual.remainder import minor
from coaxlink.residual.result import Ambiguous, Refinement, Step
from coaxlink.residual.reweigh import channel_errors, reweighed, settled_base
from coaxlink.residual.scrutiny import Doubt, disbelieved, settled_lift, undone, without
from coaxlink.residual.select import Selection, columns_of, select
from coaxlink.residual.speed_gain import wrong_gain
from coaxlink.residual.stand import LEAST_ROWS as LEAST_STAND_ROWS
from coaxlink.residual.stand import joined, stand_frame
from coaxlink.residual.stand_problem import known_parts as known_on_stand
from coaxlink.residual.stand_problem import stand_floor, stand_problem, stand_variables
from coaxlink.residual.sudden import with_onsets
from coaxlink.residual.suspects import find_suspects
from coaxlink.residual.together import fitter_of, together
from coaxlink.rotor import RotorModel

Progress = Callable[[str], None]
ROUNDS = 3  # of judging again
LEAST_ROWS = 80  # judged rows of a flight
SCRUTINIES = 4  # of a flight's choice; of one longer than five minutes, one
PLAINER = 0.005  # a plain base that errs by no more than this share above a rich one is kept
MANY_ROWS, STRETCH = 20_000, 64  # of a stand log: a longer one is judged on every so many stretches
# order of a fitted base; whether what effects add is known; from what excess over the noise on
TRIES = ((None, "", 0.0), (2, "", 0.0), (None, "all", 1.05), (None, "all", 1.25), (None, "steady", 1.05))
DOUBTED = 1.5  # of the floor: a flight's choice that leaves more in a channel is judged once more
CLEARLY = 0.1  # of the logarithm of errors, channels together, that another choice must leave less


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

    def reduce(columns: Array) -> Array:
        return reduce_columns(frame, columns)

    progress("fitting candidates")
    problem = flight_problem(frame)
    struck: list[Doubt] = []
    for number in range(SCRUTINIES):
        progress("selecting")
        began = {d.name for d in struck if d.onset}
        problem = with_onsets(problem, [], reduce, barred=began)
        selection = Selection() if mislabelled else select(problem)
        # a beginning that another effect hid is looked for once more beside it
        further = with_onsets(problem, selection.members, reduce, barred=began)
        if selection.members and further is not problem:
            problem, selection = further, select(further)
        selection.trace[:0] = [Step(0, "drop", d.name, 0.0, 1.0, 0.0, True, d.why) for d in struck]
        progress("fitting what was chosen together")
        joint, acting = together(problem, selection, bare, known, reduce, base=base_columns)
        selection, joint, acting = _doubted(problem, selection, joint, acting, bare, known, reduce)
        again = disbelieved(problem, joint, floor_behind(acting, joint), {e.name for e, _ in known})
        if not again:
            break
        struck += again  # at most every effect once, and its beginning
        problem = without(problem, again)
        if number == SCRUTINIES - 1 or problem.residual.size > SHORT // 2:
            gone = {d.name for d in again}
            selection = undone(selection, gone)
            joint, acting = together(problem, selection, bare, known, reduce, base=base_columns)
            break
    doubts: tuple[Ambiguous, ...] = ()
    carried = bool({effect.name for effect, _ in known} & {"mass_change", "battery_voltage"})
    lifted = settled_lift(joint, floor_behind(acting, joint))
    named = {m.name for m in joint.members}
    if lifted and not mislabelled and "mass_change" not in named and not carried:
        seen = _scales(joint, acting, frame)
        mass = next((o for o in problem.options if o.name == "mass_change" and not o.shape), None)
        why = behind_voltage(seen) if "battery_voltage" in named else whole_mass(seen)
        if why and mass is not None:
            beside = replace(selection, members=[*selection.members, mass])
            trial = together(problem, beside, bare, known, reduce, base=base_columns, all_of=True)
            if not disbelieved(problem, trial[0], floor_behind(trial[1], trial[0])):
                selection, (joint, acting) = beside, trial
                size = max(abs(seen.lift), float(np.max(np.abs(seen.torque))))
                selection.trace.append(Step(9, "add", mass.name, 0.0, 0.0, size, True, why))
        elif "battery_voltage" not in named:
            doubts = tuple(doubt(frame, seen))
    if not (known or selection.doubtful):
        drag = next((o for o in problem.options if o.name == "rotor_drag"), None)
        fitter = fitter_of(problem, bare, known, named, reduce)
        both = drag_beside(fitter, joint, base_columns) if drag is not None else None
        if drag is not None and both is not None:
            selection = replace(selection, members=[*selection.members, drag])
            joint, acting = both, fitter.acting(both.members)
            why = "what drags in the wind damps yaw as the rotors' drag does"
            selection.trace.append(Step(9, "add", drag.name, 0.0, 0.0, 0.0, True, why))
    progress("judging")
    members = {m.name for m in joint.members}
    act = [part for part in known if part[0].name not in members]
    act += [(m.effect, m.parameters(bare)) for m in joint.members]
    floor = np.hypot(floor_behind(acting, joint), felt_noise(bare, act))
    if not lifted and frame.voltage is None:
        notes.append("voltage_V is not in the log: a sagging supply would look like this change of thrust")
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
    errors, floor = channel_errors(q, q.options), floor_behind(acting, joint)
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
    other, then = together(problem, again, bare, known, reduce, base=base_columns)
    now = channel_errors(other.problem, other.problem.options)
    less, left = float(np.sum(np.log(errors / now))), now / floor_behind(then, other)
    return (again, other, then) if less > CLEARLY and np.max(left) < DOUBTED else kept


def _scales(joint: Joint, acting: FlightFrame, frame: FlightFrame) -> Scales:
    q = joint.problem  # everything found acts in `acting`
    final = solve(q.blocks, columns_of(q, list(q.options)), np.ones(q.blocks.count))
    named = dict(zip(q.base_names, final[q.base], strict=True))
    return scales(acting, named, q.block, lambda c: reduce_columns(frame, c))


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
    shed: dict[str, Array] = {}  # what effects make of the loads: all of them, and all but a drift
    # a base of high order may swallow an effect that a plain one leaves to be named; and how rich a base must
    # be is seen better once the effects are known
    for order, again, bar in TRIES[:1] if model is not None else TRIES:
        if again and (again not in shed or best is None or not _far_off(best[1], bar)):
            continue
        progress("fitting candidates")
        bare = stand_frame(samples, model, order, shed.get(again), trusted)
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
        joint, acting = together(problem, selection, bare, known, reduce, start)
        gone = outrun(joint, acting, reduce)
        why = "needless beside something that changes over time and was not logged"
        if not gone:
            gone, why = within_forms(joint, bare), "no more than the form of a larger one misses"
        if not gone:
            gone, why = minor(joint, _stand_floor(bare, joint)), "leaves most of what is there"
        if gone:
            selection = undone(selection, gone)
            selection.trace += [Step(9, "drop", name, 0.0, 1.0, 0.0, True, why) for name in sorted(gone)]
            joint, acting = together(problem, selection, bare, known, reduce, start)
        error = _log_error(joint.problem)
        if best is None or error <= best[0] + PLAINER:
            shed = {"all": acting.predicted - problem.frame.predicted} if selection.members else {}
            steady = [(m.effect, m.parameters(bare)) for m in joint.members if m.name != "sensor_drift"]
            if 0 < len(steady) < len(joint.members):  # the drift may stand in for what the base lacks
                shed["steady"] = composed(bare, [*known, *steady]).predicted - problem.frame.predicted
            floor = _stand_floor(bare, joint)
            parts = (tuple(known), suspects, tuple(notes), not mislabelled)
            best = error, Judged(problem, selection, joint, floor, stand_variables(bare), *parts)
    assert best is not None
    progress("judging")
    return answer(best[1], several)


def _far_off(j: Judged, bar: float) -> bool:
    """Whether a load is left with more than so many times its noise."""
    q = j.joint.problem
    return bool(np.max(channel_errors(q, q.options) / np.maximum(j.floor, 1e-12)) > bar)


def _present(frame: StandFrame) -> Callable[[Array], Array]:
    keep, present = frame.keep, list(frame.present)
    return lambda columns: np.asarray(columns[keep][:, present])


def _stand_floor(frame: StandFrame, joint: Joint) -> Array:
    q = joint.problem
    fits = held_out(q.blocks, columns_of(q, list(q.options)))[1]
    return stand_floor(frame, held_out_residual(q, fits))


def _log_error(p: Problem) -> float:
    """Mean over channels of the logarithm of the held-out error, in the channels' units."""
    return float(np.mean(np.log(np.maximum(channel_errors(p, p.options), 1e-12))))


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
        joint, _ = together(problem, claimed, bare, known, reduce, settled)
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
            break
    return selection, settled


__all__ = ["Ambiguous", "Refinement", "refine", "refine_stand"]
