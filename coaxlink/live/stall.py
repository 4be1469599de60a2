"""A stop of our own (SIGSTOP, a starved processor) distinguished from a silence of the vehicle.

The demands that waited meanwhile are old, and `live.age` finds them so. A heartbeat that nobody was awake to
hear does not count as missing.
"""

from __future__ import annotations

ASLEEP_S = 0.5  # a watcher that wakes so much later than it meant to was stopped


class Stall:
    """Counts our stops; on the receiver thread."""

    def __init__(self, longest_s: float) -> None:
        """A gap between turns above `longest_s` is a stop."""
        self._gap_s = longest_s
        self._here: float | None = None
        self.count = 0
        self.longest_s = 0.0

    def turn(self, now: float) -> None:
        """A turn begins, at `now` (s, monotonic)."""
        gap = now - self._here if self._here is not None else 0.0
        self._here = now
        if gap > self._gap_s:
            self.count += 1
            self.longest_s = max(self.longest_s, gap)


class Absence:
    """How long the vehicle has been silent while we were there to hear it; asked every `poll_s`."""

    def __init__(self, now: float, poll_s: float) -> None:
        self._asleep_s = poll_s + ASLEEP_S
        self._last = self._since = now
        self.slept_s = 0.0  # the stop that the last call found, 0 for none

    def silent_s(self, now: float, heard_s: float) -> float:
        """Seconds of silence at `now`, the vehicle's last word having come at `heard_s`."""
        gap, self._last = now - self._last, now
        self.slept_s = gap if gap > self._asleep_s else 0.0
        if self.slept_s:
            self._since = now
        return now - max(heard_s, self._since)
