"""A verdict on rotors that goes no further than its premises."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from coaxlink.channels.flight import flight_frame, flown
from coaxlink.data.samples import PREMISES, Samples
from coaxlink.frames import FlightFrame
from coaxlink.health.columns import reduced
from coaxlink.health.judge import Health, judge
from coaxlink.health.priors import GROUND, WATCH
from coaxlink.health.turning import apart, speed_ratios, turning_words
from coaxlink.instruments.findings import Suspect
from coaxlink.instruments.flight.inputs import Inputs, checked
from coaxlink.premises import (
    NotJudged,
    as_if,
    damage,
    lacking,
    moves,
    not_judged,
    other_vehicle,
    unseen,
)
from coaxlink.residual.refine import vehicle_differs
from coaxlink.vehicle import Vehicle


def judged(logs: Sequence[Samples], names: Sequence[str], vehicle: Vehicle) -> Health:
    """Health over flights of one vehicle, oldest first; or why that cannot be reported.

    Raises InputError when a log lacks what every flight needs.
    """
    if not vehicle_differs(logs, vehicle.declared):
        kept = flown(logs, vehicle.declared, vehicle.rotors)
        sources = {log.source for log in kept}
        names = [name for log, name in zip(logs, names, strict=True) if log.source in sources]
        logs = kept
    granted = dict.fromkeys(PREMISES[p] for log in logs for p in log.premises)
    with threadpool_limits(limits=1, user_api="blas"):  # many small products
        inputs = checked(logs, vehicle.declared)
        found = _judged(inputs, names, vehicle)
    return replace(
        found, premises=(*granted, *unseen(logs)), suspect_data=(*inputs.suspects, *found.suspect_data)
    )


def _judged(inputs: Inputs, names: Sequence[str], vehicle: Vehicle) -> Health:
    body, logs = vehicle.declared, inputs.logs
    differs = list(vehicle_differs(logs, body))
    if differs:
        return Health.withheld((), not_this_vehicle=differs)
    if inputs.blind:
        return Health.withheld((), cannot_judge=list(blind_reasons(inputs)))
    frames = [flight_frame([log], body, vehicle.rotors) for log in logs]
    differs = [d for frame, log in zip(frames, logs, strict=True) for d in other_vehicle(frame, [log])]
    if differs:
        return Health.withheld((), not_this_vehicle=differs)
    found = _held_against_speeds(_over(frames, names), names[-1], logs[-1], vehicle)
    if found.reasons:
        return found
    lacks = [reason for frame in frames for reason in lacking(frame)]
    lacks += damage(logs, _words(found))
    lacks += () if lacks else _hangs_on(found, frames, names)
    return Health.withheld(found.flights, cannot_judge=lacks) if lacks else found


def blind_reasons(inputs: Inputs) -> Iterator[NotJudged]:
    """What makes a log as a whole useless."""
    for suspect in inputs.blind:
        why = f"{suspect.column}: {suspect.why}"
        yield NotJudged(suspect.column, "with that column mended, or by another log", why)


def _over(frames: Sequence[FlightFrame], names: Sequence[str], *, slides: bool = True) -> Health:
    body = frames[0].airframe
    numbers = [r.number for r in body.rotors]
    return judge([reduced(f) for f in frames], names, numbers, body.pairs, slides=slides)


def _held_against_speeds(found: Health, name: str, log: Samples, vehicle: Vehicle) -> Health:
    """A verdict by commands, held against the ESCs' rpm of the last flight, where they are logged.

    A rotor that is named and turns slower than asked has a motor or an ESC that fails. Any other that is
    apart is a command or an rpm that is logged wrong: where the verdict is sound an rpm, which nothing hangs
    on; else what a rotor lacks may be what that command is off by.
    """
    first, sound = found.suspects[0], found.verdict == "sound"
    onset = None if sound or first.since != name else first.onset_s
    since = -np.inf if onset is None else onset.value
    ratios = speed_ratios(log, vehicle.declared, vehicle.rotors, since)
    found = replace(found, speed_ratios=ratios)
    off = apart(ratios)
    if sound:
        why = "its command and the flight fit, its speed does not: magnets counted, another ESC"
        rpm = tuple(Suspect(f"rpm{n}", "all", f"{turning_words({n: r})}: {why}") for n, r in off.items())
        return replace(found, suspect_data=rpm)
    named = [s.rotor for s in found.suspects if s is first or s.probability >= WATCH]
    strange = {n: ratio for n, ratio in off.items() if n not in named or ratio > 1.0}
    if not strange:
        return found
    why = f"{turning_words(strange)}: a command or an rpm is logged wrong, and {_words(found)} may be that"
    return Health.withheld(
        found.flights, cannot_judge=[NotJudged("rpm", "by a log whose rpm go with the commands", why)]
    )


def _hangs_on(found: Health, frames: Sequence[FlightFrame], names: Sequence[str]) -> Iterator[NotJudged]:
    """Premises that change the verdict or the rotor when they are moved. That something aboard slid is one.

    A mass is not moved: what all rotors have in common is unknown here to a tenth (`LIFT_TODAY`).
    """
    reported = _words(found)
    if found.verdict == "sound" and found.slid > GROUND:
        fast = _words(_over(frames, names, slides=False))
        if fast != reported:
            measure = "whether something aboard can have moved in flight (payload, pack)"
            yield NotJudged("payload", measure, f"if nothing can the answer is {fast} in place of {reported}")
    seen: set[str] = set()
    for moved in moves(frames[0].airframe):
        if moved.premise in seen or moved.premise == "mass_kg":
            continue
        other = _words(_over([as_if(frame, moved.airframe) for frame in frames], names))
        if other != reported:
            seen.add(moved.premise)
            yield not_judged(moved.premise, f"{moved.words} the answer is {other} in place of {reported}")


def _words(found: Health) -> str:
    """The verdict and the rotor that it names."""
    return found.verdict if found.verdict == "sound" else f"{found.verdict}, rotor {found.suspects[0].rotor}"
