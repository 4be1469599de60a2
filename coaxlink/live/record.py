"""What the live loop did, a fixed record a demand, on disk within a quarter of a second.

Whole records go to the kernel in one write, so that a killed process loses the last FLUSH_S at most and
leaves a file that reads to its end. What it holds stands with its reader, `data.logs.live_record`.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from coaxlink.data.logs.live_record import MAGIC, RECORD
from coaxlink.errors import InputError
from coaxlink.live.guard import STATES

FLUSH_S = 0.25
MOST_WAITING = 1024  # records; more are written at once, whatever the clock says


class LiveRecord:
    """Append-only. Raises InputError if the file cannot be made; a full disk later ends only the record.

    The receiver thread adds and writes. Whoever ends the loop closes, while that thread may be at its last
    demand: what comes after `close` is dropped.
    """

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
        self._turn, self._closed = threading.Lock(), False

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
        row = RECORD.pack(stamp_us, now, *demand, *commands, *error, latency_s, STATES.index(state))
        with self._turn:
            self._waiting += row

    def tick(self, now: float, *, handed_over: bool = False) -> None:
        """Write what waits if it is time, or if the vehicle was just handed back."""
        due = handed_over or now - self._flushed > FLUSH_S
        if self._waiting and (due or len(self._waiting) >= MOST_WAITING * RECORD.size):
            self._flushed = now
            self.flush()

    def flush(self) -> None:
        """Hand everything to the kernel."""
        with self._turn:
            self._write()

    def close(self) -> None:
        """Flush and close."""
        with self._turn:
            self._write()
            if not self._closed:
                os.close(self._file)
            self._closed = True

    def _write(self) -> None:
        if self._waiting and not self.problem and not self._closed:
            try:
                os.write(self._file, self._waiting)
            except OSError as error:  # flying matters more than the record of it
                self.problem = f"{self.path}: the record ends early ({error.strerror})"
        self._waiting.clear()
