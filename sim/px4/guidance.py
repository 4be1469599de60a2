"""How a goal moves to where the vehicle is to be: as fast as it may, and no faster than it can follow."""

from __future__ import annotations

import math

from sim.px4.cascade import Goal, Three

RATE_HZ = 250
SETTLE_1_S = 4.0  # the last bit is closed at this rate: a goal that only braked would rattle about its target


def _approach(gap: float, braking: float) -> float:
    """The speed from which a gap is closed with this braking, proportional to the gap where it is small."""
    near = braking / SETTLE_1_S**2
    return SETTLE_1_S * gap if gap < near else math.sqrt(2.0 * braking * (gap - 0.5 * near))


def step_towards(goal: Goal, target: Three, cruise: float, climb: float, yaw: float) -> Goal:
    """The goal moved on: speed and acceleration limited, straight in the plane, straight up or down."""
    dt = 1.0 / RATE_HZ
    p, v = goal.position, goal.velocity
    gap = (target[0] - p[0], target[1] - p[1])
    far = math.hypot(*gap)
    level = min(cruise, _approach(far, 2.0)) if far > 1e-6 else 0.0
    wanted = [gap[0] / far * level, gap[1] / far * level] if far > 1e-6 else [0.0, 0.0]
    rise = target[2] - p[2]
    vertical = math.copysign(min(climb, _approach(abs(rise), 1.5)), rise)
    speeds = [*wanted, vertical]
    out = [v[k] + min(max(speeds[k] - v[k], -3.0 * dt), 3.0 * dt) for k in range(3)]
    position = [p[k] + out[k] * dt for k in range(3)]
    return Goal((position[0], position[1], position[2]), (out[0], out[1], out[2]), (0.0, 0.0, 0.0), yaw)
