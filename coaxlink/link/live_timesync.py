"""TIMESYNC (111) with the vehicle: its requests answered, its clock known, the age of a demand told.

Ours is answered with the vehicle's time between our two: offset = tc1 - (sent + heard) / 2, believed most
where the round trip was shortest. Times are monotonic here and since boot there; nothing in the loop depends
on them, so a vehicle that does not answer, or answers nonsense, changes nothing but the account.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import common as mavlink

if TYPE_CHECKING:
    from coaxlink.link.session import Session

PERIOD_S = 1.0
KEPT = 16  # round trips, of which the shortest counts
LONGEST_NS = 1_000_000_000  # a round trip beyond this tells nothing


class TimeSync:
    """`tick` often; `close` at the end."""

    def __init__(self, session: Session, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._session, self._clock = session, clock_ns
        self._asked = 0
        self._next = clock_ns()
        self._trips: deque[tuple[int, int]] = deque(maxlen=KEPT)  # (round trip, offset), ns
        self._leave = session.subscribe(self._hear)

    def tick(self) -> None:
        """Ask again if it is time."""
        now = self._clock()
        if now >= self._next:
            self._next, self._asked = now + round(PERIOD_S * 1e9), now
            self._session.send(mavlink.MAVLink_timesync_message(0, now))

    def close(self) -> None:
        """Listen no more."""
        self._leave()

    def _hear(self, message: Any) -> None:
        if message.get_type() != "TIMESYNC":
            return
        now = self._clock()
        if message.tc1 == 0:
            self._session.send(mavlink.MAVLink_timesync_message(now, message.ts1))
        elif message.ts1 == self._asked and 0 <= now - self._asked < LONGEST_NS:
            self._trips.append((now - self._asked, message.tc1 - (self._asked + now) // 2))
            self._asked = 0  # once

    @property
    def round_trip_s(self) -> float | None:
        """The shortest of late; None before an answer came."""
        return min(self._trips)[0] / 1e9 if self._trips else None

    def age_s(self, stamp_us: int, now_s: float) -> float | None:
        """How old a vehicle's stamp was at our time (s, monotonic); None before an answer came."""
        return now_s - (stamp_us * 1000 - min(self._trips)[1]) / 1e9 if self._trips else None
