"""Are the motors driven by us? The outputs the autopilot reports, held against what we sent.

A line shows a companion only its own traffic: a second companion, or an autopilot that ignores us, shows in
ACTUATOR_OUTPUT_STATUS alone (pulse widths in us, taken as 1000 + 1000 u).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import takewhile
from typing import TYPE_CHECKING

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

if TYPE_CHECKING:
    from coaxlink.mavlink.session import Session

WINDOW_S = 0.25  # a report may rest on anything sent within it
GAP_S = 0.05  # after a longer pause in our answers the outputs are not ours for a while, rightly
TOLERANCE = 0.02  # of full command
REPORT_HZ = 50.0
REPORTS = 50  # the newest judged
STRANGE = 20  # so many of them not ours: two companions take turns, neither is lost track of for long
NEWCOMER_STRANGE = 8  # the one that never had the motors to itself is the one to go
SURE = 25  # so many in a row ours: the outputs can be read
FLYING = (mavlink.MAV_LANDED_STATE_IN_AIR, mavlink.MAV_LANDED_STATE_TAKEOFF, mavlink.MAV_LANDED_STATE_LANDING)


def flying(session: Session) -> bool:
    """Whether the autopilot says that it is armed and off the ground."""
    state = session.latest("EXTENDED_SYS_STATE")
    return bool(session.armed) and state is not None and state.landed_state in FLYING


class Witness:
    """`sent` and `reported` in; `rival` says that somebody else drives the motors."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._sent: deque[tuple[float, Sequence[float]]] = deque(maxlen=512)
        self._since = 0.0  # we have been answering without a pause
        self._judged: deque[bool] = deque(maxlen=REPORTS)
        self._agreed = 0
        self.confirmed = False  # the outputs were ours at some time
        self.reports = self.strangers = 0  # judged, and of them not ours

    def sent(self, now: float, commands: Sequence[float]) -> None:
        """Commands (8,) went out."""
        if not self._sent or now - self._sent[-1][0] > GAP_S:
            self._since = now
        self._sent.append((now, commands))

    def reported(self, now: float, outputs_us: Sequence[float]) -> None:
        """The autopilot's outputs while it flies, us. Judged only where we have been answering all along."""
        if not self._sent or now - self._sent[-1][0] > GAP_S or now - self._since < WINDOW_S:
            return
        recent = takewhile(lambda sent: now - sent[0] <= WINDOW_S, reversed(self._sent))
        envelope = np.array([c[: self._count] for _, c in recent])
        u = (np.array(outputs_us[: self._count]) - 1000.0) / 1000.0
        inside = (u >= envelope.min(axis=0) - TOLERANCE) & (u <= envelope.max(axis=0) + TOLERANCE)
        ours = bool(inside.all())
        self._judged.append(ours)
        self.reports, self.strangers = self.reports + 1, self.strangers + (not ours)
        self._agreed = self._agreed + 1 if ours else 0
        self.confirmed = self.confirmed or self._agreed >= SURE

    @property
    def rival(self) -> bool:
        """Whether the outputs have not been ours for as long as counts."""
        return self._judged.count(False) >= (STRANGE if self.confirmed else NEWCOMER_STRANGE)

    @property
    def why(self) -> str:
        """The verdict in words."""
        if self.confirmed:
            return "the motors no longer follow our commands: another companion drives them"
        return (
            "the motors do not follow our commands: another companion drives them, the autopilot ignores us, "
            "or its outputs are not 1000 to 2000 us"
        )
