"""ESC telemetry that nothing measured: of a simulator that makes rpm and current of one number.

What a motor draws goes with the cube of its speed, and both are read by themselves. Where the current of an
ESC is a straight line over its rpm to the last digit, both were computed from the command: no rotor turned.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.logs.streams import TimeSeries
from coaxlink.data.resolution import resolution_of

Array = NDArray[np.float64]
ROWS, SPAN = 10, 100.0  # fewer, and less span than so many times the rounding, tell no line from a curve
ROUNDED_RPM = 1.0  # a whole number, rounded or cut off


def measured_escs(found: Sequence[TimeSeries | None], notes: list[str]) -> list[TimeSeries | None]:
    """These series of ESCs without those that were made up; a note says so."""
    made_up = [s is not None and _is_made_up(s) for s in found]
    if any(made_up):
        notes.append(
            "rpm left out: the current of each ESC is a straight line over its rpm to the last digit, as "
            "simulators make both of the command (PX4's SITL does); nothing measured them"
        )
    return [s for s, drop in zip(found, made_up, strict=True) if not drop]


def _is_made_up(series: TimeSeries) -> bool:
    """Whether both are in it and one of the other."""
    rpm: Array | None = next((c for name, c in series.columns.items() if name.startswith("rpm")), None)
    amps: Array | None = next((c for name, c in series.columns.items() if name.startswith("current")), None)
    return rpm is not None and amps is not None and on_a_line(rpm, amps)


def on_a_line(rpm: Array, amps: Array) -> bool:
    """Whether the current of an ESC (rows,) is a line over its rpm, to what their rounding leaves."""
    turning = (rpm > 0.0) & (amps > 0.0)
    x, y = rpm[turning], amps[turning]
    if len(np.unique(x)) < ROWS:
        return False
    slope, level = np.polyfit(x, y, 1)
    rounding = abs(slope) * ROUNDED_RPM + 0.5 * np.nan_to_num(resolution_of(y))
    return bool(np.ptp(y) > SPAN * rounding and np.max(np.abs(y - level - slope * x)) < rounding)
