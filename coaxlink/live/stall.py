"""A stop of our own (SIGSTOP, a starved processor) told apart from a silence of the vehicle.

While this process is stopped the kernel keeps the demands that came, and drops the newer ones when its buffer
is full: what is read first afterwards may be seconds old. It is not answered. And a heartbeat that nobody was
awake to hear does not count as missing.
"""

from __future__ import annotations

ASLEEP_S = 0.5  # a watcher that wakes so much later than it meant to was stopped
CATCH_UP_S = 0.1  # a line that is never empty ends the search for fresh demands after that


class Stall:
    """Which demands are leftovers of a stop; on the receiver thread. Times in s of one monotonic clock."""

    def __init__(self, longest_s: float) -> None:
        """A gap above `longest_s` is a stop, a demand so late by its stamp is old."""
        self._gap_s = longest_s
        self._here: float | None = None
        self._until = 0.0  # leftovers are looked for so long; 0 for not at all
        self._last: tuple[int | None, float] = (
            None,
            0.0,
        )  # stamp of the last demand before, and when it came
        self.count = 0
        self.longest_s = 0.0

    def turn(self, now: float, last_us: int | None, last_s: float) -> None:
        """A turn begins; the last demand dealt with bore `last_us` and came at `last_s`."""
        gap = now - self._here if self._here is not None else 0.0
        self._here = now
        if gap > self._gap_s:
            self.count += 1
            self.longest_s = max(self.longest_s, gap)
            self._until, self._last = now + CATCH_UP_S, (last_us, last_s)

    def leftover(self, stamp_us: int, now: float) -> bool:
        """Whether a demand came while we were stopped."""
        if now > self._until:
            return False
        last_us, last_s = self._last
        # fresh: the vehicle's clock has moved on as ours has
        fresh = last_us is not None and stamp_us >= last_us + (now - last_s - self._gap_s) * 1e6
        if fresh:
            self._until = 0.0
        return not fresh

    def caught_up(self) -> None:
        """The line was read empty: what comes from now on is new."""
        self._until = 0.0


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
