"""How old a demand is, and whether it may be answered: by the vehicle's own clock, which TIMESYNC tells.

An old demand was made for another attitude. One that can be older than `Timing.oldest_s` draws nothing; nor
does one that is stamped in the future. Either it is late or the clock jumped (a reboot): only TIMESYNC can
tell these two apart, and is asked at once. A vehicle that does not answer it is judged by arrival spacing,
against the quickest demand so far: there a delay that never changes cannot be seen, and a clock that went
back is taken for a delay, so it is answered no more.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from coaxlink.live.guard import Timing
from coaxlink.live.timesync import DRIFT

if TYPE_CHECKING:
    from coaxlink.live.timesync import TimeSync

NO_CLOCK_US = 2**62  # a stamp beyond it is none: 146 000 years


class DemandAge:
    """`judge` every demand, in the order of arrival."""

    def __init__(self, sync: TimeSync, timing: Timing) -> None:
        """Where TIMESYNC is not answered for `sync_s` from the first demand on, arrival spacing counts."""
        self._sync, self._oldest_s, self._wait_s = sync, timing.oldest_s, timing.sync_s
        self._first_s: float | None = None
        self._spacing = Spacing(timing.oldest_s)
        self._last_us, self._jumps = -1, 0

    def judge(self, stamp_us: int, now_s: float) -> str:
        """Why not to answer a demand that came at `now_s`, as `Counters` names it; "" to answer."""
        if stamp_us >= NO_CLOCK_US:
            return "clock_jumps"
        by_spacing = self._spacing.age_s(stamp_us / 1e6, now_s)
        age = self._sync.oldest_s(stamp_us, now_s)
        if self._first_s is None:
            self._first_s = now_s
        if age is None:
            if now_s < self._first_s + self._wait_s:
                return "settling"
            age = by_spacing
        if self._jumps != self._sync.jumps or self._spacing.restarted:
            self._jumps, self._last_us = self._sync.jumps, -1  # stamps begin anew
        if abs(age) > self._oldest_s:
            self._sync.doubt()
            return "stale" if age > 0 else "clock_jumps"
        if stamp_us <= self._last_us:
            return "late"
        self._last_us = stamp_us
        return ""


class Spacing:
    """Age against the quickest demand so far, the vehicle's clock being unknown."""

    def __init__(self, oldest_s: float) -> None:
        self._oldest_s = oldest_s
        self._ahead: float | None = None  # of our clock, the vehicle's by its quickest demand (s)
        self._at = 0.0
        self._doubtful: float | None = None
        self.restarted = False

    def age_s(self, stamp_s: float, now_s: float) -> float:
        """Seconds beyond the quickest; negative: far quicker, which two in a row have to say."""
        ahead, self.restarted = stamp_s - now_s, False
        if self._ahead is None:
            self._ahead, self._at = ahead, now_s
        known = self._ahead - DRIFT * (now_s - self._at)
        age, doubtful, self._doubtful = known - ahead, self._doubtful, None
        if age < -self._oldest_s:
            self._doubtful = ahead
            if doubtful is None or abs(ahead - doubtful) > self._oldest_s:
                return age
            self.restarted = True
        if age <= 0.0:
            self._ahead, self._at, age = ahead, now_s, 0.0
        return age
