"""TIMESYNC (111) with the vehicle: its requests answered, its clock known, the age of a demand told.

Ours is answered with the vehicle's time between our two: offset = tc1 - (sent + heard) / 2, believed most
where the round trip was shortest. Times are monotonic here and since boot there; nothing in the loop depends
on them, so a vehicle that does not answer, or answers nonsense, changes nothing but the account.

Questions asked while the vehicle was flown by our commands are counted, and their answers: they went the
same way as the commands (`live_arrival`).
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import common as mavlink

if TYPE_CHECKING:
    from coaxlink.mavlink.session import Session

PERIOD_S = 0.2
KEPT = 16  # round trips, of which the shortest counts
LONGEST_NS = 1_000_000_000  # a round trip beyond this tells nothing


class TimeSync:
    """`tick` often; `close` at the end."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._pending: dict[int, bool] = {}  # when, of those still open, and whether it counts
        self.requested = self.answered = 0  # of those that count and are settled
        self._next = 0
        self._trips: deque[tuple[int, int]] = deque(maxlen=KEPT)  # (round trip, offset), ns
        self._leave = session.subscribe(self._hear)

    def tick(self, flying: bool = False) -> None:
        """Ask again if it is time; it counts when the vehicle is `flying` on our commands."""
        now = self._now_ns()
        if now >= self._next:
            for when in [t for t in self._pending if now - t >= LONGEST_NS]:
                self.requested += self._pending.pop(when)
            self._next, self._pending[now] = now + round(PERIOD_S * 1e9), flying
            self._session.send(mavlink.MAVLink_timesync_message(0, now))

    def close(self) -> None:
        """Listen no more."""
        self._leave()

    def _hear(self, message: Any) -> None:
        if message.get_type() != "TIMESYNC":
            return
        now = self._now_ns()
        if message.tc1 == 0:
            self._session.send(mavlink.MAVLink_timesync_message(now, message.ts1))
        elif message.ts1 in self._pending and 0 <= now - message.ts1 < LONGEST_NS:
            counts = self._pending.pop(message.ts1)  # once
            self.requested, self.answered = self.requested + counts, self.answered + counts
            self._trips.append((now - message.ts1, message.tc1 - (message.ts1 + now) // 2))

    def _now_ns(self) -> int:
        return round(self._session.clock.monotonic() * 1e9)

    @property
    def round_trip_s(self) -> float | None:
        """The shortest of late; None before an answer came."""
        return min(self._trips)[0] / 1e9 if self._trips else None

    def age_s(self, stamp_us: int, now_s: float) -> float | None:
        """How old a vehicle's stamp was at our time (s, monotonic); None before an answer came."""
        return now_s - (stamp_us * 1000 - min(self._trips)[1]) / 1e9 if self._trips else None
