"""The demo in sentences: what coaxlink is worth on these flights, and what was hidden and found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from coaxlink.report.pictures.label import channel_words
from coaxlink.report.refine import fall, verdict

if TYPE_CHECKING:
    from pathlib import Path

    from coaxlink.residual.result import Refinement
    from coaxlink.studies.demo import DemoResult
    from coaxlink.studies.flight_errors import FlightErrors

FITTED, STANDARD = "fitted", "standard"

TERMS = {
    "mixer, table": "What turns the demanded wrench into motor commands; a table is a mixer that the "
    "autopilot itself holds in its parameters. Mixing live: a computer beside the autopilot does it instead.",
    "wrench": "Thrust (N) and the torques in roll, pitch and yaw (N m), all four together.",
    "allocation error": "The wrench that a mixer means its commands to give, less the one that moved the "
    "vehicle (mass times acceleration, inertia times angular acceleration); mean |error| over the flight.",
    "gain, after gain": "Gain: how much came for one of what was meant, the best constant by least squares. "
    "The autopilot's integrators learn a constant gain by themselves; the rest is the error "
    "that they cannot take away.",
    "power": "Mean of voltage times current of the battery over the flight, as the vehicle reports them.",
    "height": "Mean |height demanded - height flown|, m.",
    "forward, rightward, downward force": "Forces on the body in its own axes, N; roll, pitch and yaw "
    "torque, N m. In the JSON they are force_x, force_y, force_z and torque_x, torque_y, torque_z.",
    "residual": "What was measured less what the model says: what the model does not explain.",
    "effect": "A cause with known physics that the rotor model lacks: drag, ground effect, a weak rotor.",
    "held out": "Judged on stretches of data that the fit did not use, so that more terms alone cannot make "
    "it look better.",
    "noise floor": "What the sensors' noise alone would leave: no model can be better.",
    "RMSE, NRMSE, R": "Root of the mean squared error; the same over the range (max - min) of what was "
    "measured; correlation of measured and modelled.",
    "95 %": "The interval that holds the true value in 95 of 100 such experiments.",
    "SRM, CPCM, R-CRM, CRM": "Rotor models from simple to full, u being speed over full speed. SRM: thrust "
    "k u\N{SUPERSCRIPT TWO} for every rotor. CPCM: the lower rotor loses a constant share. R-CRM: the upper "
    "rotor's speed squared takes from the lower one's thrust. CRM: a polynomial in both speeds.",
    "LASSO": "A fit in which terms pay for being there, so that only those stay that the data need.",
    "standard, fitted, exact": "Tables made of the SRM, and fitted to the whole CRM; "
    "the exact law inverts the CRM and can only be mixed live.",
}


def answer(result: DemoResult) -> list[str]:
    """The demo in four sentences: what it was worth and cost, what was hidden, what finding it took off."""
    sentences = [_power(result.flights[FITTED], result.flights[STANDARD])]
    fitted, standard = result.worths.named(FITTED), result.worths.named(STANDARD)
    if fitted is not None and standard is not None:
        yaw, before = fitted.limits[2].moment_Nm, standard.limits[2].moment_Nm
        sentences.append(
            f"It gives up {1.0 - fitted.ceiling_N / standard.ceiling_N:.0%} of the ceiling "
            f"({fitted.ceiling_N:.0f} N for {standard.ceiling_N:.0f} N) and {1.0 - yaw / before:.0%} of the "
            f"yaw authority ({yaw:.1f} N m for {before:.1f} N m)."
        )
    return [*sentences, *_found(result.refinement)]


def read_on(page: Path, out: Path) -> list[str]:
    """Where to go from here."""
    return [
        f"Look:      {page}",
        f"A flight:  coaxlink report {out}/hidden.tlog --airframe X8.toml (coaxlink examples x8_demo.toml)",
        "Learn:     docs/tutorial.md, half an hour, no hardware",
        "Your own:  coaxlink init makes the vehicle file, coaxlink identify STAND.csv the rotors",
    ]


def _found(found: Refinement) -> list[str]:
    """What was hidden in the last flight, and what is left of the error."""
    if not found.effects:
        return [f"One thing was hidden in the last flight; from its log, {verdict(found)}."]
    named = " and ".join(e.name.replace("_", " ") for e in found.effects)
    touched = {c for e in found.effects for c in e.channels} & found.channels.keys()
    worst = max(
        touched, key=lambda c: found.channels[c].rmse_before / found.channels[c].noise_floor, default=""
    )
    lines = [f"Hidden in the last flight, and found from its log alone: {named}."]
    if worst:
        e = found.channels[worst]
        lines.append(f"With it in the model, the error of the {channel_words(worst)} falls from {fall(e)}.")
    return lines


def flown(flights: Mapping[str, FlightErrors]) -> list[str]:
    """What the fitted table is worth on these flights, the first sentence alone saying it in numbers."""
    fitted, standard = flights[FITTED], flights[STANDARD]
    return [_power(fitted, standard), _height(fitted, standard), _left(fitted, standard)]


def story(result: DemoResult) -> list[str]:
    """The flight in the world that hides something: what was seen, what was found, what it explains."""
    there, here = result.hidden.allocation, result.flights[FITTED].allocation
    found = result.refinement
    lines = [
        "Then the same fitted table flew where one thing is true that the rotor model does not know: "
        f"mean |meant - delivered| {there.thrust_error_N:.2f} N of thrust and "
        f"{max(there.torque_error_Nm):.3f} N m of torque ({here.thrust_error_N:.2f} N and "
        f"{max(here.torque_error_Nm):.3f} N m where nothing is hidden; "
        "forces to the side are no part of it).",
        _answer(found),
    ]
    if found.effects:
        touched = {c for e in found.effects for c in e.channels} & found.channels.keys()
        falls = sorted(touched, key=lambda c: found.channels[c].rmse_after / found.channels[c].rmse_before)
        sentences = [f"{channel_words(c)} from {fall(found.channels[c])}" for c in falls[:2]]
        lines.append(f"Added to the model, the held-out error falls: {'; '.join(sentences)}.")
    return lines


def _answer(found: Refinement) -> str:
    if not found.effects:
        return f"By the log of that flight alone, {verdict(found)}."
    return f"From the log of that flight alone coaxlink found {' and '.join(e.name for e in found.effects)}."


def _power(fitted: FlightErrors, standard: FlightErrors) -> str:
    if fitted.power_W is None or standard.power_W is None:
        return "The fitted table flew; the vehicle did not report the power that it needed."
    ratio = fitted.power_W / standard.power_W
    if abs(1.0 - ratio) < 5e-4:  # a figure that is shown as 0.0 %
        return f"The fitted table flew the same path on the same battery power ({fitted.power_W:.0f} W)."
    less = "less" if ratio < 1.0 else "more"
    return (
        f"The fitted table flew the same path on {abs(1.0 - ratio):.1%} {less} battery power than the "
        f"standard one ({fitted.power_W:.0f} W for {standard.power_W:.0f} W): "
        f"{1.0 / ratio - 1.0:+.1%} time in the air."
    )


def _height(fitted: FlightErrors, standard: FlightErrors) -> str:
    ours, theirs = (100.0 * f.position_error_m[2] for f in (fitted, standard))
    lower, before = (_lower_share(f) for f in (fitted, standard))
    return (
        f"Height was held to {ours:.1f} cm (standard: {theirs:.1f} cm); the lower rotors carried "
        f"{lower:.0%} of the thrust instead of {before:.0%}."
    )


def _left(fitted: FlightErrors, standard: FlightErrors) -> str:
    ours, theirs = fitted.allocation, standard.allocation
    return (
        f"Thrust came out at {theirs.gain[0]:.2f} of what the standard table means and at "
        f"{ours.gain[0]:.2f} of what the fitted one does. Integrators learn such a constant gain; after the "
        f"best one {theirs.after_gain[0]:.2f} N of error are left with the standard table and "
        f"{ours.after_gain[0]:.2f} N with the fitted one (the sensors' noise alone: {ours.floor[0]:.2f} N)."
    )


def _lower_share(flight: FlightErrors) -> float:
    split = flight.allocation.split
    return sum(s.lower_N for s in split) / sum(s.lower_N + s.upper_N for s in split)
