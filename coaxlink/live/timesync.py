"""TIMESYNC (111) with the vehicle: its requests answered, its clock known, the age of a demand bounded.

The vehicle's time tc1 in an answer lies between our two, so its clock is ahead of ours by `tc1 - heard` at
least and by `tc1 - sent` at most. Every answer narrows the two bounds, DRIFT widens them again; an answer
that contradicts them is a clock that jumped (a reboot), and begins them anew. However slow the way back, the
upper bound is as good as the quickest way out. Times are monotonic here and since boot there.

Questions asked while the vehicle was flown by our commands are counted, and their answers: they went the
same way as the commands (`live.arrival`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import common as mavlink

if TYPE_CHECKING:
    from coaxlink.mavlink.session import Session

PERIOD_S = 0.2
AT_ONCE_S = 0.05  # least between questions that a doubtful demand asks for
DRIFT = 1e-4  # between two clocks: crystals of 50 ppm each, as data sheets bound them over temperature
LOST_NS = 1_000_000_000  # unanswered for so long counts as lost on the way
LONGEST_NS = 10_000_000_000  # an answer later than this tells nothing; `mix` takes the link for lost by then


class TimeSync:
    """`tick` often; `close` at the end."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._pending: dict[int, bool] = {}  # when, of those still open, and whether it counts
        self.requested = self.answered = 0  # of those that count and are settled
        self.jumps = 0  # how often the vehicle's clock was found to be another
        self.round_trip_s: float | None = None  # the shortest since the clock began
        self._next = self._doubted = 0
        self._bounds: tuple[int, int, int] | None = None  # when, offset at least, at most (ns)
        self._leave = session.subscribe(self._hear)

    def tick(self, flying: bool = False) -> None:
        """Ask again if it is time; it counts when the vehicle is `flying` on our commands."""
        now = self._now_ns()
        if now < self._next:
            return
        for when in [t for t in self._pending if now - t >= LOST_NS]:
            self.requested += self._pending[when]
            self._pending[when] = False
            if now - when >= LONGEST_NS:
                del self._pending[when]
        self._next = now + round(PERIOD_S * 1e9)
        self._ask(now, flying)

    def doubt(self) -> None:
        """A stamp did not fit the clock: ask at once which of them is wrong."""
        now = self._now_ns()
        if now >= self._doubted + round(AT_ONCE_S * 1e9):
            self._doubted = now
            self._ask(now, False)

    def close(self) -> None:
        """Listen no more."""
        self._leave()

    def _ask(self, now: int, counts: bool) -> None:
        self._pending[now] = counts
        self._session.send(mavlink.MAVLink_timesync_message(0, now))

    def _hear(self, message: Any) -> None:
        if message.get_type() != "TIMESYNC":
            return
        now = self._now_ns()
        if message.tc1 == 0:
            self._session.send(mavlink.MAVLink_timesync_message(now, message.ts1))
        elif message.ts1 in self._pending and 0 <= now - message.ts1 < LONGEST_NS:
            counts = self._pending.pop(message.ts1)  # once
            self.requested, self.answered = self.requested + counts, self.answered + counts
            self._learn(now, message.ts1, message.tc1)

    def _learn(self, heard: int, sent: int, vehicle: int) -> None:
        least, most, trip_s = vehicle - heard, vehicle - sent, (heard - sent) / 1e9
        if (known := self._at(heard)) is not None:
            if least > known[1] or most < known[0]:
                self.jumps, known, self.round_trip_s = self.jumps + 1, None, None
            else:
                least, most = max(least, known[0]), min(most, known[1])
        self.round_trip_s = min(trip_s, self.round_trip_s or trip_s)
        self._bounds = (heard, least, most)

    def _at(self, now: int) -> tuple[int, int] | None:
        """How far the vehicle's clock is ahead of ours, at least and at most (ns); None: not known."""
        if self._bounds is None:
            return None
        when, least, most = self._bounds
        widened = round(DRIFT * (now - when))
        return least - widened, most + widened

    def _now_ns(self) -> int:
        return round(self._session.clock.monotonic() * 1e9)

    @property
    def known(self) -> bool:
        """Whether the vehicle ever answered."""
        return self._bounds is not None

    def age_s(self, stamp_us: int, now_s: float) -> float | None:
        """How old a vehicle's stamp was at our time (s, monotonic), as likely as not; None: no answer yet."""
        now = round(now_s * 1e9)
        found = self._at(now)
        return None if found is None else (now - stamp_us * 1000 + sum(found) // 2) / 1e9

    def oldest_s(self, stamp_us: int, now_s: float) -> float | None:
        """How old it was at most: by the quickest way out, an answer to it could be there no younger."""
        now = round(now_s * 1e9)
        found = self._at(now)
        return None if found is None else (now - stamp_us * 1000 + found[1]) / 1e9
