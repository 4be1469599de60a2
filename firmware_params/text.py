"""Parameter files as text, whatever their format: read with one line errors, written whole or not at all."""

from __future__ import annotations

import math
import os
import re
import struct
import tempfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from firmware_params.errors import TableError
from firmware_params.plain import is_parameter_name, plain

_NUMBER = re.compile(
    r"[+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?|[+-]?(?:nan|inf|infinity)", re.ASCII | re.IGNORECASE
)


def number(text: str) -> float:
    """A decimal number as autopilots and ground stations write it, NaN and infinity too.

    Raises ValueError for anything else, and for what no float32 holds.
    """
    if len(text) > 64 or not _NUMBER.fullmatch(text):
        raise ValueError("a number is expected")
    value = float(text)
    if math.isinf(value) and "n" not in text.lower():
        raise ValueError("a float32 is expected")
    try:
        struct.pack("<f", value)
    except OverflowError:
        raise ValueError("a float32 is expected") from None
    return value


def comment(text: str) -> str:
    """A text as one line of a comment: whatever it holds, the line ends where the comment does."""
    return plain(" ".join(text.split()), 200)


def names_of(params: Iterable[str]) -> None:
    """Raises TableError for a name that would be more, or less, than one field of a line."""
    for name in params:
        if not is_parameter_name(name):
            raise TableError(f"'{plain(name, 40)}' is no name of a parameter")


def write_text(path: Path, text: str) -> None:
    """Replace a file in one step, its folder made if need be. Raises OSError; the old file stays then."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        Path(temporary).replace(path)
    except OSError:
        Path(temporary).unlink(missing_ok=True)
        raise


def shortest(value: float) -> str:
    """The shortest decimal that is this float32 and no other."""
    if value == 0.0 or 1e-5 <= abs(value) < 1e9:
        return np.format_float_positional(np.float32(value), trim="-")
    return str(np.float32(value))
