"""A file that says which column of a foreign stand log is which of ours.

upper_rpm = "n1"                                                # the heading's unit, ours where it has none
upper_thrust_N = { column = "Thrust A (kgf)" }                  # kgf, as the heading says
lower_thrust_N = { column = "Load cell 2", unit = "lbf" }       # a unit, whatever the heading says
upper_torque_Nm = { column = "Q1", scale = -0.001, offset = 0 } # ours = scale * theirs + offset
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from coaxlink import files
from coaxlink.data.aliases import OWN_COLUMNS, Unit, find_unit, quantity_of, unit_names
from coaxlink.data.headings import UnknownUnitError, recognise
from coaxlink.data.table import TextTable
from coaxlink.errors import InputError
from firmware_params.keys import misspelt, unknown_key

FORM = '{ column = "HEADING", unit = "UNIT" } or { column = "HEADING", scale = 1.0, offset = 0.0 }'
NEEDS_POLES = "electrical turns: say the motor's magnet poles with `poles` (14, 24, 28)"


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid")
    column: str
    unit: str | None = None
    scale: float | None = Field(default=None, allow_inf_nan=False)
    offset: float = Field(default=0.0, allow_inf_nan=False)


@dataclass(frozen=True)
class Mapped:
    """Columns of ours that a map made."""

    columns: Mapping[str, NDArray[np.float64]]
    used: frozenset[int]  # columns of the table
    stated: frozenset[str]  # names whose unit or scale the map itself states
    notes: tuple[str, ...]


def map_columns(table: TextTable, path: Path, poles: int | None = None) -> Mapped:
    """The columns that the map at `path` makes of a table. Raises InputError naming file and key."""
    columns, used, stated, notes = {}, set(), set(), []
    for name, value in files.read_toml(path).items():
        entry = _entry(path, name, value)
        if meant := misspelt(name, OWN_COLUMNS):  # others are context: any name will do
            raise InputError(path, name, f"unknown; {meant}?")
        heading = " ".join(entry.column.split())
        if heading not in table.headings:
            raise InputError(table.source, f"column {heading!r}", f"missing ({path} maps it to {name})")
        index = table.headings.index(heading)
        scale, offset, reported = _conversion(table, path, name, entry, index, poles)
        columns[name] = scale * table.numbers(index) + offset
        used.add(index)
        if entry.unit is not None or entry.scale is not None:
            stated.add(name)
        notes.append(f"{name} = {reported}")
    return Mapped(columns, frozenset(used), frozenset(stated), tuple(notes))


def _entry(path: Path, name: str, value: object) -> _Entry:
    odd = unknown_key(value, _Entry.model_fields) if isinstance(value, dict) else None
    if odd is not None:
        raise InputError(path, f"{name}.{odd[0]}", odd[1])
    try:
        entry = _Entry.model_validate({"column": value} if isinstance(value, str) else value)
    except ValidationError as error:
        raise InputError(path, name, f"{error.errors()[0]['msg']}: {FORM}") from error
    if entry.unit is not None and entry.scale is not None:
        raise InputError(path, name, f"a unit or a scale, not both: {FORM}")
    return entry


def _conversion(
    table: TextTable, path: Path, name: str, entry: _Entry, index: int, poles: int | None
) -> tuple[float, float, str]:
    """Scale, offset and both in words."""
    heading = table.headings[index]
    if entry.scale is not None or (entry.unit is None and entry.offset):
        scale = 1.0 if entry.scale is None else entry.scale
        return scale, entry.offset, f"{scale:g} x '{heading}'" + (f" + {entry.offset:g}" * bool(entry.offset))
    unit = _unit(table, path, name, entry, index)
    if unit is None:
        return 1.0, 0.0, f"1 x '{heading}'"
    if unit.electrical and not poles:
        raise InputError(path, name, NEEDS_POLES)
    return unit.factor(poles), unit.offset + entry.offset, f"'{heading}' in {unit.name}"


def _unit(table: TextTable, path: Path, name: str, entry: _Entry, index: int) -> Unit | None:
    """The unit that the map states, or else the heading."""
    quantity, text = quantity_of(name), table.headings[index]
    if entry.unit is not None:
        unit = find_unit(quantity, entry.unit) if quantity else None
        if unit is None:
            expected = ", ".join(unit_names(quantity)) if quantity else "none: a column without a unit"
            raise InputError(path, name, f"unit: {expected} expected, found '{entry.unit}'")
        return unit
    if quantity is None or text == name:
        return None
    try:
        heading = recognise(index, text, unit_line=table.units[index])
    except UnknownUnitError as error:
        raise InputError(table.source, f"column {text!r}", f"{error}; state it in the map: {FORM}") from error
    return heading.unit if heading is not None and heading.quantity == quantity else None
