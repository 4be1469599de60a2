"""Motors turned on the bench, disarmed: which, how fast and until when."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LONGEST_S = 3.0


class MotorTest:
    """One command a motor, each for a while of the vehicle's clock."""

    def __init__(self, motors: int) -> None:
        self._motors = motors
        self._running: dict[int, tuple[float, float]] = {}

    def turn(
        self, motor: int, command: float, seconds: float, now_s: float, longest_s: float = LONGEST_S
    ) -> bool:
        """Turn `motor` (from 0) at a command of 0..1; False when there is none."""
        if not 0 <= motor < self._motors:
            return False
        until = now_s + (min(seconds, longest_s) if seconds > 0 else longest_s)
        self._running[motor] = (min(max(command, 0.0), 1.0), until)
        return True

    def commands(self, now_s: float) -> NDArray[np.float64]:
        """(N,) now; those whose time is over stand."""
        self._running = {m: (u, until) for m, (u, until) in self._running.items() if now_s < until}
        out = np.zeros(self._motors)
        for motor, (command, _) in self._running.items():
            out[motor] = command
        return out
