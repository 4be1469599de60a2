"""A verdict on rotors that goes no further than its premises."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from coaxlink.constants import NORMAL_95, NORMAL_999
from coaxlink.data.samples import PREMISES, Samples
from coaxlink.frames import FLIGHT_CHANNELS, FLIGHT_UNITS, Array, FlightFrame
from coaxlink.health.coefficients import Update, by_speed, coefficients_from_flights
from coaxlink.health.columns import reduced
from coaxlink.health.judge import Health, judge
from coaxlink.health.priors import GROUND, WATCH
from coaxlink.health.turning import apart, speed_ratios, turning_words
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
from coaxlink.premises.moves import HOW, MEASURES, UNKNOWN
from coaxlink.premises.same_vehicle import RESPONSE
from coaxlink.residual.channels.flight import flight_frame, flown, reduce_columns
from coaxlink.residual.channels.logged_speeds import has_speeds
from coaxlink.residual.faults.inputs import Inputs, checked
from coaxlink.residual.faults.speeds_apart import changed_speed
from coaxlink.residual.refine import vehicle_differs
from coaxlink.residual.result import Suspect
from coaxlink.vehicle import Vehicle

FELT = 0.01  # of the reference load, judgement: less moves no load in hover by its interval
RPM_FIT = "by a log whose rpm go with the commands, or without its rpm columns"
WHICH = " (coaxlink health tells which rotor is weak)"
OFF_OR_FAILS = "the ESC's reading is off, or the motor fails"
SEVERAL = 2.0  # times, judgement: what an error adds is then more than all else (squares add up)


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
        return Health.withheld((), cannot_judge=list(_blind(inputs)))
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


def _blind(inputs: Inputs) -> Iterator[NotJudged]:
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


def flown_by(inputs: Inputs, vehicle: Vehicle) -> tuple[OtherVehicle | NotJudged, ...]:
    """Why these flights can update no rotor model of this vehicle; empty where they can. Raises InputError.

    An estimated prior may be off by more than a measured model: its lift is asked for within a factor of two
    alone, and flights tell how the pairs turn.
    """
    body, estimated = vehicle.declared, bool(set(UNKNOWN) & set(vehicle.rotors.sources.values()))
    logs = inputs.logs
    if differs := vehicle_differs(logs, body):
        return differs
    if inputs.blind:
        return tuple(_blind(inputs))
    found: list[OtherVehicle | NotJudged] = []
    for log in logs:
        frame = flight_frame([log], body, vehicle.rotors)
        differs = other_vehicle(frame, [log])
        found += [d for d in differs if not (estimated and d.check == "lift" and _near(d.found))]
        found += [r for r in lacking(frame) if not (estimated and r.premise == "rotation")]
        found += () if found else tuple(speeds_contradict(frame, log, vehicle))
    return (*found, *damage(logs))


def speeds_contradict(frame: FlightFrame, log: Samples, vehicle: Vehicle) -> Iterator[NotJudged]:
    """Speeds of the ESCs that no motors of one type have by their commands, or by which the model is much
    further off than by the commands: whatever the rotors do, what they turned at explains it better than what
    they were asked for."""
    body, model = vehicle.declared, vehicle.rotors
    if not has_speeds(log, body):
        return
    if off := apart(speed_ratios(log, body, model)):
        yield NotJudged("rpm", RPM_FIT + WHICH, f"{turning_words(off)}: {OFF_OR_FAILS}")
        return
    if changed := changed_speed(log, [r.number for r in body.rotors]):
        name, moment = changed
        why = f"from {moment:.1f} s on it goes otherwise with its command: {OFF_OR_FAILS}"
        yield NotJudged(name, RPM_FIT + WHICH, why)
        return
    turned = flight_frame([by_speed(log, body, model)], body, model.by_speed())
    turns, asked = _moves(turned), _moves(frame)
    wrong = np.where(turns > FELT * frame.reference, turns / asked, 0.0)
    k = int(np.argmax(wrong))
    if wrong[k] > SEVERAL:
        channel, unit = FLIGHT_CHANNELS[k].replace("_", " "), FLIGHT_UNITS[k]
        why = (
            f"{channel} of the model is {turns[k]:.2g} {unit} off by the ESCs' rpm, {asked[k]:.2g} {unit} by "
            "the commands: some rpm are none"
        )
        yield NotJudged("rpm", RPM_FIT, why)


def _moves(frame: FlightFrame) -> Array:
    """(6,) rms of the residual about its mean."""
    return np.asarray(np.std(reduce_columns(frame, frame.measured - frame.predicted), axis=0))


def _near(ratio: float) -> bool:
    return 1 / RESPONSE < ratio < RESPONSE


def beyond_prior(update: Update) -> Iterator[NotJudged]:
    """Loads in hover that the prior itself calls impossible (one in a thousand): flights can weigh a belief,
    and none that they contradict."""
    for name, (prior, prior_sd, value, _) in update.loads.items():
        if abs(value - prior) > NORMAL_999 * prior_sd:
            load, unit = _load_words(name)
            believed = f"{prior:.3g} +/- {NORMAL_95 * prior_sd:.2g}"
            why = (
                f"{load} in hover would be {value:.3g} {unit}, and the rotor file has {believed}: something "
                "else is in these flights (coaxlink health, refine), or the file is another rotor's"
            )
            yield NotJudged("rotor_model", f"{MEASURES['rotor_model']}; {HOW}", why)


def _load_words(name: str) -> tuple[str, str]:
    """ "upper.thrust_N" in words, and its unit."""
    return name.replace(".", " ").rpartition("_")[0], name.rpartition("_")[2].replace("Nm", "N m")


def update_hangs_on(update: Update, logs: Sequence[Samples], vehicle: Vehicle) -> tuple[NotJudged, ...]:
    """Premises that put a load in hover outside the interval that the flights give it, or it outside its
    prior."""
    if beyond := tuple(beyond_prior(update)):
        return beyond
    found: dict[str, NotJudged] = {}
    for moved in moves(vehicle.declared):
        if moved.premise in found:
            continue
        other = coefficients_from_flights(logs, moved.airframe, vehicle.rotors)
        for name, (_, _, value, sd) in update.loads.items():
            now = other.loads[name][2]
            if abs(now - value) > NORMAL_95 * sd:
                load, unit = _load_words(name)
                was = f"{value:.3g} +/- {NORMAL_95 * sd:.2g}"
                why = f"{moved.words} {load} is {now:.3g} {unit} in place of {was}"
                found[moved.premise] = not_judged(moved.premise, why)
                break
    return tuple(found.values())


def _words(found: Health) -> str:
    """The verdict and the rotor that it names."""
    return found.verdict if found.verdict == "sound" else f"{found.verdict}, rotor {found.suspects[0].rotor}"
