# mypy: disallow-untyped-defs=False
"""A reading of the plant in one array: the same function for the stand-in's sensors and for batch flights."""

from __future__ import annotations

import math

from sim.physics.layout import O_FORCE, SPEED, VOLTAGE

# a reading: specific force, rates, attitude, position, velocity, height, voltage, speeds (N)
R_ACCEL, R_RATES, R_QUAT, R_POS, R_VEL, R_HEIGHT, R_VOLT, R_SPEEDS = 0, 3, 6, 10, 13, 16, 17, 18
# sensors: biases of accelerometer and gyro, what of the wandering is kept and fresh, its two stages
S_ACCEL_BIAS, S_GYRO_BIAS, S_KEEP, S_FRESH, S_PUSH, S_WANDER, S_SHAKE, S_BLADES, SENSES = (
    0, 3, 6, 15, 24, 33, 42, 43, 44,
)  # fmt: skip


def read(state, out, top, ground, s, noise, turns, dt, r):
    """Fill a reading from the plant: see `sensors.Sensors.read`."""
    n = len(turns)
    for k in range(9):
        s[S_PUSH + k] = s[S_KEEP + k] * s[S_PUSH + k] + s[S_FRESH + k] * noise[6 + k]
        s[S_WANDER + k] = (
            s[S_KEEP + k] * s[S_WANDER + k] + math.sqrt(2.0) * (1.0 - s[S_KEEP + k]) * s[S_PUSH + k]
        )
    h0, h1, h2 = 0.5 * s[S_WANDER], 0.5 * s[S_WANDER + 1], 0.5 * s[S_WANDER + 2]
    q0, q1, q2, q3 = state[6], state[7], state[8], state[9]
    r[R_QUAT] = q0 - q1 * h0 - q2 * h1 - q3 * h2
    r[R_QUAT + 1] = q1 + q0 * h0 + q2 * h2 - q3 * h1
    r[R_QUAT + 2] = q2 + q0 * h1 + q3 * h0 - q1 * h2
    r[R_QUAT + 3] = q3 + q0 * h2 + q1 * h1 - q2 * h0
    shaken0 = shaken1 = shaken2 = 0.0
    if s[S_SHAKE] != 0.0:
        for i in range(n):
            u = state[SPEED + i]
            turns[i] += dt * top * u * s[S_BLADES]
            strength = s[S_SHAKE] * u * u
            shaken0 += math.cos(turns[i]) * strength
            shaken1 += math.sin(turns[i]) * strength
            shaken2 += 0.3 * math.cos(turns[i]) * strength
    for k in range(3):
        r[R_ACCEL + k] = out[O_FORCE + k] + s[S_ACCEL_BIAS + k] + noise[k]
        r[R_RATES + k] = state[10 + k] + s[S_GYRO_BIAS + k] + noise[3 + k]
        r[R_POS + k] = state[k] + s[S_WANDER + 3 + k]
        r[R_VEL + k] = state[3 + k] + s[S_WANDER + 6 + k]
    r[R_ACCEL] += shaken0
    r[R_ACCEL + 1] += shaken1
    r[R_ACCEL + 2] += shaken2
    r[R_HEIGHT] = max(ground - state[2] + noise[15], 0.0)
    r[R_VOLT] = state[VOLTAGE] + noise[16]
    for i in range(n):
        r[R_SPEEDS + i] = max(state[SPEED + i] + noise[17 + i], 0.0)
