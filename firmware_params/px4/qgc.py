"""QGroundControl's `.params` files as written: headers, then system, component, NAME, VALUE, TYPE."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from firmware_params.px4.parameters import type_of
from firmware_params.text import comment, names_of, shortest, write_text

_INTEGERS = range(1, 9)  # MAV_PARAM_TYPE_UINT8 .. INT64


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
