"""Are the motors driven by us? The outputs the autopilot reports, held against what we sent.

A line shows a companion only its own traffic: a second companion, or an autopilot that ignores us, shows in
ACTUATOR_OUTPUT_STATUS alone (pulse widths in us, taken as 1000 + 1000 u).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

WINDOW_S = 0.25  # a report may rest on anything sent within it
TOLERANCE = 0.02  # of full command
REPORTS = 25  # in a row before a verdict
REPORT_HZ = 50.0


class Witness:
    """`sent` and `reported` in; `rival` says that somebody else drives the motors."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._sent: deque[tuple[float, Sequence[float]]] = deque(maxlen=512)
        self.agreed = self.differed = 0  # reports in a row
        self.confirmed = False  # the outputs were ours at some time

    def sent(self, now: float, commands: Sequence[float]) -> None:
        """Commands (8,) went out."""
        self._sent.append((now, commands))

    def reported(self, now: float, outputs_us: Sequence[float]) -> None:
        """The autopilot's outputs while it flies, us. Judged only where we have been answering all along."""
        recent = [commands for t, commands in self._sent if now - t <= WINDOW_S]
        if not recent or self._sent[-1][0] < now - 0.05 or now - self._sent[0][0] < WINDOW_S:
            self.agreed = self.differed = 0
            return
        envelope = np.array(recent)[:, : self._count]
        u = (np.array(outputs_us[: self._count]) - 1000.0) / 1000.0
        inside = (u >= envelope.min(axis=0) - TOLERANCE) & (u <= envelope.max(axis=0) + TOLERANCE)
        if inside.all():
            self.agreed, self.differed = self.agreed + 1, 0
            self.confirmed = self.confirmed or self.agreed >= REPORTS
        else:
            self.agreed, self.differed = 0, self.differed + 1

    @property
    def rival(self) -> bool:
        """Whether the outputs have not been ours for as long as counts."""
        return self.differed >= REPORTS

    @property
    def why(self) -> str:
        """The verdict in words."""
        if self.confirmed:
            return "the motors no longer follow our commands: another companion drives them"
        return (
            "the motors do not follow our commands: another companion drives them, the autopilot ignores us, "
            "or its outputs are not 1000 to 2000 us"
        )
