"""Parameter files as text, whatever their format: read with one line errors, written whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from firmware_params.errors import ParamsFileError


def read_text(path: Path) -> str:
    """A file's text without a byte order mark. Raises ParamsFileError."""
    try:
        return Path(path).read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise ParamsFileError(path, 0, f"cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise ParamsFileError(path, 0, "not text (UTF-8 expected)") from error


def write_lines(path: Path, lines: Sequence[str]) -> None:
    """Replace a file in one step, its folder made if need be. Raises OSError; the old file stays then."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as stream:
            stream.write("\n".join(lines) + "\n")
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
