"""How many motor commands never arrived, by what the vehicle itself says.

ArduPilot: the bridge counts the commands it took and says so in every demand. PX4 counts nothing; there
the larger of two losses counts: the share of its reports of outputs that were not our commands (`Witness`),
and that of questions on the same way (TIMESYNC) that it did not answer, less what is lost on the way back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from coaxlink.live.timesync import TimeSync
from coaxlink.live.witness import Witness

ENOUGH = 20  # samples below which nothing is concluded
NOTEWORTHY = 0.1  # share of the commands; more, and the run was not what it was taken for
SURE = 2.33  # standard deviations: 99 %, one-sided
IN_FLIGHT = 3  # commands that the bridge had no time to count yet


@dataclass(frozen=True)
class Arrival:
    """`missing` of `observed` samples say no; of `sent` commands that makes `never`."""

    sent: int
    observed: int
    missing: float
    by: str

    @property
    def share(self) -> float:
        """Of the commands that never arrived."""
        return min(max(self.missing / self.observed, 0.0), 1.0) if self.observed else 0.0

    @property
    def never(self) -> int:
        """Commands that never arrived."""
        return round(self.share * self.sent)

    @property
    def noteworthy(self) -> bool:
        """Whether more than NOTEWORTHY were lost, beyond the chance of so few samples."""
        n, q = self.observed, NOTEWORTHY
        return n >= ENOUGH and self.missing > n * q + SURE * math.sqrt(n * q * (1.0 - q))

    def to_json(self) -> dict[str, Any]:
        """As `coaxlink mix --json` has it."""
        return {"sent": self.sent, "never_arrived": self.never, "share": self.share, "by": self.by}


class Count:
    """A counter that is sent modulo `modulus`, from the first value on."""

    def __init__(self, modulus: int) -> None:
        self._modulus = modulus
        self._last: int | None = None
        self.total = 0
        self.moved = False

    def hear(self, value: float) -> None:
        """The value as it stands now; what is no such value, or a counter that began anew, adds nothing."""
        if not (0 <= value < self._modulus and value == int(value)):
            return
        step = (int(value) - self._last) % self._modulus if self._last is not None else 0
        self._last = int(value)
        if step < self._modulus // 16:
            self.total += step
            self.moved = self.moved or step > 0


def by_bridge(sent: int, taken: Count, acknowledged: bool) -> Arrival | None:
    """The bridge's own count; None for a script of an older coaxlink, which follows and has none."""
    if acknowledged and not taken.moved:
        return None
    return Arrival(sent, sent, max(sent - taken.total - IN_FLIGHT, 0), "bridge")


def by_questions(sent: int, requested: int, answered: int, lost_back: float) -> Arrival:
    """Of `requested` answers so many came, and a share `lost_back` of its words does not reach us."""
    reached = answered / max(1.0 - lost_back, 1e-9)
    return Arrival(sent, requested, max(requested - reached, 0.0), "timesync")


def by_vehicle(sent: int, witness: Witness | None, sync: TimeSync | None, lost_back: float) -> Arrival | None:
    """The larger loss of outputs and questions; None where there are too few of both."""
    found = []
    if witness is not None:
        found.append(Arrival(sent, witness.reports, witness.strangers, "outputs"))
    if sync is not None and sync.answered:
        found.append(by_questions(sent, sync.requested, sync.answered, lost_back))
    return max((a for a in found if a.observed >= ENOUGH), key=lambda a: a.share, default=None)
