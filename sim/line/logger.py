"""Flight logs on the card, written while the autopilot flies: what both firmwares do alike.

Stamps are the vehicle's own (from 1 s after boot), as in telemetry; the day is not known to it.
"""

from __future__ import annotations

from typing import Any

MOST_BYTES = 48 * 1024 * 1024  # bytes of one log: an hour and more; further on nothing is written
KEPT = 20  # logs; the oldest goes


class Logger:
    """Opens, fills and closes logs of one autopilot; `record` is called after every step."""

    suffix = ""

    def __init__(self, autopilot: Any) -> None:
        self.autopilot = autopilot
        self._log: bytearray | None = None
        self._due: dict[str, int] = {}  # stamp of each topic's next row, us
        self._changed: list[str] = []
        autopilot.store.listen(self._changed.append)
        autopilot.logger = self

    def wanted(self) -> bool:
        """Whether a log is to run now."""
        raise NotImplementedError

    def path(self) -> str:
        """Of the next log."""
        raise NotImplementedError

    def begin(self) -> bytes:
        """What a log starts with."""
        raise NotImplementedError

    def rows(self, now_us: int) -> bytes:
        """What this step adds."""
        raise NotImplementedError

    def text(self, severity: int, text: str) -> bytes:
        """A line for the log."""
        raise NotImplementedError

    def parameters(self, names: list[str]) -> bytes:
        """Parameters that changed."""
        raise NotImplementedError

    def logs(self) -> list[str]:
        """Paths of all there are, oldest first."""
        return sorted(p for p in self.autopilot.files.files if p.endswith(self.suffix))

    def listed(self) -> list[str]:
        """Paths in the order in which MAVLink's log messages number them."""
        return self.logs()

    def record(self, now_us: int) -> None:
        """One step."""
        if not self.wanted():
            self.close()
            return
        if self._log is None:
            self._log = bytearray(self.begin())
            self._due.clear()
            self.autopilot.files.files[self.path()] = self._log
            for old in self.logs()[:-KEPT]:
                del self.autopilot.files.files[old]
        elif self._changed:
            self._log += self.parameters(list(dict.fromkeys(self._changed)))
        self._changed.clear()
        if len(self._log) < MOST_BYTES:
            self._log += self.rows(now_us)

    def close(self) -> None:
        """The log is whole."""
        self._log = None
        self._changed.clear()

    def say(self, severity: int, text: str) -> None:
        """What the autopilot says stands in its log too."""
        if self._log is not None:
            self._log += self.text(severity, text)

    def due(self, topic: str, now_us: int, hz: float) -> bool:
        """Whether a topic of this rate is to be written at this step."""
        next_us = self._due.get(topic, 0)
        if now_us + 1 < next_us:
            return False
        self._due[topic] = max(next_us + round(1e6 / hz), now_us + round(0.5e6 / hz))
        return True
