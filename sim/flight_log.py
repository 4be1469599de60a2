# mypy: disallow-untyped-defs=False
"""The contract's flight log: its columns, and a row of it (in plain Python and compiled)."""

from __future__ import annotations

import math

from sim.physics.sensing import R_ACCEL, R_HEIGHT, R_QUAT, R_RATES, R_SPEEDS, R_VEL, R_VOLT
from sim.px4.loops import euler


def columns(rotors: int) -> list[str]:
    """Of the log, in order."""
    body = [
        f"{kind}_{axis}_{unit}" for kind, unit in (("accel", "m_s2"), ("gyro", "rad_s")) for axis in "xyz"
    ]
    return [
        "time_s",
        *[f"motor{n}" for n in range(1, rotors + 1)],
        *body,
        *["roll_rad", "pitch_rad", "yaw_rad", "vel_n_m_s", "vel_e_m_s", "vel_d_m_s", "height_m", "voltage_V"],
        *[f"rpm{n}" for n in range(1, rotors + 1)],
    ]


def log_row(time, r, command, n, top, row):
    """One row of the contract's flight log: see `flights.columns`. Runs in plain Python, too."""
    row[0] = time
    for i in range(n):
        row[1 + i] = command[i]
        row[1 + n + 14 + i] = r[R_SPEEDS + i] * top * (30.0 / math.pi)
    at = 1 + n
    for k in range(3):
        row[at + k], row[at + 3 + k], row[at + 9 + k] = r[R_ACCEL + k], r[R_RATES + k], r[R_VEL + k]
    roll, pitch, yaw = euler((r[R_QUAT], r[R_QUAT + 1], r[R_QUAT + 2], r[R_QUAT + 3]))
    row[at + 6], row[at + 7], row[at + 8] = roll, pitch, yaw
    row[at + 12], row[at + 13] = r[R_HEIGHT], r[R_VOLT]
