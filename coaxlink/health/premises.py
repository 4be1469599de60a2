"""A verdict on rotors that goes no further than its premises."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from coaxlink.constants import NORMAL_95
from coaxlink.data.samples import PREMISES, Samples
from coaxlink.frames import FlightFrame
from coaxlink.health.coefficients import Update, coefficients_from_flights
from coaxlink.health.columns import reduced
from coaxlink.health.judge import Health, judge
from coaxlink.health.priors import GROUND
from coaxlink.premises import (
    NotJudged,
    OtherVehicle,
    as_if,
    damage,
    lacking,
    moves,
    not_judged,
    other_vehicle,
    unseen,
)
from coaxlink.premises.moves import UNKNOWN
from coaxlink.premises.same_vehicle import RESPONSE
from coaxlink.residual.channels.flight import flight_frame, flown
from coaxlink.residual.refine import vehicle_differs
from coaxlink.vehicle import Vehicle


def judged(logs: Sequence[Samples], names: Sequence[str], vehicle: Vehicle) -> Health:
    """Health over flights of one vehicle, oldest first; or why that cannot be said.

    Raises InputError when a log lacks what every flight needs.
    """
    if not vehicle_differs(logs, vehicle.declared):
        kept = flown(logs, vehicle.declared, vehicle.rotors)
        sources = {log.source for log in kept}
        names = [name for log, name in zip(logs, names, strict=True) if log.source in sources]
        logs = kept
    granted = dict.fromkeys(PREMISES[p] for log in logs for p in log.premises)
    return replace(_judged(logs, names, vehicle), premises=(*granted, *unseen(logs)))


def _judged(logs: Sequence[Samples], names: Sequence[str], vehicle: Vehicle) -> Health:
    body = vehicle.declared
    differs = list(vehicle_differs(logs, body))
    if differs:
        return Health.withheld((), not_this_vehicle=differs)
    frames = [flight_frame([log], body, vehicle.rotors) for log in logs]
    differs = [d for frame, log in zip(frames, logs, strict=True) for d in other_vehicle(frame, [log])]
    if differs:
        return Health.withheld((), not_this_vehicle=differs)
    found = _over(frames, names)
    lacks = [reason for frame in frames for reason in lacking(frame)]
    lacks += damage(logs, _words(found))
    lacks += () if lacks else _hangs_on(found, frames, names)
    return Health.withheld(found.flights, cannot_judge=lacks) if lacks else found


def _over(frames: Sequence[FlightFrame], names: Sequence[str], *, slides: bool = True) -> Health:
    body = frames[0].airframe
    numbers = [r.number for r in body.rotors]
    return judge([reduced(f) for f in frames], names, numbers, body.pairs, slides=slides)


def _hangs_on(found: Health, frames: Sequence[FlightFrame], names: Sequence[str]) -> Iterator[NotJudged]:
    """Premises that change the verdict or the rotor when they are moved. That something aboard slid is one.

    A mass is not moved: what all rotors have in common is unknown here to a tenth (`LIFT_TODAY`).
    """
    said = _words(found)
    if found.verdict == "sound" and found.slid > GROUND:
        fast = _words(_over(frames, names, slides=False))
        if fast != said:
            measure = "whether something aboard can have moved in flight (payload, pack)"
            yield NotJudged("payload", measure, f"if nothing can the answer is {fast} in place of {said}")
    seen: set[str] = set()
    for moved in moves(frames[0].airframe):
        if moved.premise in seen or moved.premise == "mass_kg":
            continue
        other = _words(_over([as_if(frame, moved.airframe) for frame in frames], names))
        if other != said:
            seen.add(moved.premise)
            yield not_judged(moved.premise, f"{moved.words} the answer is {other} in place of {said}")


def flown_by(logs: Sequence[Samples], vehicle: Vehicle) -> tuple[OtherVehicle | NotJudged, ...]:
    """Why these flights can update no rotor model of this vehicle; empty where they can. Raises InputError.

    An estimated prior may be off by more than a measured model: its lift is asked for within a factor of two
    alone, and flights tell how the pairs turn.
    """
    body, estimated = vehicle.declared, bool(set(UNKNOWN) & set(vehicle.rotors.sources.values()))
    if differs := vehicle_differs(logs, body):
        return differs
    found: list[OtherVehicle | NotJudged] = []
    for log in logs:
        frame = flight_frame([log], body, vehicle.rotors)
        differs = other_vehicle(frame, [log])
        found += [d for d in differs if not (estimated and d.check == "lift" and _near(d.found))]
        found += [r for r in lacking(frame) if not (estimated and r.premise == "rotation")]
    return (*found, *damage(logs))


def _near(ratio: float) -> bool:
    return 1 / RESPONSE < ratio < RESPONSE


def update_hangs_on(update: Update, logs: Sequence[Samples], vehicle: Vehicle) -> tuple[NotJudged, ...]:
    """Premises that put a load in hover outside the interval that the flights give it."""
    found: dict[str, NotJudged] = {}
    for moved in moves(vehicle.declared):
        if moved.premise in found:
            continue
        other = coefficients_from_flights(logs, moved.airframe, vehicle.rotors)
        for name, (_, _, value, sd) in update.loads.items():
            now = other.loads[name][2]
            if abs(now - value) > NORMAL_95 * sd:
                unit = name.rpartition("_")[2].replace("Nm", "N m")
                load = name.replace(".", " ").rpartition("_")[0]
                was = f"{value:.3g} +/- {NORMAL_95 * sd:.2g}"
                why = f"{moved.words} {load} is {now:.3g} {unit} in place of {was}"
                found[moved.premise] = not_judged(moved.premise, why)
                break
    return tuple(found.values())


def _words(found: Health) -> str:
    """The verdict and the rotor that it names."""
    return found.verdict if found.verdict == "sound" else f"{found.verdict}, rotor {found.suspects[0].rotor}"
