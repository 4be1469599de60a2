"""The clock that sessions, loops, uploaders and screens take: the machine's, or one that a test turns."""

from __future__ import annotations

import heapq
import itertools
import threading
import time
from collections.abc import Callable
from typing import Protocol


class Clock(Protocol):
    """All times in seconds."""

    def monotonic(self) -> float:
        """Now; never set back."""

    def sleep(self, seconds: float) -> None:
        """Let so much time pass."""

    def wait(self, event: threading.Event, seconds: float) -> bool:
        """Let time pass until the event is set, `seconds` at most; whether it is set."""


class SystemClock:
    """The machine's monotonic clock."""

    # staticmethods: no Python frame of ours around a call that is made at the rate of the demand
    monotonic = staticmethod(time.monotonic)
    sleep = staticmethod(time.sleep)

    @staticmethod
    def wait(event: threading.Event, seconds: float) -> bool:
        return event.wait(seconds)


SYSTEM = SystemClock()
NEVER = threading.Event()


class VirtualClock:
    """Time that passes only in `sleep` and `wait`, as fast as the processor goes; for one thread.

    What others do meanwhile is handed in by `later`: it is called in order of time, while somebody sleeps.
    """

    def __init__(self, now: float = 1000.0) -> None:
        self.now = now
        self._order = itertools.count()
        self._later: list[tuple[float, int, Callable[[], None]]] = []

    def monotonic(self) -> float:
        return self.now

    def later(self, seconds: float, what: Callable[[], None]) -> None:
        """Call `what` when so many seconds from now have passed."""
        heapq.heappush(self._later, (self.now + seconds, next(self._order), what))

    def sleep(self, seconds: float) -> None:
        self.wait(NEVER, seconds)

    def wait(self, event: threading.Event, seconds: float) -> bool:
        end = self.now + max(seconds, 0.0)
        while not event.is_set() and self._later and self._later[0][0] <= end:
            at, _, what = heapq.heappop(self._later)
            self.now = max(self.now, at)
            what()
        if not event.is_set():
            self.now = max(self.now, end)
        return event.is_set()
