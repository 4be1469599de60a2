"""Files that are whole or not there: atomic writes, TOML in and out, hashes, packaged examples."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from coaxlink.errors import InputError


def write_atomic(path: Path, content: str | bytes) -> None:
    """Replace `path` by `content` in one step; on any failure the old file stays.

    Raises InputError when the place cannot be written.
    """
    data = content.encode() if isinstance(content, str) else content
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise InputError(path, "", f"cannot be written ({error.strerror})") from error
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        umask = os.umask(0)
        os.umask(umask)
        Path(name).chmod(0o666 & ~umask)
        Path(name).replace(path)
    except OSError as error:
        Path(name).unlink(missing_ok=True)
        raise InputError(path, "", f"cannot be written ({error.strerror})") from error


def refuse_unwritable(path: Path | None) -> None:
    """Find out before the work whether a result can be put there. Raises InputError; leaves nothing."""
    if path is None:
        return
    place = path.parent
    try:
        place.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        raise InputError(path, "", f"cannot be written ({error.strerror})") from error


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write one JSON object atomically; NaN and infinity are refused, not written as invalid JSON."""
    write_atomic(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def write_toml(path: Path, value: Mapping[str, Any]) -> None:
    """Write one TOML document atomically."""
    write_atomic(path, tomli_w.dumps(value))


def read_text(path: Path) -> str:
    """The text of a file (UTF-8, a byte-order mark is dropped). Raises InputError."""
    try:
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(path, f"byte {error.start}", "not text (UTF-8 expected)") from error
    except OSError as error:
        raise InputError(path, "", f"cannot be read ({error.strerror})") from error


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML document as a dict. Raises InputError with the line of a syntax error."""
    try:
        return tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise InputError(path, "", f"not TOML: {error}") from error


def sha256(path: Path) -> str:
    """Hex digest of a file's bytes."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def example(name: str) -> Path:
    """Path of a shipped example (`x8_paper.toml`, ...), installed or in a checkout."""
    here = Path(__file__).parent
    for folder in (here / "examples", here.parent / "examples"):
        if (folder / name).is_file():
            return folder / name
    raise InputError(name, "", "no such shipped example")
