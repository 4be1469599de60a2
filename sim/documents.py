"""The world's own reading of TOML files: a document, its numbers, and keys that nobody knows."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from firmware_params import bounded
from firmware_params.keys import unknown_key
from firmware_params.plain import plain
from sim.errors import SimulationError

LARGEST = 1e9  # in SI units; nothing of a vehicle is larger, and an autopilot's singles hold it


def read_document(path: Path) -> dict[str, Any]:
    """A TOML file as a dict. Raises WorldError."""
    try:
        return bounded.parse_toml(bounded.read_text(path, bounded.SETTINGS))
    except OSError as error:
        raise SimulationError(path, "", f"cannot be read ({error.strerror})") from error
    except bounded.Unreadable as error:
        raise SimulationError(path, error.where, error.problem) from error


def refuse_unknown(path: Path, where: str, table: dict[str, Any], known: Iterable[str]) -> None:
    """Raises WorldError for a key that is not in `known`, naming the nearest one that is."""
    if odd := unknown_key(table, known):
        raise SimulationError(path, f"{where}.{odd[0]}" if where else odd[0], odd[1])


def read_number(path: Path, where: str, value: object) -> float:
    """`value` as a float within LARGEST. Raises WorldError naming the key."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= LARGEST:
        problem = f"a number within {LARGEST:g} is expected, found {plain(repr(value), 80)}"
        raise SimulationError(path, where, problem)
    return float(value)


def write_atomic(path: Path, text: str) -> None:
    """Replace the regular file `path`, or what it links to, by `text` in one step. Raises WorldError."""
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        problem = "no regular file is there; only a file is written: name a new or a regular one"
        raise SimulationError(path, "", problem)
    draft = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        draft.write_text(text, encoding="utf-8")
        draft.replace(target)
    except OSError as error:
        draft.unlink(missing_ok=True)
        raise SimulationError(path, "", f"cannot be written ({error.strerror})") from error
