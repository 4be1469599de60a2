"""Which demand is answered: the newest of several that wait, and none that waited while we were stopped."""

from __future__ import annotations

from typing import Any

from coaxlink.live.counts import Counters
from coaxlink.live.stall import Stall
from coaxlink.mavlink.transport import Polled

PATIENCE_S = 0.004  # newer demands may keep an answer waiting so long, and no longer
Demand = tuple[Any, ...]  # fields of ACTUATOR_CONTROL_TARGET, in wire order


class Inbox:
    """One demand at most, on the receiver thread; what it leaves out is counted as superseded."""

    def __init__(self, stall: Stall, counters: Counters) -> None:
        self._stall, self._counters = stall, counters
        self._demand: Demand | None = None
        self._since_s = 0.0
        self.line = Polled()

    @property
    def empty(self) -> bool:
        """Whether nothing waits for an answer."""
        return self._demand is None

    def put(self, demand: Demand, now: float) -> None:
        """A demand came; one that still waits gives way to it."""
        if self._demand is None:
            self._since_s = now
        else:
            self._counters.superseded += 1
        self._demand = demand

    def due(self, now: float, fileno: int) -> Demand | None:
        """The demand to answer now; None where a newer one can be read first, and for leftovers of a stop."""
        if self._demand is None:
            return None
        more = self.line.readable(fileno)
        if more and now - self._since_s <= PATIENCE_S:
            return None
        demand, self._demand = self._demand, None
        if self._stall.leftover(demand[0], now, more):
            self._counters.superseded += 1
            return None
        return demand
