"""ArduPilot's `.param` text: `NAME,VALUE` (also `=`, tab or blanks), `#` comments, `@READONLY` marks."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_params.bounded import lines_of
from firmware_params.errors import ParamsFileError
from firmware_params.plain import plain
from firmware_params.text import comment, names_of, number, read_text, shortest, write_text

_LINE = re.compile(r"^([A-Z][A-Z0-9_]{0,15})\s*(?:,|=|\s)\s*(\S+)(?:\s+@READONLY)?\s*$")


@dataclass(frozen=True)
class ParamFile:
    """Contents of one file, in its order; ArduPilot's values are all floats on the wire."""

    params: dict[str, float]
    header: tuple[str, ...] = ()


def read_param_file(path: Path, *, finite: bool = True) -> ParamFile:
    """Read a `.param` file. Raises ParamsFileError with the line; a NaN only passes if `finite` is False."""
    text = read_text(path)
    params: dict[str, float] = {}
    header: list[str] = []
    for n, line in lines_of(text):
        if line.startswith("#"):
            header.append(plain(line[1:].strip()))
            continue
        body = line.split("#", 1)[0].strip()
        if not body:
            continue
        match = _LINE.match(body)
        if not match:
            raise ParamsFileError(path, n, f"NAME,VALUE is expected, found '{plain(body, 40)}'")
        name, shown = match.groups()
        try:
            value = number(shown)
        except ValueError as error:
            found = plain(shown, 40)
            raise ParamsFileError(path, n, f"{name}: {error}, found '{found}'") from error
        if finite and not math.isfinite(value):
            raise ParamsFileError(path, n, f"{name}: a finite number is expected, found '{shown}'")
        if name in params:
            raise ParamsFileError(path, n, f"{name} stands twice")
        params[name] = value
    if not params:
        raise ParamsFileError(path, 0, "no parameters: lines NAME,VALUE are expected")
    return ParamFile(params, tuple(header))


def param_text(params: Mapping[str, float], header: Sequence[str] = ()) -> str:
    """A `.param` file's text; every value reads back as the same float32.

    A header stays a header, whatever its lines hold. Raises TableError for a name that is none.
    """
    names_of(params)
    lines = [f"# {comment(line)}".rstrip() for line in header]
    return "\n".join([*lines, *(f"{name},{shortest(value)}" for name, value in params.items())]) + "\n"


def write_param_file(path: Path, params: Mapping[str, float], header: Sequence[str] = ()) -> None:
    """Write `param_text` atomically. Raises TableError, OSError."""
    write_text(path, param_text(params, header))
