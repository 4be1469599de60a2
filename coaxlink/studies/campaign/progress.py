"""How far a campaign is, at what rate, and how long it will take: a line on stderr."""

from __future__ import annotations

import time
from collections.abc import Callable

EVERY_S, EVERY_SCREEN_S = 10.0, 0.5


class Progress:
    """Say so at most every few seconds; `screen` writes one line over itself."""

    def __init__(self, total: int, done: int, what: str, write: Callable[[str], None], screen: bool) -> None:
        self._total, self._first, self._what, self._write, self._screen = total, done, what, write, screen
        self._began = time.monotonic()
        self._said = self._began - (EVERY_S if screen else EVERY_S - 2.0)  # a first line soon

    def at(self, done: int) -> None:
        """`done` of all are done."""
        now = time.monotonic()
        if now - self._said < (EVERY_SCREEN_S if self._screen else EVERY_S):
            return
        self._said = now
        self._write(("\r\x1b[K" if self._screen else "") + self.line(done) + ("" if self._screen else "\n"))

    def line(self, done: int) -> str:
        """As it is written."""
        rate = (done - self._first) / max(time.monotonic() - self._began, 1e-9)
        left = f", {duration((self._total - done) / rate)} left" if rate > 0.0 else ""
        return (
            f"{done} of {self._total} {self._what} ({100 * done // self._total} %), {rate:.3g} a second{left}"
        )

    def end(self, done: int) -> None:
        """The last word."""
        self._write(("\r\x1b[K" if self._screen else "") + self.line(done).partition(", 0 s left")[0] + "\n")


def duration(seconds: float) -> str:
    """In words."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"
