"""QGroundControl's `.params` files: `#` headers, then `system TAB component TAB NAME TAB VALUE TAB TYPE`."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_params.bounded import DIGITS, lines_of
from firmware_params.errors import ParamsFileError
from firmware_params.plain import is_parameter_name, plain
from firmware_params.px4.parameters import FLOAT, INT32, PARAMETERS, type_of
from firmware_params.text import comment, names_of, number, read_text, shortest, write_text

_INTEGER = re.compile(r"[+-]?[0-9]+")
_INTEGERS = range(1, 9)  # MAV_PARAM_TYPE_UINT8 .. INT64
_WIDE = {
    1: (0, 2**8),
    2: (-(2**7), 2**7),
    3: (0, 2**16),
    4: (-(2**15), 2**15),
    5: (0, 2**32),
    6: (-(2**31), 2**31),
}
_WIDE |= {7: (0, 2**63), 8: (-(2**63), 2**63)}  # none of our autopilots has one of 64 bits


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
    for n, line in lines_of(text):
        if line.startswith("#"):
            header.append(plain(line[1:].strip()))
            continue
        if not line.strip():
            continue
        system, component, name, value, kind = _parse(path, n, line, finite)
        if address not in (None, (system, component)):
            raise ParamsFileError(path, n, f"{system}/{component} beside {address}: one vehicle is expected")
        if name in params:
            raise ParamsFileError(path, n, f"{name} stands twice")
        address = (system, component)
        params[name], types[name] = value, kind
    if address is None:
        raise ParamsFileError(
            path, 0, "no parameters: tab-separated lines 'system component NAME VALUE TYPE' are expected"
        )
    return ParamsFile(params, types, tuple(header), *address)


def _parse(path: Path, n: int, line: str, finite: bool) -> tuple[int, int, str, float | int, int]:
    fields = line.rstrip("\r\n").split("\t")
    if len(fields) != 5:
        problem = (
            f"5 tab-separated fields are expected (system, component, NAME, VALUE, TYPE), found {len(fields)}"
        )
        raise ParamsFileError(path, n, problem)
    try:
        system, component, kind = _integer(fields[0]), _integer(fields[1]), _integer(fields[4])
    except ValueError as error:
        raise ParamsFileError(path, n, "system, component and type must be integers") from error
    if not (0 <= system <= 255 and 0 <= component <= 255):
        raise ParamsFileError(
            path, n, f"system and component of 0..255 are expected, found {system}/{component}"
        )
    name = fields[2].strip()
    if not is_parameter_name(name):
        problem = f"'{plain(name, 40)}' is not a parameter name (1..16 of A-Z, a-z, 0-9, _)"
        raise ParamsFileError(path, n, problem)
    if kind not in _INTEGERS and kind not in (9, 10):
        raise ParamsFileError(path, n, f"{name}: type {kind} is unknown ({INT32} = int32, {FLOAT} = float)")
    try:
        value = _integer(fields[3]) if kind in _INTEGERS else number(fields[3].strip())
    except ValueError as error:
        raise ParamsFileError(path, n, f"{name}: {error}, found '{plain(fields[3], 40)}'") from error
    if finite and not math.isfinite(value):
        raise ParamsFileError(path, n, f"{name}: a finite number is expected, found '{fields[3]}'")
    if kind in _WIDE and not _WIDE[kind][0] <= value < _WIDE[kind][1]:
        low, high = _WIDE[kind]
        raise ParamsFileError(path, n, f"{name}: {low}..{high - 1} is expected, found {value}")
    known = PARAMETERS.get(name)
    if known and known.type != kind:
        raise ParamsFileError(path, n, f"{name}: type {known.type} is expected, found {kind}")
    return system, component, name, value, kind


def _integer(text: str) -> int:
    if len(text) > DIGITS or not _INTEGER.fullmatch(text.strip()):
        raise ValueError("an integer is expected")
    return int(text)


def params_text(
    params: Mapping[str, float | int],
    *,
    types: Mapping[str, int] | None = None,
    header: Sequence[str] = (),
    system: int = 1,
    component: int = 1,
) -> str:
    """A `.params` file's text. Floats are written so that reading gives the same float32.

    A header stays a header, whatever its lines hold. Raises TableError for a name that is none.
    """
    names_of(params)
    lines = [f"# {comment(line)}".rstrip() for line in header]
    for name, value in params.items():
        kind = types[name] if types and name in types else type_of(name, value)
        shown = str(int(value)) if kind in _INTEGERS else shortest(float(value))
        lines.append(f"{system}\t{component}\t{name}\t{shown}\t{kind}")
    return "\n".join(lines) + "\n"


def write_params_file(
    path: Path,
    params: Mapping[str, float | int],
    *,
    types: Mapping[str, int] | None = None,
    header: Sequence[str] = (),
    system: int = 1,
    component: int = 1,
) -> None:
    """Write `params_text` atomically. Raises TableError, OSError."""
    text = params_text(params, types=types, header=header, system=system, component=component)
    write_text(path, text)
