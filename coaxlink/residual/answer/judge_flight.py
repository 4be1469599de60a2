"""Flight logs against a model: what is chosen, doubted, and said."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from coaxlink.channels.flight_floor import floor_behind
from coaxlink.frames import FlightFrame
from coaxlink.instruments.flight.inputs import Inputs
from coaxlink.instruments.flight.rotors import rotor_faults
from coaxlink.residual.answer.concluded import Pieces, concluded, doubt_of, pieces_of, unexplained_of, unnamed
from coaxlink.residual.answer.mass_or_thrust import (
    MASS,
    doubt,
    level_not_mass,
    lift_beside,
    own_doubt,
    scales,
)
from coaxlink.residual.answer.report import Fitted, fitted_about
from coaxlink.residual.diagnosis.decide import (
    FEIGNED,
    FLIGHTS,
    NOTHING,
    Decision,
    alone,
    best_of,
    calibration,
    decided_in_flight,
    flown_numbers,
)
from coaxlink.residual.diagnosis.flight import flight_channels, would_show
from coaxlink.residual.diagnosis.flight_forms import TIME, Left
from coaxlink.residual.diagnosis.flight_search import Flown, searched
from coaxlink.residual.diagnosis.hypotheses import Hypothesis
from coaxlink.residual.diagnosis.rotors import ROTOR, Place, places, undecided
from coaxlink.residual.experiments.manoeuvres import flight_experiment
from coaxlink.residual.members import Member
from coaxlink.residual.result import AT, Ambiguous, Refinement, Unexplained

Progress = Callable[[str], None]
MUCH_LEFT = 2.5  # of the floor: a channel that holds more tells neither its level nor its scale
NO_FLIGHT = "no flight within reach distinguishes them: measure what each needs"
NO_PLACE = 1e-4  # probability: less is not told
LOOK = (
    "ground it and look at both; where neither shows it, a new propeller on the first, the same flight again"
)


def judge_flight(inputs: Inputs, bare: FlightFrame, progress: Progress) -> Refinement:
    """What these flights, aligned as `bare`, say of the model."""
    # of sensors that lie torques tell nothing
    wrong = () if inputs.blind else rotor_faults(bare)
    suspects = (*inputs.suspects, *wrong)
    progress("fitting candidates")
    ch = flight_channels(bare)
    found, reported, lead, left = None, NOTHING, None, None
    if not (inputs.blind or wrong):
        found = searched(ch, progress)
        progress("weighing the residual")
        reported, lead, left = decided_in_flight(found)
    progress("weighing every rotor")
    members, where, doubts = _placed(found, reported, lead)
    progress("judging")
    fitted = fitted_about(ch, members, lead)
    if _lifts_as_declared(fitted, reported):
        reported = replace(reported, claimed={n: p for n, p in reported.claimed.items() if n != MASS})
        fitted = fitted_about(ch, [m for m in members if m.name != MASS], lead)
    members, acting = list(fitted.members), fitted.acting
    lags = [m.shape["lag_s"] for m in members if m.name == "rotor_lag"]
    floor = floor_behind(acting, fitted.corrections, *lags)
    explained = dict(zip(ch.names, fitted.after.errors < MUCH_LEFT * floor, strict=True))
    posterior = found.posterior if found else None
    level = _level_not_mass(fitted, acting, reported)
    if level is not None:
        reported = replace(
            reported, claimed={n: p for n, p in reported.claimed.items() if n not in level.names}
        )
    between = [doubt_of(ch, posterior, g, flight_experiment, NO_FLIGHT) for g in reported.groups if posterior]
    out = concluded(
        fitted,
        posterior,
        replace(
            reported, claimed={n: p for n, p in reported.claimed.items() if n in {m.name for m in members}}
        ),
        floor,
        (suspects, [*ch.notes, *_lacking(ch.frame, explained)]),
        [*doubts, *([level] if level else _of_lift(fitted, acting, reported, explained)), *between]
        if found
        else [],
        _open_ends(found, lead, left, reported) if found and lead and left else [],
        inputs.logs,
    )
    out = _sure_of_place(out, where)
    if found is None or lead is None:
        return out
    named = out.names.union(*(a.names for a in out.ambiguous))
    with suppress(np.linalg.LinAlgError):  # numbers that no column tells apart
        out = replace(out, would_show=tuple(w for w in would_show(found, lead) if w.name not in named))
    return out


def _open_ends(found: Flown, lead: Hypothesis, left: Left, reported: Decision) -> list[Unexplained]:
    """Where more is there than is reported: what alone would have that reported, or the likeliest."""
    if not reported.is_open:
        return []
    ch, parts = found.channels, list[tuple[float, Pieces]]()
    for form in left.forms:
        parts.append((alone("form", form.log_evidence), pieces_of(left.channels, form.shown)))
    for line in left.lines:
        words = f"it comes and goes with a period of {line.period_s:.2g} s, by nothing recorded"
        parts.append((alone("line", line.log_evidence), {line.channel: [(line.rms, TIME, words)]}))
    for s in left.strains(best_of(found.posterior, {*reported.claimed} | reported.grouped)):
        words = (
            f"as if rotor {s.motor.removeprefix('motor')} made {100 * abs(s.share):.2g} % "
            f"{'more' if s.share > 0.0 else 'less'} {s.load} throughout, and the others the rest: "
            f"propellers of one mould differ by {100 * s.believed:.2g} %"
        )
        parts.append((alone("strain", s.log_evidence), {s.channel: [(s.rms, s.motor, words)]}))
    for m in [m for m in lead.members if m.name in reported.withheld]:
        u = unnamed(ch, found.posterior, lead, m, reported.doubt(m.name))
        log_evidence = flown_numbers(ch, found.posterior, lead, m)["tempered"]
        parts.append(
            (
                alone("lag" if m.name == FEIGNED else "name", log_evidence),
                {u.channel: [(u.rmse, u.depends_on[0], u.where)]},
            )
        )
    parts.sort(key=lambda part: -part[0])
    level, pieces = calibration(FLIGHTS)["level"]["open"], Pieces()
    for k, (p, mine) in enumerate(parts):
        for channel in mine if p >= level or k == 0 else ():
            pieces.setdefault(channel, []).extend(mine[channel])
    return unexplained_of(ch, pieces)


def _lacking(frame: FlightFrame, explained: Mapping[str, bool]) -> list[str]:
    notes = []
    if frame.voltage is None and not explained["force_z"]:
        notes.append("voltage_V is not in the log: a sagging supply would look like this change of thrust")
    if frame.airframe.motor_lag_s == 0.0:
        notes.append("motor_lag_s is not declared: a lag that this log shows is found as rotor_lag")
    return notes


def _level_not_mass(fitted: Fitted, acting: FlightFrame, reported: Decision) -> Ambiguous | None:
    """Where a mass is claimed that was there from the start, and the torques tell of a level of thrust."""
    ch, mass_kg = fitted.channels, _mass_from_the_start(fitted, reported)
    if mass_kg is None:
        return None
    return level_not_mass(ch.frame, scales(acting, fitted.corrections, ch.block, ch.reduce), mass_kg)


def _lifts_as_declared(fitted: Fitted, reported: Decision) -> bool:
    """Where a mass is claimed that was there from the start, and the vehicle lifts what it should, as far as
    its rotor model says: the mass only makes up for corrections of the thrust that say the contrary.
    """
    mass_kg, acting = _mass_from_the_start(fitted, reported), fitted.acting
    return mass_kg is not None and abs(lift_beside(acting, mass_kg)) < own_doubt(acting)


def _mass_from_the_start(fitted: Fitted, reported: Decision) -> float | None:
    mass = next((m for m in fitted.members if m.name in reported.claimed and m.name == MASS), None)
    if mass is None or "onset_s" in mass.shape:
        return None
    return mass.parameters(fitted.channels.bare)["mass_kg"]


def _of_lift(
    fitted: Fitted, acting: FlightFrame, reported: Decision, explained: Mapping[str, bool]
) -> Sequence[Ambiguous]:
    """Where the lift is off by what a stand may be: whether it is a mass."""
    ch = fitted.channels
    names = {*reported.claimed} | reported.grouped | {effect.name for effect, _ in ch.known}
    if names & {MASS, "battery_voltage"} or not explained["force_z"]:
        return ()
    turning = explained["torque_x"] and explained["torque_y"]
    return doubt(ch.frame, scales(acting, fitted.corrections, ch.block, ch.reduce), turning)


def _placed(
    found: Flown | None, reported: Decision, lead: Hypothesis | None
) -> tuple[list[Member], tuple[Place, ...], tuple[Ambiguous, ...]]:
    """The reported members, what is at one rotor at the likeliest one, and its places; or withheld."""
    leading = {*reported.claimed, *(g.names[0] for g in reported.groups)}
    members = [m for m in lead.members if m.name in leading] if lead else []
    mine = next((m for m in members if ROTOR in m.shape and m.name in reported.claimed), None)
    if mine is None or found is None or mine.name in {effect.name for effect, _ in found.channels.known}:
        return members, (), ()
    try:
        where = places(found.channels, members)
    except np.linalg.LinAlgError:  # numbers that no column tells apart: as the search has them
        return members, (), ()
    if between := undecided(where):
        names = tuple(f"{mine.name}{AT}{p.rotor}" for p in between)
        chances = tuple(round(reported.claimed[mine.name] * p.probability, 4) for p in between)
        return [m for m in members if m is not mine], (), (Ambiguous(names, LOOK, probability=chances),)
    if where[0].rotor != int(mine.shape[ROTOR]):
        members = [where[0].member if m is mine else m for m in members]
    return members, tuple(where), ()


def _sure_of_place(reported: Refinement, found: Sequence[Place]) -> Refinement:
    """The answer with how probable each rotor is beside the effect that is at one."""
    if not found:
        return reported
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
        for e in reported.effects
    )
    return replace(reported, effects=effects)
