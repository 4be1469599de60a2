"""Stand logs: our own columns as they are, foreign headings recognised, or mapped by a TOML file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.aliases import OF_A_ROTOR, OWN_COLUMNS, PAIR, QUANTITIES, SIDES, words_of
from coaxlink.data.averaging import thinned
from coaxlink.data.cleaning import drive_of, positive, without_repeats
from coaxlink.data.columns_map import FORM, map_columns
from coaxlink.data.headings import Heading, is_derived
from coaxlink.data.lines import Progress
from coaxlink.data.rotors import find_rotors
from coaxlink.data.samples import Samples
from coaxlink.data.sides import RotorsUnclear, exchanged_as_stated, with_sides
from coaxlink.data.suggested_map import suggested_map
from coaxlink.data.table import TextTable, read_table
from coaxlink.data.unit_check import SHAFT, UnitsUnclear, check_signs, check_units, refuse_sums
from coaxlink.errors import InputError

_OURS_OF_A_ROTOR = {f"{side}_{QUANTITIES[q].suffix}" for side in (*SIDES, PAIR) for q in OF_A_ROTOR}
# with its unit, as ours: a column of another name may hold words, remarks, anything
_OWN_STYLE = re.compile(
    r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*_(N|Nm|rpm|s|ms|us|V|A|W|C|K|Pa|hPa|m|mm|kg|g|Hz|deg|rad)"
)
_COUNTS = frozenset({"id", "uuid", "guid", "serial", "nr", "index", "idx", "row", "sample", "number"})


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
    try:
        return _read(table, str(path), columns_map, upper, poles, diameter_m, trust_units)
    except UnitsUnclear as error:
        known = error.upper or upper or ""
        raise error.with_map(suggested_map(table, known, error.scales) if error.scales else "") from None
    except InputError as error:
        headings = re.match(rf"line {table.heading_line}\b", error.where) or isinstance(error, RotorsUnclear)
        shown = headings and columns_map is None
        raise error.with_map(suggested_map(table, upper or "") if shown else "") from None


def _read(
    table: TextTable,
    path: str,
    columns_map: Path | None,
    upper: str | None,
    poles: int | None,
    diameter_m: float | None,
    trust_units: bool,
) -> Samples:
    mapped = map_columns(table, columns_map, poles) if columns_map else None
    columns = dict(mapped.columns) if mapped else {}
    used = set(mapped.used) if mapped else set()
    notes = [*table.notes, *(mapped.notes if mapped else ())]
    own = [i for i, name in enumerate(table.headings) if name in OWN_COLUMNS and i not in used]
    for i in own:
        columns.setdefault(table.headings[i], table.numbers(i))
        used.add(i)
    # a foreign file to which somebody added a spacing or a temperature of ours is a foreign file
    found = None if _OURS_OF_A_ROTOR & columns.keys() else find_rotors(table, used, poles, diameter_m)
    if found is not None:
        used |= found.used
        notes += found.notes
        columns = {**found.shared, **columns}
    elif mapped is None:
        columns |= _ours_in_other_units(table, used, columns, notes, poles)
    context = _context(table, used, notes, mapped is not None)
    hint = suggested_map(table, upper or "") if found is not None and mapped is None else ""
    samples = Samples({**columns, **context}, path, tuple(notes), table.lines, map_hint=hint)
    if mapped is not None:
        samples = positive(samples, ("torque_Nm",))  # which way a cell counts, a map need not say
    headings: dict[str, Heading] = {}
    if found is not None:
        samples, sides = with_sides(samples, found.rotors, upper)
        headings = {f"{s}_{h.suffix}": h for s, rotor in sides.items() for h in rotor.headings.values()}
    elif upper is not None:
        samples = exchanged_as_stated(samples, upper)
    _check(samples, table)
    few = thinned(samples)
    refuse_sums(few)
    if not trust_units:
        check_signs(few)
        check_units(few, headings, diameter_m, mapped.stated if mapped else frozenset())
    return without_repeats(samples.without(*(f"{side}_{SHAFT}" for side in SIDES)))


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
        found = find_rotors(table, used, poles)
    except InputError:
        return more  # a column of context that looks like a rotor's is still context
    for rotor in found.rotors:
        for quantity, values in rotor.columns.items():
            heading = rotor.headings[quantity]
            name = f"{rotor.label}_{heading.suffix}"
            if rotor.label in SIDES and name not in columns and heading.unit is not None:
                more[name] = values
                used.add(heading.index)
                notes.append(f"{name} from '{heading.text}'")
    return more


def _context(
    table: TextTable, used: set[int], notes: list[str], mapped: bool
) -> dict[str, NDArray[np.float64]]:
    """Further numeric columns under their own headings; what cannot matter is left out, and reported.

    Beside a map nothing is taken that it does not name.
    """
    columns, left = {}, []
    for i, text in enumerate(table.headings):
        if i in used or not text or table.column_is_empty(i):
            continue
        meant = not (mapped or is_derived(text) or _counts(text))
        values = table.numbers_or_none(i) if meant else None
        if meant and _OWN_STYLE.fullmatch(text) and table.is_numbers(i):
            columns[text] = table.numbers(i)  # written by our hand: what is wrong in it must be reported
        elif values is None or not np.any(values):
            left.append(text)
        else:
            columns[text] = values
    if left:
        why = "not in the map" if mapped else "sums, efficiencies, counts, text or all zero"
        notes.append(f"left out ({why}): {', '.join(left)}")
    return columns


def _counts(text: str) -> bool:
    """Whether a heading is a number's that only tells rows apart."""
    words = words_of(text)
    return bool(words) and words[-1] in _COUNTS


def _check(samples: Samples, table: TextTable) -> None:
    if not any(drive_of(samples, side) for side in SIDES):
        expected = f"expected upper_rpm and lower_rpm, or headings that a map names: upper_rpm = {FORM}"
        found = ", ".join(table.headings[:8])
        raise table.heading_error("", f"no speed column: {expected} (found {found})")
    if not samples.rows:
        raise InputError(table.source, "", "no rows in which a motor turns")
    for side in SIDES:
        name = f"{side}_throttle"
        if samples.has(name) and not ((samples[name] >= 0) & (samples[name] <= 1)).all():
            row = int(np.argmax((samples[name] < 0) | (samples[name] > 1)))
            problem = f"0..1 is expected, found {samples[name][row]:g} (`columns` can scale percent by 0.01)"
            raise InputError(table.source, f"{samples.place(row)}, column {name}", problem)
