"""Stand logs: our own columns as they are, foreign headings recognised, or mapped by a TOML file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.averaging import thinned
from coaxlink.data.columns_map import FORM, map_columns
from coaxlink.data.headings import is_derived
from coaxlink.data.lines import Progress
from coaxlink.data.rotors import SAID, sort_columns
from coaxlink.data.samples import Samples
from coaxlink.data.sides import SHAFT, with_sides
from coaxlink.data.sound import Origin, check_signs, check_units
from coaxlink.data.table import TextTable, read_table
from coaxlink.data.units import QUANTITIES
from coaxlink.errors import InputError

OWN_COLUMNS = (
    "time_s",
    *(
        f"{side}_{what}"
        for side in ("upper", "lower")
        for what in ("rpm", "throttle", "thrust_N", "torque_Nm")
    ),
    "voltage_V",
    "upper_voltage_V",
    "lower_voltage_V",
    "upper_current_A",
    "lower_current_A",
    "motor_temperature_C",
    "air_temperature_C",
    "air_pressure_Pa",
    "rotor_spacing_m",
)
_OF_A_ROTOR = re.compile(r"(upper|lower)_(rpm|throttle|thrust_N|torque_Nm)")
_OWN_STYLE = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*")


def read_stand_log(
    path: Path,
    columns_map: Path | None = None,
    *,
    upper: str | None = None,
    poles: int | None = None,
    diameter_m: float | None = None,
    sheet: str | None = None,
    trust_units: bool = True,
    progress: Progress | None = None,
) -> Samples:
    """A stand log as Samples in the contract's columns, SI.

    A foreign file loses its sums and efficiencies, its rows before the motors turn, and the signs of its
    torques and thrusts (positive as the model has them). `columns_map` names the columns by ours, see
    `columns_map`; `upper` is the label of the upper rotor as the headings write it (A, left, 1), `poles` the
    magnet poles behind electrical turns, `diameter_m` the propellers' to check units by; `trust_units` takes
    the headings' units whatever the readings say.

    Raises InputError (file, line, column, what was expected), RotorsUnclear when nothing says which rotor is
    the upper one.
    """
    table = read_table(Path(path), progress, sheet)
    mapped = map_columns(table, columns_map, OWN_COLUMNS, poles) if columns_map else None
    columns = dict(mapped.columns) if mapped else {}
    used = set(mapped.used) if mapped else set()
    notes = [*table.notes, *(mapped.notes if mapped else ())]
    own = [i for i, name in enumerate(table.headings) if name in OWN_COLUMNS and i not in used]
    for i in own:
        columns.setdefault(table.headings[i], table.numbers(i))
        used.add(i)
    # a foreign file to which somebody added a spacing or a temperature of ours is a foreign file
    named = any(_OF_A_ROTOR.fullmatch(name) for name in columns)
    found = None if named else sort_columns(table, used, poles, diameter_m)
    if found is not None:
        used |= found.used
        notes += found.notes
        columns = {**found.shared, **columns}
    elif mapped is None:
        columns |= _ours_in_other_units(table, used, columns, notes, poles)
    context = _context(table, used, notes, mapped is not None)
    samples = Samples({**columns, **context}, str(path), tuple(notes), table.lines)
    origins: dict[str, Origin] = {}
    if found is not None:
        samples, sides = with_sides(samples, found.rotors, upper)
        origins = {
            f"{side}_{heading.suffix}": Origin(heading.text, heading.unit)
            for side, rotor in sides.items()
            for heading in rotor.headings.values()
        }
    elif upper is not None:
        samples = _as_stated(samples, upper)
    _check(samples, table)
    if not trust_units:
        few = thinned(samples)
        check_signs(few)
        check_units(few, origins, diameter_m, mapped.stated if mapped else frozenset())
    return _without_repeats(samples.without(*(f"{side}_{SHAFT}" for side in SAID)))


def _without_repeats(samples: Samples) -> Samples:
    """Without rows that say again all that the row before said, its stamp too: a logger that hung."""
    if samples.rows < 2 or not samples.has("time_s"):
        return samples
    again = np.zeros(samples.rows, bool)
    again[1:] = np.logical_and.reduce([column[1:] == column[:-1] for column in samples.columns.values()])
    if not again.any():
        return samples
    return samples.take(~again).with_notes(f"{int(again.sum())} rows that repeat the row before left out")


def _as_stated(samples: Samples, upper: str) -> Samples:
    """Our own columns when somebody says which of them is the upper rotor. Raises InputError."""
    if upper.casefold() not in SAID:
        raise InputError("`upper`", "", f"upper or lower is expected for these columns, found '{upper}'")
    if upper.casefold() == "upper":
        return samples
    turned = {"upper": "lower", "lower": "upper"}
    columns = {
        re.sub("^(upper|lower)(?=_)", lambda m: turned[m[1]], name): column
        for name, column in samples.columns.items()
    }
    note = "upper and lower columns exchanged, as `upper` lower says"
    return Samples(columns, samples.source, (*samples.notes, note), samples.lines)


def _ours_in_other_units(
    table: TextTable,
    used: set[int],
    columns: Mapping[str, NDArray[np.float64]],
    notes: list[str],
    poles: int | None,
) -> dict[str, NDArray[np.float64]]:
    """Columns beside our own that are a rotor's as well, in units of their own (lower_thrust_kgf)."""
    more: dict[str, NDArray[np.float64]] = {}
    try:
        found = sort_columns(table, used, poles)
    except InputError:
        return more  # a column of context that looks like a rotor's is still context
    for rotor in found.rotors:
        for quantity, values in rotor.columns.items():
            name, heading = f"{rotor.label}_{QUANTITIES[quantity][0]}", rotor.headings[quantity]
            if rotor.label in SAID and name not in columns and heading.unit is not None:
                more[name] = values
                used.add(heading.index)
                notes.append(f"{name} from '{heading.text}'")
    return more


def _context(
    table: TextTable, used: set[int], notes: list[str], mapped: bool
) -> dict[str, NDArray[np.float64]]:
    """Further numeric columns under their own headings; what cannot matter is left out, and said.

    Beside a map nothing is taken that it does not name.
    """
    columns, left = {}, []
    for i, text in enumerate(table.headings):
        if i in used or not text or table.column_is_empty(i):
            continue
        if mapped:
            left.append(text)
            continue
        values = None if is_derived(text) else table.numbers_or_none(i)
        if values is None and not is_derived(text) and _OWN_STYLE.fullmatch(text):
            values = table.numbers(i)  # written by our hand: what is wrong in it must be said
        if values is None or (not np.any(values) and not _OWN_STYLE.fullmatch(text)):
            left.append(text)
        else:
            columns[text] = values
    if left:
        why = "not in the map" if mapped else "sums, efficiencies, text or all zero"
        notes.append(f"left out ({why}): {', '.join(left)}")
    return columns


def _check(samples: Samples, table: TextTable) -> None:
    if not any(samples.has(f"{s}_{w}") for s in ("upper", "lower") for w in ("rpm", "throttle")):
        expected = f"expected upper_rpm and lower_rpm, or headings that a map names: upper_rpm = {FORM}"
        found = ", ".join(table.headings[:8])
        raise InputError(
            table.source, f"line {table.heading_line}", f"no speed column: {expected} (found {found})"
        )
    if not samples.rows:
        raise InputError(table.source, "", "no rows in which a motor turns")
    for side in ("upper", "lower"):
        name = f"{side}_throttle"
        if samples.has(name) and not ((samples[name] >= 0) & (samples[name] <= 1)).all():
            row = int(np.argmax((samples[name] < 0) | (samples[name] > 1)))
            problem = f"0..1 is expected, found {samples[name][row]:g} (`columns` can scale percent by 0.01)"
            raise InputError(table.source, f"{samples.place(row)}, column {name}", problem)
