"""Flight logs against a model: what is chosen, doubted, and said."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.data.samples import Samples
from coaxlink.residual.answer import Judged, answer
from coaxlink.residual.blocks import solve
from coaxlink.residual.drag_in_wind import drag_beside
from coaxlink.residual.felt_noise import felt_noise
from coaxlink.residual.flight import flight_frame, reduce_columns
from coaxlink.residual.flight_problem import (
    base_columns,
    flight_problem,
    flight_variables,
    floor_behind,
    known_parts,
)
from coaxlink.residual.flight_suspects import flight_suspects
from coaxlink.residual.frames import Array, FlightFrame
from coaxlink.residual.joint import SHORT, Joint, Part, composed
from coaxlink.residual.mass_or_thrust import Scales, behind_voltage, doubt, scales, whole_mass
from coaxlink.residual.problem import Problem
from coaxlink.residual.result import Ambiguous, Refinement, Step
from coaxlink.residual.reweigh import channel_errors, reweighed, settled_base
from coaxlink.residual.scrutiny import Doubt, disbelieved, settled_lift, undone, without
from coaxlink.residual.select import Selection, columns_of, select
from coaxlink.residual.sudden import with_onsets
from coaxlink.residual.together import fitter_of, together
from coaxlink.rotor import RotorModel

Progress = Callable[[str], None]
LEAST_ROWS = 80  # judged rows of a flight
SCRUTINIES = 4  # of a flight's choice; of one longer than five minutes, one
DOUBTED = 1.5  # of the floor: a flight's choice that leaves more in a channel is judged once more
CLEARLY = 0.1  # of the logarithm of errors, channels together, that another choice must leave less


def judge_flight(
    several: Sequence[Samples],
    airframe: Airframe,
    model: RotorModel,
    progress: Progress,
) -> Refinement:
    """What these flights say of the model. Raises InputError when a log lacks what every flight needs."""
    progress("aligning")
    bare = flight_frame(several, airframe, model)
    suspects, bad, mislabelled = flight_suspects(bare, several)
    if bad.any() and np.sum(~bad[bare.keep]) > LEAST_ROWS:
        bare = replace(bare, keep=bare.keep[~bad[bare.keep]])
    known, notes = known_parts(bare)
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
