"""Upper and lower of a foreign file: by its headings' words, by `upper`, by the data, or not at all."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.aliases import QUANTITIES, SIDES
from coaxlink.data.averaging import thinned
from coaxlink.data.cleaning import cleaned, drive_of
from coaxlink.data.rotors import FoundRotor
from coaxlink.data.samples import Samples
from coaxlink.data.unit_check import SHAFT
from coaxlink.data.wake import RotorLog, WakeEvidence, lower_rotor
from coaxlink.errors import InputError

ONE = ("one rotor: a model of a rotor alone; `join` puts it together with a map of the pair",)


class RotorsUnclear(InputError):
    """Two rotors whose headings do not say which is the upper, and data that do not either."""

    def __init__(self, source: object, labels: tuple[str, str], evidence: tuple[str, ...]) -> None:
        self.labels, self.evidence = labels, evidence
        found = "; ".join(evidence) or "the rows do not show it"
        super().__init__(
            str(source),
            f"rotors {labels[0]} and {labels[1]}",
            f"which is the upper one? Say `upper` {labels[0]} or `upper` {labels[1]} ({found})",
        )


def with_sides(
    samples: Samples, rotors: list[FoundRotor], upper: str | None
) -> tuple[Samples, dict[str, FoundRotor]]:
    """The recognised rotors' columns under our names, cleaned; and which rotor went to which side.

    Raises InputError, RotorsUnclear.
    """
    sides, notes = _decided(samples, rotors, upper)
    found = cleaned(_placed(samples, sides))
    found = replace(found, notes=(*notes, *found.notes))  # which rotor is which is reported first
    return replace(found, upper_label=_called(sides["upper"]) if len(sides) == 2 and notes else ""), sides


def exchanged_as_stated(samples: Samples, upper: str) -> Samples:
    """Our own columns when somebody says which of them is the upper rotor. Raises InputError."""
    if upper.casefold() not in SIDES:
        raise InputError("`upper`", "", f"upper or lower is expected for these columns, found '{upper}'")
    if upper.casefold() == "upper":
        return samples
    turned = {"upper": "lower", "lower": "upper"}
    columns = {
        re.sub("^(upper|lower)(?=_)", lambda m: turned[m[1]], name): column
        for name, column in samples.columns.items()
    }
    return replace(samples, columns=columns).with_notes(
        "upper and lower columns exchanged, as `upper` lower says"
    )


def _decided(
    samples: Samples, rotors: list[FoundRotor], upper: str | None
) -> tuple[dict[str, FoundRotor], tuple[str, ...]]:
    if len(rotors) < 2:
        if upper is not None and rotors and upper.casefold() != rotors[0].label:
            raise InputError("`upper`", "", f"one rotor is in the file, '{upper}' is not its label")
        return {r.label if r.label in SIDES else "upper": r for r in rotors}, ONE[: len(rotors)]
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
    if {first.label, second.label} == set(SIDES):
        return {r.label: r for r in rotors}, ()
    return _inferred_from_data(samples, first, second)


def _inferred_from_data(
    samples: Samples, first: FoundRotor, second: FoundRotor
) -> tuple[dict[str, FoundRotor], tuple[str, ...]]:
    trial = cleaned(thinned(_placed(samples, {"upper": first, "lower": second})))
    names = (_called(first), _called(second))
    driven = [_is_driven(trial, side) for side in SIDES]
    if driven[0] != driven[1]:
        alone, still = (first, second) if driven[0] else (second, first)
        note = f"only '{_called(alone)}' turns: a rotor alone; what '{_called(still)}' reads is left out"
        return {"upper": alone}, (note,)
    evidence = _evidence(trial)
    words = evidence.words(*names)
    if evidence.lower is None:
        raise RotorsUnclear(samples.source, names, words)
    upper, lower = (first, second) if evidence.lower == 1 else (second, first)
    note = f"'{_called(upper)}' is the upper rotor, by the data: {'; '.join(words)}"
    return {"upper": upper, "lower": lower}, (note,)


def _is_driven(samples: Samples, side: str) -> bool:
    drive = drive_of(samples, side)
    return drive is not None and bool(np.any(samples[drive] > 0))


def _called(rotor: FoundRotor) -> str:
    """A rotor's label as a person writes it."""
    return rotor.label.upper() if len(rotor.label) == 1 else rotor.label or "the unnamed one"


def exchanged(samples: Samples) -> tuple[str, ...] | None:
    """What speaks for the upper and lower columns being each other's or another's, or None."""
    if not all(samples.has(f"{s}_thrust_N") and _is_driven(samples, s) for s in SIDES):
        return None
    evidence = _evidence(thinned(samples))
    if evidence.lower != 0 and not evidence.odd:
        return None
    return evidence.words("the upper rotor's columns", "the lower one's")


def _evidence(samples: Samples) -> WakeEvidence:
    """Which of our sides works in the other's wake; throttles for speeds where not both have rpm."""
    drive = "rpm" if all(samples.has(f"{s}_rpm") for s in SIDES) else "throttle"

    def column(name: str) -> NDArray[np.float64] | None:
        return samples[name] if samples.has(name) else None

    rotors = []
    for side in SIDES:
        speed = column(f"{side}_{drive}")
        power, current = column(f"{side}_power_W"), column(f"{side}_current_A")
        voltage = column(f"{side}_voltage_V" if samples.has(f"{side}_voltage_V") else "voltage_V")
        if power is None and current is not None and voltage is not None:
            power = current * voltage
        rotors.append(
            RotorLog(
                np.zeros(samples.rows) if speed is None else speed,
                column(f"{side}_thrust_N"),
                column(f"{side}_torque_Nm"),
                power,
            )
        )
    return lower_rotor(*rotors)


def _placed(samples: Samples, rotors: Mapping[str, FoundRotor]) -> Samples:
    columns = dict(samples.columns)
    notes = []
    for side, rotor in rotors.items():
        sources = []
        for quantity, values in rotor.columns.items():
            name, heading = f"{side}_{QUANTITIES[quantity].suffix}", rotor.headings[quantity]
            columns.setdefault(name, values)
            is_pulse = quantity == "throttle" and heading.unit is not None and heading.unit.name == "us"
            converted = " (PWM - 1000) / 1000, 0..1" if is_pulse else ""
            sources.append(f"{name} from '{heading.text}'{converted}")
        if rotor.shaft_W is not None:
            columns[f"{side}_{SHAFT}"] = rotor.shaft_W
        notes.append("; ".join(sources))
    return replace(samples, columns=columns).with_notes(*notes)
