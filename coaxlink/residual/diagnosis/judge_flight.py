"""Flight logs against a model: what is chosen, doubted, and said."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from coaxlink.data.samples import Samples
from coaxlink.frames import Array, FlightFrame
from coaxlink.residual.answer.assemble import Judged, answer
from coaxlink.residual.answer.doubts import with_rivals
from coaxlink.residual.channels.flight import reduce_columns
from coaxlink.residual.channels.flight_problem import (
    flight_problem,
    flight_variables,
    floor_behind,
    known_parts,
    nuisance_columns,
)
from coaxlink.residual.channels.velocity_noise import felt_noise
from coaxlink.residual.checks.drag_in_wind import drag_beside
from coaxlink.residual.checks.mass_or_thrust import Scales, behind_voltage, doubt, scales, why_mass
from coaxlink.residual.checks.posterior_check import Doubt, disbelieved, settled, undone, without
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.decide import flown_terms
from coaxlink.residual.diagnosis.decide import probability as probability_of
from coaxlink.residual.diagnosis.flight import borne_out, flight_channels, would_show
from coaxlink.residual.diagnosis.rotors import ROTOR, Place, places, undecided
from coaxlink.residual.faults.flight_faults import flight_suspects, without_flagged
from coaxlink.residual.regression.blocks import solve
from coaxlink.residual.regression.irls import channel_errors, reweighted, settled_nuisance
from coaxlink.residual.regression.joint_model import SHORT, Joint, Member, Part, columns_of, composed
from coaxlink.residual.regression.problem import Option, Problem
from coaxlink.residual.result import (
    AMONG_KNOWN,
    AT,
    Ambiguous,
    FoundEffect,
    Refinement,
    Step,
    Unexplained,
    WouldShow,
    probability,
)
from coaxlink.residual.search.change_point import with_onsets, with_option
from coaxlink.residual.search.joint_fit import fit_jointly, fitter_of
from coaxlink.residual.search.select import Selection, select

Progress = Callable[[str], None]
LEAST_ROWS = 80  # judged rows of a flight
SCRUTINIES = 4  # of a flight's choice; of one longer than five minutes, one
DOUBTED = 1.5  # of the floor: a flight's choice that leaves more in a channel is judged once more
NO_PLACE = 1e-4  # probability: less is not told
LOOK = (
    "ground it and look at both; where neither shows it, a new propeller on the first, the same flight again"
)
CLEARLY = 0.1  # of the logarithm of errors, channels together, that another choice must leave less


@dataclass(frozen=True)
class _Flight:
    """What stays as it is while the choice changes: the log, and what the model knows of it already."""

    bare: FlightFrame  # without what is known
    frame: FlightFrame  # with it
    known: Sequence[Part]

    def reduce(self, columns: Array) -> Array:
        """What an effect adds on the frame's rows, on judged rows."""
        return reduce_columns(self.frame, columns)

    def fitted(self, problem: Problem, selection: Selection, *, all_of: bool = False) -> _Choice:
        """A selection with its joint fit."""
        bare, known, reduce = self.bare, self.known, self.reduce
        fit = fit_jointly(problem, selection, bare, known, reduce, nuisance=nuisance_columns, all_of=all_of)
        return _Choice(problem, selection, *fit)

    @property
    def knows(self) -> set[str]:
        """Names of what the model knows."""
        return {effect.name for effect, _ in self.known}


@dataclass(frozen=True)
class _Choice:
    """What was chosen, and its joint fit."""

    problem: Problem
    selection: Selection
    joint: Joint
    acting: FlightFrame  # with everything found

    @property
    def floor(self) -> Array:
        """(C,) noise behind the fit."""
        return floor_behind(self.acting, self.joint)

    @property
    def names(self) -> set[str]:
        """Of its members."""
        return {m.name for m in self.joint.members}


def judge_flight(several: Sequence[Samples], bare: FlightFrame, progress: Progress) -> Refinement:
    """What these flights, aligned as `bare`, say of the model."""
    suspects, bad, mislabelled = flight_suspects(bare, several)
    bare = without_flagged(bare, suspects)
    if bad.any() and np.sum(~bad[bare.keep]) > LEAST_ROWS:
        bare = replace(bare, keep=bare.keep[~bad[bare.keep]])
    known, notes = known_parts(bare)
    f = _Flight(bare, composed(bare, known), known)
    progress("fitting candidates")
    c = _chosen(f, flight_problem(f.frame), mislabelled, progress)
    chosen = c.names
    lifted = settled(c.joint, c.floor, "force_z")
    doubts: tuple[Ambiguous, ...] = ()
    if lifted and not mislabelled:
        c, doubts = _weighed(f, c)
    c = _dragged(f, c)
    progress("weighing every rotor")
    where: tuple[Place, ...] = ()
    with suppress(np.linalg.LinAlgError):  # numbers that no column tells apart: as the selection has them
        c, where, which = _placed(f, c)
        doubts += which
    progress("judging")
    act = [part for part in known if part[0].name not in c.names]
    act += [(m.effect, m.parameters(bare)) for m in c.joint.members]
    floor = np.hypot(c.floor, felt_noise(bare, act))
    if not lifted and f.frame.voltage is None:
        notes.append("voltage_V is not in the log: a sagging supply would look like this change of thrust")
    if bare.airframe.motor_lag_s == 0.0:
        notes.append("motor_lag_s is not declared: a real lag of the motors will be found as rotor_lag")
    variables = flight_variables(f.frame)
    parts = (tuple(known), tuple(suspects), tuple(notes), not mislabelled, doubts)
    judged = Judged(settled_nuisance(c.problem), c.selection, c.joint, floor, variables, *parts)

    def fitted(options: Sequence[Option]) -> Joint:
        return f.fitted(c.problem, Selection(members=list(options)), all_of=True).joint

    judged = with_rivals(judged, c.problem, fitted, c.names - chosen)
    said = _sure_of_place(answer(judged, several), where)
    if mislabelled:
        return said
    ch = flight_channels(f.bare, known, c.problem)
    members = [m for m in c.joint.members if m.name in said.names]
    with suppress(np.linalg.LinAlgError):
        said = replace(said, would_show=_least(ch, members, said, c.problem))
        said = _weighed_anew(said, ch, members)
    return _or_small(said, c)


def _or_small(said: Refinement, c: _Choice) -> Refinement:
    """An answer that would say nothing, with what is beyond the noise but too small for a name left open."""
    t, p = c.selection.small, c.problem
    if t is None or said.effects or said.ambiguous or said.unexplained or said.suspect_data:
        return said
    channel = p.channels[t.channel]
    label, _ = t.option.effect.cause(p.frame, t.option.shape, channel)
    size_of = f"{100 * t.size:.2g} % of the load, as {t.option.name} would have it"
    where = f"{label}: {size_of}: beyond the noise, but too small to be named"
    size = t.size * float(p.reference[t.channel])
    return replace(said, unexplained=(Unexplained(channel, (label,), size, where),))


def _chosen(f: _Flight, problem: Problem, mislabelled: bool, progress: Progress) -> _Choice:
    """The choice, made again without what its own numbers deny, until they deny nothing."""
    struck: list[Doubt] = []
    for number in range(1, SCRUTINIES + 1):
        progress("selecting")
        began = {d.name for d in struck if d.onset}
        problem = with_onsets(problem, [], f.reduce, barred=began)
        selection = Selection() if mislabelled else select(problem)
        # a beginning that another effect hid is looked for once more beside it
        further = with_onsets(problem, selection.members, f.reduce, barred=began)
        if selection.members and further is not problem:
            problem, selection = further, select(further)
        selection.trace[:0] = [Step(0, "drop", d.name, 0.0, 1.0, 0.0, True, d.why) for d in struck]
        progress("fitting all effects jointly")
        c = _doubted(f, f.fitted(problem, selection))
        again = disbelieved(problem, c.joint, c.floor, f.knows)
        if not again:
            return c
        struck += again  # at most every effect once, and its beginning
        problem = without(problem, again)
        if number == SCRUTINIES or problem.residual.size > SHORT // 2:
            break
    return f.fitted(problem, undone(c.selection, {d.name for d in again}))


def _weighed(f: _Flight, c: _Choice) -> tuple[_Choice, tuple[Ambiguous, ...]]:
    """With a mass where lift and torques ask for one; or whether it is one or the level of thrust."""
    if "mass_change" in c.names or f.knows & {"mass_change", "battery_voltage"}:
        return c, ()
    estimated = _scales(c, f)
    mass = next((o for o in c.problem.options if o.name == "mass_change" and "onset_s" not in o.shape), None)
    # torques that hold more (gusts that come back as commands, an inertia far off) tell no scale
    explained = settled(c.joint, c.floor, "torque_x", "torque_y")
    sagging = "battery_voltage" in c.names
    why = "" if not explained else behind_voltage(estimated) if sagging else why_mass(estimated)
    if not why or mass is None:
        return c, () if sagging else tuple(doubt(f.frame, estimated, explained))
    beside = replace(c.selection, members=[*c.selection.members, mass])
    trial = f.fitted(c.problem, beside, all_of=True)
    if disbelieved(c.problem, trial.joint, trial.floor, derived=(mass.name,)):
        return c, ()
    size = max(abs(estimated.lift), float(np.max(np.abs(estimated.torque))))
    beside.trace.append(Step(9, "add", mass.name, 0.0, 0.0, size, True, why))
    return trial, ()


def _dragged(f: _Flight, c: _Choice) -> _Choice:
    """With the rotors' drag where it blew and what the wind was taken for damps yaw as that drag does."""
    drag = next((o for o in c.problem.options if o.name == "rotor_drag"), None)
    if f.known or c.selection.doubtful or drag is None:
        return c
    fitter = fitter_of(c.problem, f.bare, f.known, c.names, f.reduce)
    both = drag_beside(fitter, c.joint, nuisance_columns)
    if both is None:
        return c
    selection = replace(c.selection, members=[*c.selection.members, drag])
    why = "what drags in the wind damps yaw as the rotors' drag does"
    selection.trace.append(Step(9, "add", drag.name, 0.0, 0.0, 0.0, True, why))
    return replace(c, selection=selection, joint=both, acting=fitter.acting(both.members))


def _placed(f: _Flight, c: _Choice) -> tuple[_Choice, tuple[Place, ...], tuple[Ambiguous, ...]]:
    """With what is at one rotor at the likeliest one, and its places; or withheld, where none stands out."""
    mine = next((m for m in c.joint.members if ROTOR in m.shape), None)
    if mine is None or mine.name in f.knows or c.selection.doubtful:
        return c, (), ()
    found = places(flight_channels(f.bare, f.known, c.problem), c.joint.members)
    option = next(o for o in c.selection.members if o.name == mine.name)
    others = [o for o in c.selection.members if o is not option]
    if between := undecided(found):
        names = tuple(f"{mine.name}{AT}{p.rotor}" for p in between)
        said = tuple(probability(p.probability) for p in between)
        doubt = Ambiguous(names, LOOK, probability=said)
        return replace(c, selection=replace(c.selection, members=others, doubtful=[option])), (), (doubt,)
    if found[0].rotor == int(mine.shape[ROTOR]):
        return c, tuple(found), ()
    problem = with_option(c.problem, option, found[0].member.shape, f.reduce)
    chosen = f.fitted(problem, replace(c.selection, members=[*others, problem.options[-1]]), all_of=True)
    return chosen, tuple(found), ()


def _least(ch: Channels, members: Sequence[Member], said: Refinement, p: Problem) -> tuple[WouldShow, ...]:
    """The smallest size of every effect that is not named that these flights would have shown."""
    named = said.names.union(*(a.names for a in said.ambiguous))
    return tuple(w for w in would_show(ch, members, len(p.residual)) if w.name not in named)


def _weighed_anew(said: Refinement, ch: Channels, members: Sequence[Member]) -> Refinement:
    """With the probability of each name that its evidence over the others alone has had."""
    if not any("probability" in e.evidence for e in said.effects):
        return said
    nats = borne_out(ch, members)
    sure = {name: probability_of("flight", flown_terms(n)) for name, n in nats.items()}

    def with_evidence(e: FoundEffect) -> FoundEffect:
        if "probability" not in e.evidence:
            return e
        p = e.evidence["probability"] / AMONG_KNOWN * sure[e.name]
        return replace(e, evidence={**e.evidence, "probability": round(p, 4)})

    weighed = tuple(
        {"names": [e.name], "probability": sure[e.name], "numbers": {"tempered": nats[e.name]}}
        for e in said.effects
    )
    return replace(said, effects=tuple(with_evidence(e) for e in said.effects), weighed=weighed)


def _sure_of_place(said: Refinement, found: Sequence[Place]) -> Refinement:
    """The answer with how probable each rotor is beside the effect that is at one."""
    if not found:
        return said
    shares = {str(p.rotor): round(p.probability, 4) for p in found if p.probability > NO_PLACE}

    def with_evidence(e: FoundEffect) -> FoundEffect:
        if e.name != found[0].member.name:
            return e
        evidence = {**e.evidence, "rotors": shares}
        if "probability" in evidence:
            evidence["probability"] = round(evidence["probability"] * found[0].probability, 4)
        return replace(e, evidence=evidence)

    return replace(said, effects=tuple(with_evidence(e) for e in said.effects))


def _doubted(f: _Flight, c: _Choice) -> _Choice:
    """The choice judged once more, torques counting in full, where a channel is left far above its noise.

    Another one (a mass and a centre for a failing rotor) is taken only if it leaves little but noise.
    """
    q = c.joint.problem
    if not c.names or c.selection.doubtful or c.problem.residual.size > SHORT or q.frame is not f.bare:
        return c
    errors, floor = channel_errors(q, q.options), c.floor
    if np.max(errors / floor) < DOUBTED:
        return c
    again = select(reweighted(c.problem, floor))
    if again.ambiguous or not again.members or {m.name for m in again.members} == c.names:
        return c
    again.trace = [*c.selection.trace, *again.trace]
    other = f.fitted(c.problem, again)
    now = channel_errors(other.joint.problem, other.joint.problem.options)
    less, left = float(np.sum(np.log(errors / now))), now / other.floor
    return other if less > CLEARLY and np.max(left) < DOUBTED else c


def _scales(c: _Choice, f: _Flight) -> Scales:
    q = c.joint.problem  # everything found acts in `c.acting`
    final = solve(q.blocks, columns_of(q), np.ones(q.blocks.count))
    named = dict(zip(q.nuisance_names, final[q.nuisance], strict=True))
    return scales(c.acting, named, q.block, f.reduce)
