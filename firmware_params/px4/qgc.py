"""QGroundControl's `.params` files: `#` headers, then `system TAB component TAB NAME TAB VALUE TAB TYPE`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_params.errors import ParamsFileError
from firmware_params.px4.parameters import FLOAT, INT32, PARAMETERS, type_of
from firmware_params.text import read_text, shortest, write_lines

_INTEGERS = range(1, 9)  # MAV_PARAM_TYPE_UINT8 .. INT64


@dataclass(frozen=True)
class ParamsFile:
    """Contents of one file, in its order."""

    params: dict[str, float | int]
    types: dict[str, int]  # MAV_PARAM_TYPE by name
    header: tuple[str, ...] = ()  # comment lines without '#'
    system: int = 1
    component: int = 1


def read_params_file(path: Path, *, finite: bool = True) -> ParamsFile:
    """Read a `.params` file. Raises ParamsFileError naming the line, also for a name that stands twice and,
    unless `finite` is False, for a NaN."""
    text = read_text(path)
    params: dict[str, float | int] = {}
    types: dict[str, int] = {}
    header: list[str] = []
    address: tuple[int, int] | None = None
    for number, line in enumerate(text.splitlines(), start=1):
        if line.startswith("#"):
            header.append(line[1:].strip())
            continue
        if not line.strip():
            continue
        system, component, name, value, kind = _parse(path, number, line, finite)
        if address not in (None, (system, component)):
            raise ParamsFileError(
                path, number, f"{system}/{component} beside {address}: one vehicle is expected"
            )
        if name in params:
            raise ParamsFileError(path, number, f"{name} stands twice")
        address = (system, component)
        params[name], types[name] = value, kind
    if address is None:
        raise ParamsFileError(
            path, 0, "no parameters: tab-separated lines 'system component NAME VALUE TYPE' are expected"
        )
    return ParamsFile(params, types, tuple(header), *address)


def _parse(path: Path, number: int, line: str, finite: bool) -> tuple[int, int, str, float | int, int]:
    fields = line.rstrip("\r\n").split("\t")
    if len(fields) != 5:
        problem = (
            f"5 tab-separated fields are expected (system, component, NAME, VALUE, TYPE), found {len(fields)}"
        )
        raise ParamsFileError(path, number, problem)
    try:
        system, component, kind = int(fields[0]), int(fields[1]), int(fields[4])
    except ValueError as error:
        raise ParamsFileError(path, number, "system, component and type must be integers") from error
    name = fields[2].strip()
    if not name or len(name) > 16:
        raise ParamsFileError(path, number, f"'{name}' is not a parameter name (1..16 characters)")
    if kind not in _INTEGERS and kind not in (9, 10):
        raise ParamsFileError(
            path, number, f"{name}: type {kind} is unknown ({INT32} = int32, {FLOAT} = float)"
        )
    try:
        value = int(fields[3]) if kind in _INTEGERS else float(fields[3])
    except ValueError as error:
        expected = "an integer" if kind in _INTEGERS else "a number"
        raise ParamsFileError(path, number, f"{name}: {expected} is expected, found '{fields[3]}'") from error
    if finite and not math.isfinite(value):
        raise ParamsFileError(path, number, f"{name}: a finite number is expected, found '{fields[3]}'")
    known = PARAMETERS.get(name)
    if known and known.type != kind:
        raise ParamsFileError(path, number, f"{name}: type {known.type} is expected, found {kind}")
    return system, component, name, value, kind


def write_params_file(
    path: Path,
    params: Mapping[str, float | int],
    *,
    types: Mapping[str, int] | None = None,
    header: Sequence[str] = (),
    system: int = 1,
    component: int = 1,
) -> None:
    """Write a `.params` file atomically. Floats are written so that reading gives the same float32."""
    lines = [f"# {line}".rstrip() for line in header]
    for name, value in params.items():
        kind = types[name] if types and name in types else type_of(name, value)
        shown = str(int(value)) if kind in _INTEGERS else shortest(float(value))
        lines.append(f"{system}\t{component}\t{name}\t{shown}\t{kind}")
    write_lines(path, lines)
