"""The rotors of a foreign file: which column belongs to which, in which unit; none may vanish."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.columns_map import line_for
from coaxlink.data.headings import Heading, UnknownUnitError, letters_name_rotors, recognise, words_of
from coaxlink.data.sense import Reading, possible
from coaxlink.data.table import TextTable
from coaxlink.data.units import QUANTITIES, Unit, find_unit, unit_names
from coaxlink.errors import InputError

Array = NDArray[np.float64]
OF_A_ROTOR = ("thrust", "torque", "speed", "throttle")
GUESSED = ("thrust", "torque", "speed")
TWINS = 0.05  # two columns of one quantity and rotor agree within this share
SAID = ("upper", "lower")
HIGH, SLOW = 0.7, 0.1  # of a rotor's fastest row; of the other rotor's range


@dataclass(frozen=True)
class Found:
    """One rotor of a file: its columns in our units by quantity, and the headings they came from."""

    label: str
    columns: Mapping[str, Array]
    headings: Mapping[str, Heading]
    shaft_W: Array | None = None


@dataclass
class Sorted:
    """All that was recognised in a file."""

    rotors: list[Found]
    shared: dict[str, Array] = field(default_factory=dict)  # our names: time_s, voltage_V, current_A
    used: set[int] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)


def sort_columns(
    table: TextTable, skip: set[int], poles: int | None = None, diameter_m: float | None = None
) -> Sorted:
    """Rotors and shared columns of a foreign table, `skip` left alone.

    Raises InputError: a unit that is not known, three rotors, two columns that contradict each other.
    """
    headings = _recognised(table, skip)
    groups = _by_rotor(table, headings)
    out = Sorted([])
    chosen: dict[str, dict[str, Heading]] = {}
    shafts: dict[str, Heading] = {}
    for label, found in groups.items():
        for heading in found:
            out.used.add(heading.index)
        powers = [h for h in found if not h.shaft]
        shafts.update((label, h) for h in found if h.shaft)
        chosen[label] = {
            q: _preferred(table, [h for h in powers if h.quantity == q], out.notes)
            for q in dict.fromkeys(h.quantity for h in powers)
        }
    for found_of in chosen.values():
        if "throttle" in found_of:
            heading = found_of["throttle"]
            found_of["throttle"] = replace(heading, unit=_throttle_unit(table, heading))
    alone = [label for label in chosen if label is not _SHARED]
    units = _units(table, {k: v for k, v in chosen.items() if k is not _SHARED}, shafts, poles, diameter_m)
    for label in alone:
        columns = {
            q: _values(table, h, units.get((label, q)) or h.unit, poles) for q, h in chosen[label].items()
        }
        shaft = shafts.get(label)
        out.rotors.append(
            Found(label, columns, chosen[label], None if shaft is None else table.numbers(shaft.index))
        )
        for q, h in chosen[label].items():
            if (label, q) in units:
                out.notes.append(
                    f"'{h.text}' taken in {units[label, q].name}: no other unit makes a propeller of it"
                )
    for q, h in chosen.get(_SHARED, {}).items():
        if q in OF_A_ROTOR:
            out.notes.append(f"'{h.text}' left out: of which rotor it is does not stand there")
        else:
            out.shared[QUANTITIES[q][0]] = _values(table, h, h.unit, poles)
            out.notes.append(f"{QUANTITIES[q][0]} from '{h.text}'")
    return out


_SHARED = "\0"  # columns that belong to no single rotor


def _recognised(table: TextTable, skip: set[int]) -> list[Heading]:
    free = [i for i in range(len(table.headings)) if i not in skip]
    lettered = letters_name_rotors(table.headings[i] for i in free)
    found = []
    for i in free:
        text = table.headings[i]
        if not text or table.column_is_empty(i):
            continue
        try:
            heading = recognise(i, text, lettered, table.units[i])
        except UnknownUnitError as error:
            side = next((s for s in SAID if s in words_of(text)), "upper")
            name, unit = f"{side}_{QUANTITIES[error.quantity][0]}", unit_names(error.quantity)[0]
            problem = f"{error}; a map states it (`columns`): {line_for(name, text, unit)}"
            raise InputError(table.source, f"line {table.heading_line}, column {text!r}", problem) from error
        if heading is not None:
            found.append(heading)
    letters = {h.label for h in found}
    names = {"u": "upper", "l": "lower"} if {"u", "l"} <= letters else {"l": "left", "r": "right"}
    return [_renamed(h, names.get(h.label, h.label)) for h in found]


def _renamed(heading: Heading, label: str) -> Heading:
    return replace(heading, label=label)


def _by_rotor(table: TextTable, headings: list[Heading]) -> dict[str, list[Heading]]:
    """Headings by their rotor; one that names none belongs to the rotor that lacks its quantity."""
    labels = list(dict.fromkeys(h.label for h in headings if h.label and h.quantity in OF_A_ROTOR))
    bare = {h.quantity for h in headings if not h.label and h.quantity in OF_A_ROTOR}
    if len(labels) == 1:
        named = {h.quantity for h in headings if h.label == labels[0]}
        if bare & named & {"thrust", "torque", "speed"}:
            labels.append("")  # the other one has no name
    if len(labels) > 2:
        raise InputError(
            table.source,
            f"line {table.heading_line}",
            f"{len(labels)} rotors ({', '.join(labels)}), a pair has two: name its columns (`columns`)",
        )
    groups: dict[str, list[Heading]] = {label: [] for label in labels or [""]}
    for heading in headings:
        groups.setdefault(_owner(heading, headings, labels), []).append(heading)
    return groups


def _owner(heading: Heading, headings: list[Heading], labels: list[str]) -> str:
    if heading.quantity == "time":
        return _SHARED
    if heading.label:
        return heading.label if heading.label in labels else _SHARED
    if len(labels) < 2:
        return _SHARED if heading.quantity == "voltage" else (labels or [""])[0]
    if "" in labels:
        return _SHARED if heading.quantity == "voltage" else ""
    lacking = [
        label
        for label in labels
        if not any(h.label == label and h.quantity == heading.quantity for h in headings)
    ]
    return lacking[0] if len(lacking) == 1 and heading.quantity in OF_A_ROTOR else _SHARED


def _preferred(table: TextTable, headings: list[Heading], notes: list[str]) -> Heading:
    """Of several columns for one quantity: not all zero first, then SI, then the optical one, then the later.

    Raises InputError where two of them that read something contradict each other: they may be two rotors.
    """
    if len(headings) == 1:
        return headings[0]

    def rank(heading: Heading) -> tuple[bool, bool, bool, int]:
        values = table.numbers_or_none(heading.index)
        si = heading.unit is not None and heading.unit.scale == 1.0
        return values is not None and bool(np.any(values)), si, heading.optical, heading.index

    ranked = sorted(headings, key=rank, reverse=True)
    best = ranked[0]
    for other in ranked[1:]:
        if best.quantity in ("throttle", "voltage", "current", "power"):
            continue
        if best.unit is None or other.unit is None or best.unit.electrical or other.unit.electrical:
            continue
        a, b = table.numbers_or_none(best.index), table.numbers_or_none(other.index)
        if a is None or b is None or not np.any(b):
            continue
        a, b = best.unit.scale * a, other.unit.scale * b
        high = np.abs(a) > 0.5 * np.abs(a).max()
        if np.median(np.abs(a - b)[high]) <= TWINS * np.median(np.abs(a)[high]):
            continue
        if best.optical and not other.optical:
            notes.append(f"'{other.text}' left out: it contradicts '{best.text}'")
            continue
        raise InputError(
            table.source,
            f"line {table.heading_line}",
            f"'{best.text}' and '{other.text}' both read {best.quantity} and differ: two rotors, or one of "
            "them is wrong; name the right ones in a map (`columns`)",
        )
    return best


def _values(table: TextTable, heading: Heading, unit: Unit | None, poles: int | None) -> Array:
    values = table.numbers(heading.index)
    if unit is None:
        raise AssertionError(heading.text)
    if heading.quantity == "throttle":
        return np.clip(unit.scale * values + unit.offset, 0.0, 1.0)
    if unit.electrical and not poles:
        raise InputError(
            table.source,
            f"line {table.heading_line}, column {heading.text!r}",
            "electrical turns: say the motor's magnet poles with `poles` (14, 24, 28)",
        )
    return unit.factor(poles) * values + unit.offset


def _throttle_unit(table: TextTable, heading: Heading) -> Unit:
    """What a throttle is counted in shows in its range: us, per cent or a share. Raises InputError."""
    values, unit = table.numbers(heading.index), heading.unit
    top, low = float(np.max(values)), float(np.min(values[values > 0], initial=np.inf))
    fits = "us" if low >= 800 and top <= 2500 else "%" if 1.5 < top <= 100 else "1" if top <= 1.0 else None
    if fits == "us" and top <= 2500 and unit is None:
        unit = find_unit("throttle", "us")
    elif unit is None and fits and float(np.min(values)) >= 0:
        unit = find_unit("throttle", fits)
    wrong = unit is not None and {"us": fits != "us", "%": top > 105 or (fits == "1"), "1": top > 1.05}.get(
        unit.name, False
    )
    if unit is None or wrong:
        found = f"{float(np.min(values)):g} to {top:g}" + (f" in {unit.name}" if unit else "")
        raise InputError(
            table.source,
            f"line {table.heading_line}, column {heading.text!r}",
            f"a throttle in us (1000..2000), % or 0..1 is expected, found {found}; a map states it: "
            + line_for("upper_throttle", heading.text, "%"),
        )
    return unit


def _units(
    table: TextTable,
    chosen: Mapping[str, Mapping[str, Heading]],
    shafts: Mapping[str, Heading],
    poles: int | None,
    diameter_m: float | None,
) -> dict[tuple[str, str], Unit]:
    """(rotor, quantity): unit, for columns that do not say theirs, where just one makes propellers of all.

    Raises InputError naming the column, what it may be and the line to write.
    """
    open_columns = [
        (label, q)
        for label, found in chosen.items()
        for q, h in found.items()
        if q in GUESSED and h.unit is None
    ]
    if not open_columns:
        return {}
    quantities = list(dict.fromkeys(q for _, q in open_columns))
    raw = {
        label: {q: _raw(table, h, poles) for q, h in found.items() if h.quantity != "time"}
        for label, found in chosen.items()
    }
    shaft = {label: table.numbers(h.index) for label, h in shafts.items()}
    readings = dict(zip(raw, readings_of(list(raw.values()), [shaft.get(k) for k in raw]), strict=True))
    fitting = []
    for units in product(*(_each(q, poles) for q in quantities)):
        taken = dict(zip(quantities, units, strict=True))
        scaled = {
            label: reading.scaled(
                **{NAMES[q]: taken[q].factor(poles) for q in quantities if (label, q) in open_columns}
            )
            for label, reading in readings.items()
        }
        if all(r.thrust_N and (r.rpm or r.torque_Nm) for r in scaled.values()) and possible(
            scaled, diameter_m
        ):
            fitting.append(taken)
    if len(fitting) == 1:
        return {(label, q): fitting[0][q] for label, q in open_columns}
    label, quantity = open_columns[0]
    heading = chosen[label][quantity]
    may = list(dict.fromkeys(f[quantity].name for f in fitting))
    hint = f"; the readings fit {' or '.join(may)}" if may else ""
    name = f"{label if label in SAID else 'upper'}_{QUANTITIES[quantity][0]}"
    raise InputError(
        table.source,
        f"line {table.heading_line}, column {heading.text!r}",
        f"unit of a {quantity} expected ({', '.join(unit_names(quantity))}), found none{hint}; write it into "
        "the heading or a map (`columns`): " + line_for(name, heading.text, (may or unit_names(quantity))[0]),
    )


NAMES = {"thrust": "thrust_N", "torque": "torque_Nm", "speed": "rpm"}


def _each(quantity: str, poles: int | None) -> list[Unit]:
    """The units of a quantity, each once."""
    units = {u.name: u for u in QUANTITIES[quantity][1].values() if not u.electrical or poles}
    return [
        u for name, u in units.items() if name not in ("mN", "kN", "krpm", "deg/s", "N mm", "gf cm", "kgf m")
    ]


def _raw(table: TextTable, heading: Heading, poles: int | None) -> Array:
    if heading.unit is None and heading.quantity in GUESSED:
        return table.numbers(heading.index)
    return _values(table, heading, heading.unit, poles)


def readings_of(rotors: list[dict[str, Array]], shafts: list[Array | None]) -> Iterator[Reading]:
    """Each rotor at high speed, the other one as slow as the rows have it."""
    for i, own in enumerate(rotors):
        other = rotors[1 - i] if len(rotors) == 2 else {}
        yield _reading(own, other, shafts[i])


def _reading(own: Mapping[str, Array], other: Mapping[str, Array], shaft: Array | None) -> Reading:
    drive = own.get("speed", own.get("throttle"))
    if drive is None or not np.any(drive > 0):
        return Reading(None, None, None)
    rows = drive >= HIGH * drive.max()
    beside = other.get("speed", other.get("throttle"))
    in_wake = False
    if beside is not None and np.any(beside > 0):
        slowest = float(beside[rows].min())
        rows &= beside <= slowest + SLOW * float(beside.max())
        in_wake = slowest > SLOW * float(beside.max())
    n = float(np.median(drive[rows]))

    def at(values: Array | None, power: int) -> float | None:
        if values is None:
            return None
        found = float(np.median(values[rows] / (drive[rows] / n) ** power))
        return found if found != 0 else None

    power = own.get("power")
    if power is None and "current" in own and "voltage" in own:
        power = own["current"] * own["voltage"]
    rpm = n if "speed" in own else None
    return Reading(
        at(own.get("thrust"), 2), at(own.get("torque"), 2), rpm, at(power, 3), at(shaft, 3), in_wake
    )
