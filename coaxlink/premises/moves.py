"""Numbers of a vehicle moved within what their source allows: does the answer stand?

An estimate of the inertia is good to a factor of two (`setup.inertia_estimate`). A lag that nobody gave may
be anything from none to that of a large propeller on a slow drive (80 ms; 18 to 28 in: 20 to 80 ms). A mass
that somebody says, and that no scale read on this day, is good to 3 %: a strap, a camera, another pack. What
was measured is not moved.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.frames import FlightFrame
from coaxlink.premises.answer import NotJudged

INERTIA_FACTORS = (0.5, 2.0)  # of an estimate
LAGS_S = (0.0, 0.04, 0.08)  # of a lag that nobody gave
MASS_FACTORS = (0.97, 1.03)  # of a declared one
UNKNOWN = ("estimated", "default")  # nobody's word
MEASURES = {
    "mass_kg": "the mass (a scale under the vehicle as it flies)",
    "inertia_kg_m2": "the inertia (five minutes as a bifilar pendulum)",
    "motor_lag_s": "the motors' lag (a step of one motor in a log)",
    "rotor_model": "the rotors (a stand, or coaxlink identify FLIGHT)",
}
HOW = "docs/howto/measure.md"


@dataclass(frozen=True)
class Moved:
    """The vehicle with one number otherwise."""

    premise: str  # key of the airframe file
    words: str  # "the inertia twice the file's"
    airframe: Airframe


def moves(airframe: Airframe) -> Iterator[Moved]:
    """The vehicle with every number that was not measured at the ends of what its source allows.

    >>> from coaxlink.airframe import load_airframe
    >>> from coaxlink.files import example
    >>> [m.words for m in moves(load_airframe(example("x8_paper.toml")))]
    ['with 0.97 times the mass', 'with 1.03 times the mass']
    """
    if airframe.source_of("inertia_kg_m2") in UNKNOWN:
        for factor in INERTIA_FACTORS:
            x, y, z = (factor * value for value in airframe.inertia_kg_m2)
            words = f"with {factor:g} times the inertia"
            yield Moved("inertia_kg_m2", words, replace(airframe, inertia_kg_m2=(x, y, z)))
    if airframe.source_of("motor_lag_s") in UNKNOWN:
        for lag in LAGS_S:
            if lag != airframe.motor_lag_s:
                words = f"with a lag of {1000 * lag:.0f} ms"
                yield Moved("motor_lag_s", words, replace(airframe, motor_lag_s=lag))
    if airframe.source_of("mass_kg") != "measured":
        for factor in MASS_FACTORS:
            moved = replace(airframe, mass_kg=factor * airframe.mass_kg)
            yield Moved("mass_kg", f"with {factor:g} times the mass", moved)


def as_if(frame: FlightFrame, airframe: Airframe) -> FlightFrame:
    """The flight as it would look if the vehicle had this mass, inertia and lag; nothing is read again."""
    inertia = np.asarray(airframe.inertia_kg_m2)
    moment = inertia * frame.angular_acceleration + np.cross(frame.rates, inertia * frame.rates)
    measured = np.concatenate([airframe.mass_kg * frame.specific_force, moment], axis=1)
    moved = replace(frame, airframe=airframe, measured=measured)
    if airframe.motor_lag_s == frame.airframe.motor_lag_s:
        return moved
    return moved.turning_at(frame.filtered(frame.commands, airframe.motor_lag_s))


def not_judged(premise: str, why: str) -> NotJudged:
    """The answer hangs on a number of the vehicle."""
    return NotJudged(premise, f"{MEASURES[premise]}; {HOW}", why)


def guesses(airframe: Airframe) -> Iterator[str]:
    """What of a vehicle nobody gave, and what makes it measured."""
    for key, measure in MEASURES.items():
        source = airframe.sources.get(key)
        if source in UNKNOWN:
            yield f'{key} is {source}: measure {measure}, then say {key} = "measured" in [sources] ({HOW})'
