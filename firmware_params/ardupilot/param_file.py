"""ArduPilot's `.param` text: `NAME,VALUE` (also `=`, tab or blanks), `#` comments, `@READONLY` marks."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_params.errors import ParamsFileError
from firmware_params.text import read_text, shortest, write_lines

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
    for number, line in enumerate(text.splitlines(), start=1):
        if line.startswith("#"):
            header.append(line[1:].strip())
            continue
        body = line.split("#", 1)[0].strip()
        if not body:
            continue
        match = _LINE.match(body)
        if not match:
            raise ParamsFileError(path, number, f"NAME,VALUE is expected, found '{body[:40]}'")
        name, shown = match.groups()
        try:
            value = float(shown)
        except ValueError as error:
            raise ParamsFileError(path, number, f"{name}: a number is expected, found '{shown}'") from error
        if finite and not math.isfinite(value):
            raise ParamsFileError(path, number, f"{name}: a finite number is expected, found '{shown}'")
        if name in params:
            raise ParamsFileError(path, number, f"{name} stands twice")
        params[name] = value
    if not params:
        raise ParamsFileError(path, 0, "no parameters: lines NAME,VALUE are expected")
    return ParamFile(params, tuple(header))


def write_param_file(path: Path, params: Mapping[str, float], header: Sequence[str] = ()) -> None:
    """Write a `.param` file atomically; every value reads back as the same float32. Raises OSError."""
    lines = [f"# {line}".rstrip() for line in header]
    lines += [f"{name},{shortest(value)}" for name, value in params.items()]
    write_lines(path, lines)
