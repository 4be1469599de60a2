"""Flight logs against a model: what is chosen, doubted, and said."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from coaxlink.data.samples import Samples
from coaxlink.frames import Array, FlightFrame
from coaxlink.residual.answer.assemble import Judged, answer
from coaxlink.residual.channels.flight import reduce_columns
from coaxlink.residual.channels.flight_problem import (
    flight_problem,
    flight_variables,
    floor_behind,
    known_parts,
    nuisance_columns,
)
from coaxlink.residual.channels.velocity_noise import felt_noise
from coaxlink.residual.diagnosis.answer import (
    held_whole,
    refused,
    rejected,
    rivals_of,
    trace_of,
    unnamed,
    worth,
)
from coaxlink.residual.diagnosis.decide import (
    FLIGHTS,
    NOTHING,
    Decision,
    Group,
    calibration,
    decided_in_flight,
)
from coaxlink.residual.diagnosis.flight import flight_channels, would_show
from coaxlink.residual.diagnosis.flight_search import Flown, searched
from coaxlink.residual.diagnosis.hypotheses import Hypothesis, is_whole
from coaxlink.residual.diagnosis.mass_or_thrust import doubt, scales
from coaxlink.residual.diagnosis.rotors import ROTOR, Place, places, undecided
from coaxlink.residual.experiments.manoeuvres import flight_experiment
from coaxlink.residual.faults.flight_faults import flight_suspects, without_flagged
from coaxlink.residual.regression.blocks import solve
from coaxlink.residual.regression.irls import channel_errors, nuisance_of, settled_nuisance
from coaxlink.residual.regression.joint_model import (
    ONSET,
    Fitter,
    Joint,
    Member,
    Part,
    columns_of,
    composed,
    straight,
)
from coaxlink.residual.regression.problem import Problem
from coaxlink.residual.result import AT, Ambiguous, Refinement, Unexplained, probability

Progress = Callable[[str], None]
LEAST_ROWS = 80  # judged rows of a flight
MUCH_LEFT = 2.5  # of the floor: a channel that holds more tells neither its level nor its scale
NO_PLACE = 1e-4  # probability: less is not told
LOOK = (
    "ground it and look at both; where neither shows it, a new propeller on the first, the same flight again"
)


@dataclass(frozen=True)
class _Flight:
    """The log, what the model knows of it already, and what was found."""

    bare: FlightFrame  # without what is known
    frame: FlightFrame  # with it
    known: Sequence[Part]
    problem: Problem
    found: Flown | None
    lead: Hypothesis | None

    def reduce(self, columns: Array) -> Array:
        """What an effect adds on the frame's rows, on judged rows."""
        return reduce_columns(self.frame, columns)

    def fitted(self, members: Sequence[Member], held: set[str]) -> tuple[Joint, FlightFrame]:
        """The regression about members, and the frame with them acting; of `held` ones the shape stays.

        A channel's rows count as the noise that the members leave has them count.
        """
        names = {m.name for m in members}
        fixed = [part for part in self.known if part[0].name not in names]
        plain = Fitter(self.problem, self.bare, fixed, self.reduce)
        if not members or self.found is None or self.lead is None:
            return straight(settled_nuisance(self.problem)), plain.acting([])
        share = np.array(self.found.search.scorer.colour.share)
        about = nuisance_of(self.problem, self.lead.fit.noise / np.sqrt(share))
        acting = plain.acting(members)
        columns = nuisance_columns(acting, self.reduce) / about.sigma[:, None]
        members = [
            replace(
                m,
                whole=is_whole(m),
                keys=tuple(k for k in m.keys if k != ONSET and m.name not in held),
            )
            for m in members
        ]
        return held_whole(Fitter(about, self.bare, fixed, self.reduce, columns).linear(members)), acting


def judge_flight(several: Sequence[Samples], bare: FlightFrame, progress: Progress) -> Refinement:
    """What these flights, aligned as `bare`, say of the model."""
    suspects, bad, mislabelled = flight_suspects(bare, several)
    bare = without_flagged(bare, suspects)
    if bad.any() and np.sum(~bad[bare.keep]) > LEAST_ROWS:
        bare = replace(bare, keep=bare.keep[~bad[bare.keep]])
    known, notes = known_parts(bare)
    frame = composed(bare, known)
    progress("fitting candidates")
    problem = flight_problem(frame)
    found, said, lead = None, NOTHING, None
    if not mislabelled:
        found = searched(flight_channels(bare, known, problem), progress)
        said, lead = decided_in_flight(found.channels, found.posterior)
    f = _Flight(bare, frame, known, problem, found, lead)
    progress("weighing every rotor")
    members, where, doubts = _placed(f, said)
    progress("judging")
    out = _answered(f, several, said, members, (suspects, notes, doubts), set())
    if held := {e.name for e in out.effects if refused(e)}:
        out = _answered(f, several, said, members, (suspects, notes, doubts), held)
        if still := {e.name for e in out.effects if refused(e)}:
            said = said.without(still)
            members = [m for m in members if m.name not in still]
            out = _answered(f, several, said, members, (suspects, notes, doubts), held)
    out = _sure_of_place(out, where)
    if found is None or lead is None:
        return out
    named = out.names.union(*(a.names for a in out.ambiguous))
    with suppress(np.linalg.LinAlgError):  # numbers that no column tells apart
        out = replace(out, would_show=tuple(w for w in would_show(found, lead) if w.name not in named))
    return replace(out, weighed=said.weighed)


def _answered(
    f: _Flight,
    several: Sequence[Samples],
    said: Decision,
    members: Sequence[Member],
    beside: tuple[Sequence[Any], Sequence[str], Sequence[Ambiguous]],
    held: set[str],
) -> Refinement:
    suspects, notes, doubts = beside
    joint, acting = f.fitted(members, held)
    floor = floor_behind(acting, joint)
    names = {m.name for m in members}
    act = [part for part in f.known if part[0].name not in names]
    act += [(m.effect, m.parameters(f.bare)) for m in joint.members]
    doubts = [*doubts, *_of_lift(f, joint, acting, floor, said)]
    judged = Judged(
        problem=settled_nuisance(f.problem),
        claims=frozenset(n for n in said.claimed if n in names),
        joint=joint,
        floor=np.hypot(floor, felt_noise(f.bare, act)),
        variables=flight_variables(f.frame),
        known=tuple(f.known),
        suspects=tuple(suspects),
        notes=(*notes, *_lacking(f, joint, floor)),
        labelled=f.found is not None,
        doubts=(*doubts, *(_doubt(f, g) for g in said.groups)),
        evidence=_evidence(f, said),
        rejected=tuple(rejected(f.found.posterior, said)) if f.found else (),
        trace=trace_of(f.found.posterior) if f.found else (),
    )
    out = answer(judged, several)
    shown = {u.channel for u in out.unexplained}
    return replace(
        out, unexplained=(*out.unexplained, *(u for u in _unnamed(f, said) if u.channel not in shown))
    )


def _unnamed(f: _Flight, said: Decision) -> list[Unexplained]:
    """Members that are surer than what shows in sound flights, but not as sure as a name has to be."""
    if f.found is None or f.lead is None:
        return []
    level = calibration(FLIGHTS)["level"]["open"]
    there = [m for m in f.lead.members if said.withheld.get(m.name, 0.0) >= level]
    found = f.found
    return [unnamed(found.channels, found.posterior, f.lead, m, said.withheld[m.name]) for m in there]


def _evidence(f: _Flight, said: Decision) -> Mapping[str, Mapping[str, Any]]:
    if f.found is None:
        return {}
    found = f.found.posterior
    return {n: {"probability": round(p, 4), "nats": worth(found, n)} for n, p in said.claimed.items()}


def _lacking(f: _Flight, joint: Joint, floor: Array) -> list[str]:
    notes = []
    if f.frame.voltage is None and not _settled(joint, floor, "force_z"):
        notes.append("voltage_V is not in the log: a sagging supply would look like this change of thrust")
    if f.bare.airframe.motor_lag_s == 0.0:
        notes.append("motor_lag_s is not declared: a real lag of the motors will be found as rotor_lag")
    return notes


def _settled(joint: Joint, floor: Array, *channels: str) -> bool:
    """Whether channels are explained well enough for their level, or their scale, to mean anything."""
    q = joint.problem
    use = [q.channels.index(name) for name in channels]
    return bool(np.all((channel_errors(q, q.options) < MUCH_LEFT * floor)[use]))


def _of_lift(
    f: _Flight, joint: Joint, acting: FlightFrame, floor: Array, said: Decision
) -> Sequence[Ambiguous]:
    """Where the lift is off by what a stand may be: whether it is a mass."""
    names = {*said.claimed} | said.grouped | {effect.name for effect, _ in f.known}
    if f.found is None or names & {"mass_change", "battery_voltage"}:
        return ()
    if not _settled(joint, floor, "force_z"):
        return ()
    q = joint.problem
    final = solve(q.blocks, columns_of(q), np.ones(q.blocks.count))
    named = dict(zip(q.nuisance_names, final[q.nuisance], strict=True))
    explained = _settled(joint, floor, "torque_x", "torque_y")
    return doubt(f.frame, scales(acting, named, q.block, f.reduce), explained)


def _doubt(f: _Flight, group: Group) -> Ambiguous:
    """Names of which one is there, and the flight that would tell."""
    assert f.found is not None
    rivals = rivals_of(f.found.channels, f.found.posterior, group)
    plan = flight_experiment(f.bare, f.problem.sigma, rivals) if len(rivals) == 2 else None
    text = plan.text if plan else "no flight within reach tells them apart: measure what each needs"
    rest = (group.probability - group.first) / max(len(group.names) - 1, 1)
    said = tuple(round(float(p), 4) for p in (group.first, *[rest] * (len(group.names) - 1)))
    return Ambiguous(group.names, text, plan, said)


def _placed(f: _Flight, said: Decision) -> tuple[list[Member], tuple[Place, ...], tuple[Ambiguous, ...]]:
    """The members that are said, what is at one rotor at the likeliest one, and its places; or withheld."""
    leading = {*said.claimed, *(g.names[0] for g in said.groups)}
    members = [m for m in f.lead.members if m.name in leading] if f.lead else []
    mine = next((m for m in members if ROTOR in m.shape and m.name in said.claimed), None)
    if mine is None or f.found is None or mine.name in {effect.name for effect, _ in f.known}:
        return members, (), ()
    try:
        found = places(f.found.channels, members)
    except np.linalg.LinAlgError:  # numbers that no column tells apart: as the search has them
        return members, (), ()
    if between := undecided(found):
        names = tuple(f"{mine.name}{AT}{p.rotor}" for p in between)
        chances = tuple(probability(p.probability) for p in between)
        return [m for m in members if m is not mine], (), (Ambiguous(names, LOOK, probability=chances),)
    if found[0].rotor != int(mine.shape[ROTOR]):
        members = [found[0].member if m is mine else m for m in members]
    return members, tuple(found), ()


def _sure_of_place(said: Refinement, found: Sequence[Place]) -> Refinement:
    """The answer with how probable each rotor is beside the effect that is at one."""
    if not found:
        return said
    shares = {str(p.rotor): round(p.probability, 4) for p in found if p.probability > NO_PLACE}
    name, sure = found[0].member.name, found[0].probability
    effects = tuple(
        replace(
            e,
            evidence={
                **e.evidence,
                "rotors": shares,
                "probability": round(e.evidence["probability"] * sure, 4),
            },
        )
        if e.name == name
        else e
        for e in said.effects
    )
    return replace(said, effects=effects)
