"""Why flights can update no rotor model of a vehicle, and the premises that an update hangs on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from coaxlink.channels.flight import flight_frame, reduce_columns
from coaxlink.channels.logged_speeds import has_speeds
from coaxlink.constants import NORMAL_95, NORMAL_999
from coaxlink.data.samples import Samples
from coaxlink.frames import FLIGHT_CHANNELS, FLIGHT_UNITS, Array, FlightFrame
from coaxlink.health.premises import blind_reasons
from coaxlink.health.turning import apart, speed_ratios, turning_words
from coaxlink.instruments.flight.flown_log import FlownLog
from coaxlink.instruments.flight.inputs import Inputs
from coaxlink.instruments.flight.speeds import changed_speed
from coaxlink.premises import NotJudged, OtherVehicle, damage, lacking, moves, not_judged, other_vehicle
from coaxlink.premises.moves import HOW, MEASURES, UNKNOWN
from coaxlink.premises.same_vehicle import RESPONSE
from coaxlink.residual.refine import vehicle_differs
from coaxlink.rotor_update.coefficients import Update, by_speed, coefficients_from_flights
from coaxlink.vehicle import Vehicle

FELT = 0.01  # of the reference load, judgement: less moves no load in hover by its interval
RPM_FIT = "by a log whose rpm go with the commands, or without its rpm columns"
WHICH = " (coaxlink health tells which rotor is weak)"
OFF_OR_FAILS = "the ESC's reading is off, or the motor fails"
SEVERAL = 2.0  # times, judgement: what an error adds is then more than all else (squares add up)


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
        return tuple(blind_reasons(inputs))
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
    if changed := changed_speed(FlownLog.of(log, [r.number for r in body.rotors])):
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
