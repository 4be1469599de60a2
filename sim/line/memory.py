"""What survives a power cut: the stand-in's parameters and its card, in a file on disk.

PX4 keeps its parameters some time after they changed: 0.3 s after the first change and not twice within 2 s
(its autosave), or when MAV_CMD_PREFLIGHT_STORAGE asks for it. ArduPilot keeps every value at once. A process
killed before that has lost them, as a board has whose plug is pulled.
"""

from __future__ import annotations

import json
import struct
import time
from pathlib import Path
from typing import Any

from firmware_params import bounded
from sim.documents import write_atomic
from sim.errors import SimulationError
from sim.line.ftp import LOGS
from sim.line.wire import Clock

PX4_WAIT_S, PX4_APART_S = 0.3, 2.0


_DAMAGE = (ValueError, KeyError, TypeError, AttributeError, OverflowError)


def float32(value: Any) -> int | float:
    """A number that a parameter can hold. Raises TypeError, OverflowError."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError("a parameter that is no number")
    struct.pack("<f", value)
    return value


class Memory:
    """The memory of one autopilot. `load` before its clock runs, then `step` in every tick."""

    def __init__(self, path: Path, autopilot: Any, *, lazy: bool, clock: Clock = time.monotonic) -> None:
        self._path, self._autopilot, self._clock, self._lazy = path, autopilot, clock, lazy
        self._due_s: float | None = None
        self._saved_s = 0.0
        self._values: dict[str, Any] = {}
        self._card: dict[str, Any] = {}

    def load(self) -> None:
        """Take up what was kept, and start anew with it. Raises WorldError on a file that is none."""
        store, files = self._autopilot.store, self._autopilot.files
        if self._path.exists():
            try:
                raw = bounded.parse_json(bounded.read_text(self._path))
                values = {str(name): float32(value) for name, value in raw["parameters"].items()}
                card = {p: bytes.fromhex(d) for p, d in raw["files"].items()}
                folders = {str(folder) for folder in raw["folders"]}
                store.recall(values)
            except (OSError, bounded.Unreadable, *_DAMAGE) as error:
                raise SimulationError(self._path, "", f"no memory of a stand-in ({error})") from error
            files.files.update(card)
            files.folders |= folders
            self._autopilot.boot()
        self._values, self._card = store.memory(), self._on_card()
        if self._path.exists() and not self._lazy:
            self._write()  # a start is counted, too
        store.listen(lambda name: self._changed())
        self._autopilot.keep = self.save

    def save(self) -> None:
        """Keep the parameters as they are now."""
        self._values, self._due_s, self._saved_s = self._autopilot.store.memory(), None, self._clock()
        self._write()

    def step(self) -> None:
        """Keep what is due."""
        card = self._on_card()
        if card != self._card:
            self._card = card
            self._write()
        if self._due_s is not None and self._clock() >= self._due_s:
            self.save()

    def _changed(self) -> None:
        if self._due_s is None:
            now = self._clock()
            self._due_s = max(now + PX4_WAIT_S, self._saved_s + PX4_APART_S) if self._lazy else now

    def _on_card(self) -> dict[str, Any]:
        files = self._autopilot.files
        held = {p: bytes(d) for p, d in files.files.items() if not p.startswith(LOGS)}
        return {"files": held, "folders": set(files.folders)}

    def _write(self) -> None:
        document = {
            "parameters": self._values,
            "files": {path: data.hex() for path, data in self._card["files"].items()},
            "folders": sorted(self._card["folders"]),
        }
        write_atomic(self._path, json.dumps(document))
