"""Flights without a client: the autopilot follows a fixed plan as fast as it goes, and a log is kept.

The same seed and the same world give the same bytes: nothing here looks at a clock.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.documents import write_atomic
from sim.flight_log import columns, log_row
from sim.physics.plant import Plant
from sim.px4.autopilot import RATE_HZ, Autopilot, Mode
from sim.px4.cascade import Goal
from sim.quick.plans import on_circle

LOG_EVERY = 2  # steps of the autopilot a row: 125 Hz


def paper(t: float) -> Goal:
    """Hover at 3 m, then the circle of 2 m around 4.5 m (the paper, section 5.3); entered at rest."""
    if t < 15.0:
        return Goal((0.0, 0.0, -3.0), (0.0, 0.0, 0.0))
    s = min((t - 15.0) / 5.0, 1.0)
    ease, slope = s**3 * (10 - 15 * s + 6 * s * s), 30 * (s * (1 - s)) ** 2 / 5.0
    if t < 20.0:
        bend = 60.0 * s * (1 - s) * (1 - 2 * s) / 25.0
        return Goal(
            (2.0 * ease, 0.0, -3.0 - 1.5 * ease),
            (2.0 * slope, 0.0, -1.5 * slope),
            (2.0 * bend, 0.0, -1.5 * bend),
        )
    return circle(t - 20.0, 2.0, -4.5, 8.0)


def circle(t: float, radius: float, down: float, period: float) -> Goal:
    """From (radius, 0), the rate rising over 3 s."""
    n, e, vn, ve, an, ae = map(float, on_circle(t, radius, period))
    return Goal((n, e, down), (vn, ve, 0.0), (an, ae, 0.0))


def vigorous(t: float) -> Goal:
    """Everything a residual may ask for: fast circles, climbs, yaw, low passes."""
    w = 2 * math.pi / 4.5
    low = 0.5 * (1 - math.cos(2 * math.pi * t / 31.0))
    z, vz = -4.0 + 3.3 * low, 3.3 * math.pi / 31.0 * math.sin(2 * math.pi * t / 31.0)
    z, vz = z - 0.4 * math.sin(1.7 * t), vz - 0.68 * math.cos(1.7 * t)
    x, y = 2.5 * math.sin(w * t), 2.0 * math.sin(0.73 * t)
    return Goal(
        (x, y, min(z, -0.45)),
        (2.5 * w * math.cos(w * t), 1.46 * math.cos(0.73 * t), vz),
        yaw=math.sin(0.4 * t),
    )


PLANS: dict[str, tuple[Callable[[float], Goal], float]] = {
    "paper": (paper, 52.0),
    "vigorous": (vigorous, 70.0),
}


def fly(
    autopilot: Autopilot, plan: str, watch: Callable[[Plant], None] | None = None
) -> dict[str, NDArray[np.float64]]:
    """Arm, take off, follow, land; columns (rows,) of the contract's flight log.

    `watch` is shown the plant at every row.
    """
    follow, seconds = PLANS[plan]
    rows: list[list[float]] = []

    def run(until: Callable[[], bool], limit_s: float, start: float | None = None) -> None:
        for _ in range(round(limit_s * RATE_HZ)):
            if start is not None:
                autopilot.offboard(follow(autopilot.plant.time_s - start))
            autopilot.step()
            if (autopilot.plant.steps * RATE_HZ // 1000) % LOG_EVERY == 0:
                rows.append(row(autopilot))
                if watch is not None:
                    watch(autopilot.plant)
            if until():
                return

    autopilot.arm()
    autopilot.take_off(-follow(0.0).position[2])
    run(lambda: autopilot.mode == Mode.HOLD, 20.0)
    run(lambda: False, 3.0)
    autopilot.offboard(follow(0.0))
    autopilot.set_mode(Mode.OFFBOARD)
    run(lambda: False, seconds, autopilot.plant.time_s)
    autopilot.set_mode(Mode.LAND)
    run(lambda: not autopilot.armed, 60.0)
    return dict(zip(columns(autopilot.rotors), np.array(rows).T, strict=True))


def row(a: Autopilot) -> list[float]:
    """One row: the last reading, and the commands it led to."""
    out = np.empty(15 + 2 * a.rotors)
    top = a.plant.pair.speed_max_rpm * math.pi / 30.0
    log_row(a.reading.time_s, a.reading.values, a.command, a.rotors, top, out)
    return out.tolist()


def write_flight(path: Path, log: dict[str, NDArray[np.float64]]) -> None:
    """The log as CSV, whole or not at all. Raises WorldError."""
    digits = {"time_s": 4, "voltage_V": 3, "height_m": 3}
    form = [f"%.{1 if name.startswith('rpm') else digits.get(name, 6)}f" for name in log]
    line = ",".join(form)
    rows = np.column_stack(list(log.values())).tolist()
    write_atomic(path, "\n".join([",".join(log), *[line % tuple(row) for row in rows]]) + "\n")
