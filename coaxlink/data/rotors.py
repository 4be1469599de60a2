"""The rotors of a foreign file: which column belongs to which, in which unit; none may vanish."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.aliases import (
    LOADS_AND_SPEED,
    OF_A_ROTOR,
    PAIR,
    QUANTITIES,
    SIDES,
    Unit,
    find_unit,
    unit_names,
)
from coaxlink.data.columns_map import NEEDS_POLES
from coaxlink.data.headings import Heading, line_for, recognised
from coaxlink.data.propeller import possible, readings_of
from coaxlink.data.table import TextTable

Array = NDArray[np.float64]
SUMMED = ("thrust", "torque")  # what one cell under both rotors reads
TWINS = 0.05  # two columns of one quantity and rotor agree within this share
_SHARED = "\0"  # the label of columns that belong to no single rotor
# nobody logs a rotor in these without saying so
_NEVER_UNWRITTEN = ("mN", "kN", "krpm", "deg/s", "N mm", "gf cm", "kgf m")


@dataclass(frozen=True)
class FoundRotor:
    """One rotor of a file: its columns in our units by quantity, and the headings they came from."""

    label: str
    columns: Mapping[str, Array]
    headings: Mapping[str, Heading]
    shaft_W: Array | None = None


@dataclass
class FoundColumns:
    """All that was recognised in a file."""

    rotors: list[FoundRotor] = field(default_factory=list)
    shared: dict[str, Array] = field(default_factory=dict)  # our names: time_s, voltage_V, current_A
    used: set[int] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)


def find_rotors(
    table: TextTable, skip: set[int], poles: int | None = None, diameter_m: float | None = None
) -> FoundColumns:
    """Rotors and shared columns of a foreign table, `skip` left alone.

    Raises InputError: a unit that is not known, three rotors, two columns that contradict each other.
    """
    found_all = [
        h for h in recognised(table, skip) if h.quantity in LOADS_AND_SPEED or table.is_numbers(h.index)
    ]
    sums = [h for h in found_all if h.label == PAIR]
    groups = _by_rotor(table, [h for h in found_all if h.label != PAIR])
    out = FoundColumns()
    chosen: dict[str, dict[str, Heading]] = {}
    shafts: dict[str, Heading] = {}
    for label, of_label in groups.items():
        out.used |= {heading.index for heading in of_label}
        shafts.update((label, h) for h in of_label if h.shaft)
        by_quantity: dict[str, list[Heading]] = {}
        for heading in of_label:
            if not heading.shaft:
                by_quantity.setdefault(heading.quantity, []).append(heading)
        chosen[label] = {q: _preferred(table, h, out.notes) for q, h in by_quantity.items()}
    for found_of in chosen.values():
        if "throttle" in found_of:
            found_of["throttle"] = _with_unit_by_range(table, found_of["throttle"])
    shared = chosen.pop(_SHARED, {})
    for heading in (h for of in chosen.values() for h in of.values()):
        if heading.problem:
            raise heading.problem
    shaft_W = {label: table.numbers(h.index) for label, h in shafts.items() if label in chosen}
    guessed = _guessed_units(table, chosen, shaft_W, poles, diameter_m)
    for label, found_of in chosen.items():
        columns = {q: values_of(table, h, guessed.get((label, q)), poles) for q, h in found_of.items()}
        out.rotors.append(FoundRotor(label, columns, found_of, shaft_W.get(label)))
        for q, h in found_of.items():
            if (label, q) in guessed:
                out.notes.append(
                    f"'{h.text}' taken in {guessed[label, q].name}: no other unit makes a propeller of it"
                )
    _take_sums(table, out, [*sums, *(h for q, h in shared.items() if q in SUMMED)])
    for q, h in shared.items():
        if q in SUMMED:
            continue
        if q in OF_A_ROTOR:
            out.notes.append(f"'{h.text}' left out: of which rotor it is does not stand there")
        else:
            out.shared[h.suffix] = values_of(table, h, None, poles)
            out.notes.append(f"{h.suffix} from '{h.text}'")
    return out


def _take_sums(table: TextTable, out: FoundColumns, sums: list[Heading]) -> None:
    """What reads both rotors together: beside both of them it says nothing new, beside one the other, alone
    the pair."""
    for heading in sums:
        out.used.add(heading.index)
        q = heading.quantity
        own = [rotor for rotor in out.rotors if q in rotor.columns]
        if heading.unit is None:
            line = line_for(f"{PAIR}_{heading.suffix}", heading.text, unit_names(q)[0])
            why = (
                f"no unit of a {q} stands there; if it is of both rotors a map states it (`columns`): {line}"
            )
            if q == "thrust" and not own:
                raise table.heading_error(heading.text, why)
            out.notes.append(f"'{heading.text}' left out: {why}")
            continue
        if own and table.numbers_or_none(heading.index) is None:
            out.notes.append(f"'{heading.text}' left out: not numbers throughout")
            continue
        total = values_of(table, heading, None, None)
        if len(own) == 2:
            a, b = (rotor.columns[q] for rotor in own)
            off = min(float(np.median(np.abs(total - x))) for x in (a + b, a - b, b - a))
            is_sum = off <= TWINS * float(np.median(np.abs(a) + np.abs(b)))
            what = "the rotors' own columns added" if is_sum else "not what the rotors' own columns add up to"
            out.notes.append(f"'{heading.text}' left out: {what}")
        elif len(out.rotors) == 1 and not own:
            _give(out, 0, heading, total)
        elif len(own) == 1 and q == "thrust" and len(out.rotors) == 2:
            other = 1 - out.rotors.index(own[0])
            _give(out, other, heading, total - own[0].columns[q])
            reported = out.rotors[other].label or "the other"
            out.notes.append(f"thrust of {reported} is '{heading.text}' less '{own[0].headings[q].text}'")
        elif not own:
            out.shared.setdefault(f"{PAIR}_{heading.suffix}", total)
            out.notes.append(f"'{heading.text}' is taken for both rotors together")


def _give(out: FoundColumns, index: int, heading: Heading, values: Array) -> None:
    """A rotor a column more."""
    rotor, q = out.rotors[index], heading.quantity
    out.rotors[index] = replace(
        rotor, columns={**rotor.columns, q: values}, headings={**rotor.headings, q: heading}
    )


def _by_rotor(table: TextTable, headings: list[Heading]) -> dict[str, list[Heading]]:
    """Headings by their rotor; one that names none belongs to the rotor that lacks its quantity."""
    labels = list(dict.fromkeys(h.label for h in headings if h.label and h.quantity in OF_A_ROTOR))
    bare = {h.quantity for h in headings if not h.label and h.quantity in LOADS_AND_SPEED}
    if len(labels) == 1 and bare & {h.quantity for h in headings if h.label == labels[0]}:
        labels.append("")  # the other one has no name
    if len(labels) > 2:
        problem = f"{len(labels)} rotors ({', '.join(labels)}), a pair has two: name its columns (`columns`)"
        raise table.heading_error("", problem)
    groups: dict[str, list[Heading]] = {label: [] for label in labels or [""]}
    for heading in headings:
        groups.setdefault(_owner(heading, headings, labels), []).append(heading)
    return groups


def _owner(heading: Heading, headings: list[Heading], labels: list[str]) -> str:
    if heading.quantity == "time":
        return _SHARED
    if heading.label:
        return heading.label if heading.label in labels else _SHARED
    if len(labels) < 2 or "" in labels:
        unnamed = "" if "" in labels or not labels else labels[0]
        return _SHARED if heading.quantity == "voltage" else unnamed
    named = {h.label for h in headings if h.quantity == heading.quantity}
    lacking = [label for label in labels if label not in named]
    return lacking[0] if len(lacking) == 1 and heading.quantity in OF_A_ROTOR else _SHARED


def _preferred(table: TextTable, headings: list[Heading], notes: list[str]) -> Heading:
    """Of several columns for one quantity: not all zero first, then SI, then the optical one, then the later.

    Raises InputError where two of them that read something contradict each other: they may be two rotors.
    """

    def rank(heading: Heading) -> tuple[bool, bool, bool, int]:
        values = table.numbers_or_none(heading.index)
        si = heading.unit is not None and heading.unit.scale == 1.0
        return values is not None and bool(np.any(values)), si, heading.optical, heading.index

    best, *others = sorted(headings, key=rank, reverse=True) if len(headings) > 1 else headings
    for other in others:
        if best.quantity not in LOADS_AND_SPEED and best.quantity != "time":
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
        problem = (
            f"'{best.text}' and '{other.text}' both read {best.quantity} and differ: two rotors, or one of "
            "them is wrong; name the right ones in a map (`columns`)"
        )
        raise table.heading_error("", problem)
    return best


def values_of(table: TextTable, heading: Heading, unit: Unit | None, poles: int | None) -> Array:
    """The column in our unit (rows,), taken in `unit` or in the heading's. Raises InputError."""
    if heading.problem:
        raise heading.problem
    values, unit = table.numbers(heading.index), unit or heading.unit
    if unit is None:
        expected = ", ".join(unit_names(heading.quantity))
        problem = f"unit of a {heading.quantity} expected in the heading ({expected})"
        raise table.heading_error(heading.text, problem)
    if heading.quantity == "throttle":
        return np.clip(unit.scale * values + unit.offset, 0.0, 1.0)
    if unit.electrical and not poles:
        raise table.heading_error(heading.text, NEEDS_POLES)
    return unit.factor(poles) * values + unit.offset


def _with_unit_by_range(table: TextTable, heading: Heading) -> Heading:
    """What a throttle is counted in shows in its range: us, per cent or a share. Raises InputError."""
    values, unit = table.numbers(heading.index), heading.unit
    top, low = float(np.max(values)), float(np.min(values[values > 0], initial=np.inf))
    fits = "us" if low >= 800 and top <= 2500 else "%" if 1.5 < top <= 100 else "1" if top <= 1.0 else None
    if unit is None and fits and (fits == "us" or float(np.min(values)) >= 0):
        unit = find_unit("throttle", fits)
    wrong = unit is not None and {"us": fits != "us", "%": top > 105 or (fits == "1"), "1": top > 1.05}.get(
        unit.name, False
    )
    if unit is None or wrong:
        found = f"{float(np.min(values)):g} to {top:g}" + (f" in {unit.name}" if unit else "")
        problem = (
            f"a throttle in us (1000..2000), % or 0..1 is expected, found {found}; a map states it: "
            + line_for("upper_throttle", heading.text, "%")
        )
        raise table.heading_error(heading.text, problem)
    return replace(heading, unit=unit)


def _guessed_units(
    table: TextTable,
    chosen: Mapping[str, Mapping[str, Heading]],
    shaft_W: Mapping[str, Array],
    poles: int | None,
    diameter_m: float | None,
) -> dict[tuple[str, str], Unit]:
    """(rotor, quantity): unit, for columns that do not say theirs, where just one makes propellers of all.

    Raises InputError naming the column, what it may be and the line to write.
    """
    unwritten = {
        (label, q): h
        for label, found in chosen.items()
        for q, h in found.items()
        if q in LOADS_AND_SPEED and h.unit is None
    }
    if not unwritten:
        return {}
    raw = {
        label: {
            q: table.numbers(h.index) if (label, q) in unwritten else values_of(table, h, None, poles)
            for q, h in found.items()
        }
        for label, found in chosen.items()
    }
    readings = readings_of(raw, shaft_W)
    fitting = []
    for taken in _combinations(list(dict.fromkeys(q for _, q in unwritten)), poles):
        scaled = {
            label: r.scaled(**{q: u.factor(poles) for q, u in taken.items() if (label, q) in unwritten})
            for label, r in readings.items()
        }
        complete = all(r.thrust_N and (r.rpm or r.torque_Nm) for r in scaled.values())
        if complete and possible(scaled, diameter_m):
            fitting.append(taken)
    if len(fitting) == 1:
        return {(label, q): fitting[0][q] for label, q in unwritten}
    (label, quantity), heading = next(iter(unwritten.items()))
    may = list(dict.fromkeys(f[quantity].name for f in fitting))
    hint = f"; the readings fit {' or '.join(may)}" if may else ""
    name = f"{label if label in SIDES else 'upper'}_{heading.suffix}"
    known = unit_names(quantity)
    problem = (
        f"unit of a {quantity} expected ({', '.join(known)}), found none{hint}; write it into the heading or "
        f"a map (`columns`): {line_for(name, heading.text, (may or known)[0])}"
    )
    raise table.heading_error(heading.text, problem)


def _combinations(quantities: list[str], poles: int | None) -> Iterator[dict[str, Unit]]:
    """Every unit of each quantity with every one of the others."""
    each = []
    for quantity in quantities:
        units = {u.name: u for u in QUANTITIES[quantity].units.values() if not u.electrical or poles}
        each.append([u for name, u in units.items() if name not in _NEVER_UNWRITTEN])
    for units_of_all in product(*each):
        yield dict(zip(quantities, units_of_all, strict=True))
