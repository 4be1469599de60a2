"""Logs over MAVLink's own log messages: a list (LOG_REQUEST_LIST), and pieces of 90 bytes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as m

from sim.line.wire import Clock

PIECE = 90
PIECES_HZ = 4000.0  # a second of wall time
AT_ONCE = 60


class LogTransfer:
    """What one peer asks for of the card's logs, numbered from `first`."""

    def __init__(self, autopilot: Any, send: Callable[[Any], None], first: int, clock: Clock) -> None:
        self._autopilot, self._send, self._first, self._clock = autopilot, send, first, clock
        self._number, self._at, self._end = 0, 0, 0
        self._data = b""
        self._sent_at = 0.0
        self.handlers: dict[str, Callable[[Any], None]] = {
            "LOG_REQUEST_LIST": self._list,
            "LOG_REQUEST_DATA": self._request,
            "LOG_REQUEST_END": self._stop,
            "LOG_ERASE": self._erase,
        }

    def _logs(self) -> list[str]:
        return [] if self._autopilot.logger is None else self._autopilot.logger.listed()

    def _list(self, message: Any) -> None:
        logs = self._logs()
        last = self._first + len(logs) - 1
        if not logs:
            self._send(m.MAVLink_log_entry_message(0, 0, 0, 0, 0))
        for number, path in enumerate(logs, self._first):
            if message.start <= number <= message.end:
                size = len(self._autopilot.files.files[path])
                self._send(m.MAVLink_log_entry_message(number, len(logs), last, 0, size))

    def _request(self, message: Any) -> None:
        logs, index = self._logs(), message.id - self._first
        if not 0 <= index < len(logs):
            return
        self._data = bytes(self._autopilot.files.files[logs[index]])
        self._number, self._at = message.id, message.ofs
        self._end = min(message.ofs + message.count, len(self._data))
        self._sent_at = self._clock()
        if self._at >= self._end:  # nothing there: an empty piece says so
            self._send(m.MAVLink_log_data_message(message.id, message.ofs, 0, [0] * PIECE))

    def go_on(self) -> None:
        """Send what the link takes now."""
        if self._at >= self._end:
            return
        now = self._clock()
        share = int(min((now - self._sent_at) * PIECES_HZ, AT_ONCE))
        if share:
            self._sent_at = now
        for _ in range(share):
            if self._at >= self._end:
                return
            piece = self._data[self._at : min(self._at + PIECE, self._end)]
            data = list(piece.ljust(PIECE, b"\0"))
            self._send(m.MAVLink_log_data_message(self._number, self._at, len(piece), data))
            self._at += len(piece)

    def _stop(self, message: Any) -> None:
        self._end = 0

    def _erase(self, message: Any) -> None:
        self._end = 0
        if not self._autopilot.armed:
            for path in self._logs():
                del self._autopilot.files.files[path]
