"""What is being done to a board, on disk, so that a killed upload is known about and can be undone.

One file a board. It is written before the first parameter is, and removed only when the board is known to
hold the old table or the new one whole. Floats are kept as the bits of the wire.
"""

from __future__ import annotations

import contextlib
import os
import re
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from coaxlink import files
from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.mavlink.identity import Identity
from coaxlink.mavlink.locks import lock
from coaxlink.mavlink.parameters import Value
from coaxlink.uploading.content import Content
from firmware_params.bounded import STRING
from firmware_params.plain import is_parameter_name, name_problem


@dataclass(frozen=True)
class Entry:
    """An upload that has not ended: the board as it was and as it is to be."""

    board: str
    old: Content
    new: Content
    backup: str
    files: tuple[str, ...]
    started: str
    optional: tuple[str, ...] = ()  # names that the board may refuse


@dataclass(frozen=True)
class Verified:
    """What a board held when it was verified last."""

    time: str
    files: tuple[str, ...]
    hash: int
    values: Mapping[str, Value]
    scripts: Mapping[str, int | None] = field(default_factory=dict)  # CRC by path
    touched: tuple[str, ...] = ()  # names that any upload from here wrote to this board, so far


class Journal:
    """The journal of one board."""

    def __init__(self, identity: Identity, folder: Path | None = None, address: str = "") -> None:
        """`address` is where the vehicle was called: part of the name where boards share a uid."""
        self.board = identity.uid or f"system{identity.system}"
        self._name = self.board
        if address and identity.shared:
            self._name += "-" + re.sub(r"[^A-Za-z0-9]+", "-", address).strip("-")[:80]
        home = folder or files.state_folder()
        self.path = home / f"{self._name}.journal.json"
        self.record_path = home / f"{self._name}.verified.json"

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """No other process of this user uploads to this board inside the block. Raises SafetyRefusal.

        The lock goes with the process, however it ends.
        """
        path = self.path.with_name(f"{self._name}.lock")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        except OSError as error:
            raise InputError(path, "", f"cannot be written ({error.strerror})") from error
        try:
            lock(handle, wait=False)
        except OSError as error:
            os.close(handle)
            raise SafetyRefusal(f"another upload to board {self.board} is under way") from error
        try:
            yield
        finally:
            os.close(handle)

    def open_entry(self) -> Entry | None:
        """The upload that did not end, None when there is none. Raises InputError on a damaged file."""
        if not self.path.exists():
            return None
        try:
            raw = files.read_json(self.path)
            return Entry(
                _text(raw["board"]),
                _content(raw["old"], raw["old_files"]),
                _content(raw["new"], raw["new_files"]),
                _text(raw["backup"]),
                _texts(raw["files"]),
                _text(raw["started"]),
                _texts(raw.get("spare", [])),
            )
        except (InputError, ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
            raise InputError(
                self.path,
                "",
                f"a damaged journal ({error}): the board may hold half a table; delete it, then restore the "
                "newest backup",
            ) from error

    def begin(self, entry: Entry) -> None:
        """Write the entry; it is on disk when this returns. Raises InputError."""
        document = {
            "board": entry.board,
            "started": entry.started,
            "backup": entry.backup,
            "files": list(entry.files),
            "spare": list(entry.optional),
            "old": {n: _raw(v) for n, v in entry.old.values.items()},
            "new": {n: _raw(v) for n, v in entry.new.values.items()},
            "old_files": {p: None if d is None else d.hex() for p, d in entry.old.files.items()},
            "new_files": {p: None if d is None else d.hex() for p, d in entry.new.files.items()},
        }
        files.write_json(self.path, document)
        _sync_folder(self.path.parent)

    def record(
        self,
        files_: tuple[str, ...],
        values: Mapping[str, Value],
        checksum: int,
        scripts: Mapping[str, int | None] | None = None,
    ) -> None:
        """Keep what was verified last: values, the board's own hash of all parameters (0: it has none), and
        the CRC of each script by path (None: removed)."""
        touched = sorted({*self.touched(), *values})
        files.write_json(
            self.record_path,
            {
                "board": self.board,
                "time": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
                "files": list(files_),
                "hash": checksum,
                "values": {n: _raw(v) for n, v in values.items()},
                "scripts": dict(scripts or {}),
                "touched": touched,
            },
        )

    def last(self) -> Verified | None:
        """What `record` kept, None when there is nothing. Raises InputError on a damaged file."""
        if not self.record_path.exists():
            return None
        try:
            raw = files.read_json(self.record_path)
            values = {n: _value(n, v) for n, v in raw["values"].items()}
            scripts = {
                _text(p): None if crc is None else int(crc) for p, crc in raw.get("scripts", {}).items()
            }
            touched = _texts(raw.get("touched", list(values)))
            return Verified(
                _text(raw["time"]), _texts(raw["files"]), int(raw["hash"]), values, scripts, touched
            )
        except (InputError, ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
            raise InputError(self.record_path, "", f"damaged ({error}); verify with DIR instead") from error

    def written(self) -> Mapping[str, Value]:
        """What was verified last, by name; a damaged record knows nothing."""
        try:
            last = self.last()
        except InputError:
            return {}
        return last.values if last else {}

    def touched(self) -> tuple[str, ...]:
        """Names that uploads from here wrote to this board; a damaged record knows none."""
        try:
            last = self.last()
        except InputError:
            return ()
        return last.touched if last else ()

    def end(self) -> None:
        """The board holds one whole table again."""
        self.path.unlink(missing_ok=True)
        _sync_folder(self.path.parent)


def _raw(value: Value) -> dict[str, Any]:
    return {
        "value": value.value if value.value == value.value else None,
        "type": value.type,
        "bits": value.bits.hex(),
    }


def _value(name: str, raw: Mapping[str, Any]) -> Value:
    held = float("nan") if raw["value"] is None else raw["value"]  # JSON has no NaN
    bits = bytes.fromhex(raw["bits"])
    if not is_parameter_name(name) or not isinstance(held, (int, float)) or len(bits) not in (0, 4):
        raise ValueError(f"'{name}' is no parameter")
    return Value(name, held, int(raw["type"]), bits)


def _text(value: Any) -> str:
    if not isinstance(value, str) or name_problem(value, STRING):
        raise ValueError("a line of text is expected")
    return value


def _texts(values: Any) -> tuple[str, ...]:
    if not isinstance(values, list):
        raise ValueError("a list is expected")
    return tuple(map(_text, values))


def _content(values: Mapping[str, Any], held: Mapping[str, str | None]) -> Content:
    return Content({n: _value(n, v) for n, v in values.items()}, {p: _bytes(d) for p, d in held.items()})


def _bytes(text: str | None) -> bytes | None:
    return None if text is None else bytes.fromhex(text)


def _sync_folder(folder: Path) -> None:
    if os.name == "nt" or not folder.exists():  # Windows opens no folder
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
