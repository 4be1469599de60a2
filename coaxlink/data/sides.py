"""Upper and lower of a foreign file: by its headings' words, by `upper`, by the data, or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.averaging import thinned
from coaxlink.data.cleaning import cleaned
from coaxlink.data.roles import Rotor, RotorsUnclear, lower_rotor
from coaxlink.data.rotors import SAID, Found
from coaxlink.data.samples import Samples
from coaxlink.data.units import QUANTITIES
from coaxlink.errors import InputError

ONE = ("one rotor: a model of a rotor alone; `join` puts it together with a map of the pair",)
SHAFT = "shaft_power_W"  # a column that serves to check units and goes again


def with_sides(samples: Samples, rotors: list[Found], upper: str | None) -> tuple[Samples, dict[str, Found]]:
    """The recognised rotors' columns under our names, cleaned; and which rotor went to which side.

    Raises InputError, RotorsUnclear.
    """
    sides, notes = _decided(samples, rotors, upper)
    found = cleaned(_placed(samples, sides))
    found = replace(found, notes=(*notes, *found.notes))  # which rotor is which is said first
    return replace(found, upper_label=_called(sides["upper"]) if len(sides) == 2 and notes else ""), sides


def _decided(
    samples: Samples, rotors: list[Found], upper: str | None
) -> tuple[dict[str, Found], tuple[str, ...]]:
    if len(rotors) < 2:
        if upper is not None and rotors and upper.casefold() != rotors[0].label:
            raise InputError("`upper`", "", f"one rotor is in the file, '{upper}' is not its label")
        return {r.label if r.label in SAID else "upper": r for r in rotors}, ONE[: len(rotors)]
    first, second = rotors
    if upper is not None:
        wanted = upper.casefold()
        if wanted not in (first.label, second.label):
            names = f"{_called(first)} or {_called(second)}"
            raise InputError("`upper`", "", f"{names} is expected, found '{upper}'")
        if wanted == second.label:
            first, second = second, first
        note = f"'{_called(first)}' is the upper rotor, as `upper` says"
        return {"upper": first, "lower": second}, (note,)
    if {first.label, second.label} == set(SAID):
        return {r.label: r for r in rotors}, ()
    return _inferred_from_data(samples, first, second)


def _inferred_from_data(
    samples: Samples, first: Found, second: Found
) -> tuple[dict[str, Found], tuple[str, ...]]:
    trial = cleaned(thinned(_placed(samples, {"upper": first, "lower": second})))
    names = (_called(first), _called(second))
    driven = [_driven(trial, side) for side in SAID]
    if driven[0] != driven[1]:
        alone, still = (first, second) if driven[0] else (second, first)
        note = f"only '{_called(alone)}' turns: a rotor alone; what '{_called(still)}' reads is left out"
        return {"upper": alone}, (note,)
    verdict = lower_rotor(rotor_of(trial, "upper"), rotor_of(trial, "lower"))
    evidence = verdict.said(*names)
    if verdict.lower is None:
        raise RotorsUnclear(samples.source, names, evidence)
    upper, lower = (first, second) if verdict.lower == 1 else (second, first)
    note = f"'{_called(upper)}' is the upper rotor, by the data: {'; '.join(evidence)}"
    return {"upper": upper, "lower": lower}, (note,)


def _driven(samples: Samples, side: str) -> bool:
    names = [f"{side}_rpm"] if samples.has(f"{side}_rpm") else [f"{side}_throttle"]
    return any(samples.has(n) and bool(np.any(samples[n] > 0)) for n in names)


def _called(rotor: Found) -> str:
    """A rotor's label as a person writes it."""
    return rotor.label.upper() if len(rotor.label) == 1 else rotor.label or "the unnamed one"


def exchanged(samples: Samples) -> tuple[str, ...] | None:
    """What speaks for the upper and lower columns being each other's or another's, or None."""
    if not all(samples.has(f"{s}_thrust_N") and _driven(samples, s) for s in SAID):
        return None
    few = thinned(samples)
    verdict = lower_rotor(rotor_of(few, "upper"), rotor_of(few, "lower"))
    if verdict.lower != 0 and not verdict.odd:
        return None
    return verdict.said("the upper rotor's columns", "the lower one's")


def rotor_of(samples: Samples, side: str) -> Rotor:
    """A rotor's columns for `lower_rotor`: rpm, or the throttle where no rpm was measured."""

    def get(name: str) -> NDArray[np.float64] | None:
        return samples[f"{side}_{name}"] if samples.has(f"{side}_{name}") else None

    both = all(samples.has(f"{s}_rpm") for s in ("upper", "lower"))
    speed = get("rpm") if both else get("throttle")
    power = get("power_W")
    current, voltage = get("current_A"), get("voltage_V")
    if voltage is None and samples.has("voltage_V"):
        voltage = samples["voltage_V"]
    if power is None and current is not None and voltage is not None:
        power = current * voltage
    return Rotor(np.zeros(samples.rows) if speed is None else speed, get("thrust_N"), get("torque_Nm"), power)


def _placed(samples: Samples, rotors: Mapping[str, Found]) -> Samples:
    columns = dict(samples.columns)
    notes = []
    for side, rotor in rotors.items():
        sources = []
        for quantity, values in rotor.columns.items():
            name = f"{side}_{QUANTITIES[quantity][0]}"
            columns.setdefault(name, values)
            if rotor.shaft_W is not None:
                columns[f"{side}_{SHAFT}"] = rotor.shaft_W
            said = " (PWM - 1000) / 1000, 0..1" if _is_pwm(rotor, quantity) else ""
            sources.append(f"{name} from '{rotor.headings[quantity].text}'{said}")
        notes.append("; ".join(sources))
    return replace(samples, columns=columns).with_notes(*notes)


def _is_pwm(rotor: Found, quantity: str) -> bool:
    unit = rotor.headings[quantity].unit
    return quantity == "throttle" and unit is not None and unit.name == "us"
