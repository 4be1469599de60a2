"""ArduPilot's `.param` text as written: `NAME,VALUE` after `#` comments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from firmware_params.text import comment, names_of, shortest, write_text


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
