"""What the live loop did, a fixed record a demand, on disk within a quarter of a second.

Whole records go to the kernel in one write, so that a killed process loses the last FLUSH_S at most and
leaves a file that reads to its end. What it holds stands with its reader, `data.logs.live_record`.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from coaxlink.data.logs.live_record import MAGIC, RECORD
from coaxlink.errors import InputError
from coaxlink.live.guard import STATES

FLUSH_S = 0.25
MOST_WAITING = 1024  # records; more are written at once, whatever the clock says


class LiveRecord:
    """Append-only. Raises InputError if the file cannot be made; a full disk later ends only the record."""

    def __init__(self, path: Path, about: Mapping[str, Any]) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o666)
            os.write(self._file, MAGIC + json.dumps(dict(about)).encode() + b"\n")
        except OSError as error:
            raise InputError(path, "", f"cannot be written ({error.strerror})") from error
        self.problem = ""
        self._waiting = bytearray()
        self._flushed = 0.0

    def add(
        self,
        stamp_us: int,
        now: float,
        demand: Sequence[float],
        commands: Sequence[float],
        error: Sequence[float],
        latency_s: float,
        state: str,
    ) -> None:
        """One demand answered; see the module for units."""
        self._waiting += RECORD.pack(
            stamp_us, now, *demand, *commands, *error, latency_s, STATES.index(state)
        )

    def tick(self, now: float, *, handed_over: bool = False) -> None:
        """Write what waits if it is time, or if the vehicle was just handed back."""
        due = handed_over or now - self._flushed > FLUSH_S
        if self._waiting and (due or len(self._waiting) >= MOST_WAITING * RECORD.size):
            self._flushed = now
            self.flush()

    def flush(self) -> None:
        """Hand everything to the kernel."""
        waiting, self._waiting = self._waiting, bytearray()  # a thread that is still writing keeps its own
        if waiting and not self.problem:
            try:
                os.write(self._file, waiting)
            except OSError as error:  # flying matters more than the record of it
                self.problem = f"{self.path}: the record ends early ({error.strerror})"

    def close(self) -> None:
        """Flush and close."""
        self.flush()
        os.close(self._file)
