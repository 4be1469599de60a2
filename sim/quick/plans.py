"""Where a quick flight is to go: (turns, 11) position, velocity, acceleration, yaw, yaw rate for all times.

What a plan draws comes from the seed, so that flights of one seed have one plan. Every plan begins at rest,
and is entered at time 0; before that the vehicle settles at its first place.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
HEIGHT_M = 4.0
EASE_S = 4.0  # over which a sine grows from rest


def hover(t: Array, seed: int) -> Array:
    """One place."""
    goals = np.zeros((len(t), 11))
    goals[:, 2] = -HEIGHT_M
    return goals


def on_circle(t: Any, radius: float, period: float) -> tuple[Any, ...]:
    """North and east place, speed and acceleration from (radius, 0) on, the rate rising over 3 s; t >= 0."""
    w, ramp = 2.0 * math.pi / period, 3.0
    s = np.minimum(t / ramp, 1.0)
    angle = w * (ramp * (s**3 - s**4 / 2) + np.maximum(t - ramp, 0.0))
    rate, turn = w * (3 * s * s - 2 * s**3), w * 6 * s * (1 - s) / ramp
    c, n = np.cos(angle), np.sin(angle)
    place, speed = (radius * c, radius * n), (-radius * rate * n, radius * rate * c)
    return *place, *speed, -radius * (rate**2 * c + turn * n), radius * (turn * c - rate**2 * n)


def circle(t: Array, seed: int) -> Array:
    """2 m in 8 s around the start, which is on the circle (the paper's, section 5.3)."""
    goals = hover(t, seed)
    for column, values in zip((0, 1, 3, 4, 6, 7), on_circle(np.maximum(t, 0.0), 2.0, 8.0), strict=True):
        goals[:, column] = values
    return goals


def wander(t: Array, seed: int) -> Array:
    """Sines of drawn size and pace in all four axes: metres to the sides, climbs, turns of heading."""
    random = np.random.default_rng([seed, 0x9A17])
    sizes = random.uniform([1.5, 1.5, 0.8, 0.5], [3.0, 3.0, 1.6, 1.4])
    paces = random.uniform([0.5, 0.5, 0.6, 0.25], [1.1, 1.1, 1.3, 0.5])
    ways = random.choice([-1.0, 1.0], 4)
    since = np.maximum(t, 0.0)
    s = np.minimum(since / EASE_S, 1.0)
    ease, slope = s**3 * (10 - 15 * s + 6 * s * s), 30 * (s * (1 - s)) ** 2 / EASE_S
    bend = 60 * s * (1 - s) * (1 - 2 * s) / EASE_S**2
    goals = hover(t, seed)
    for k, (size, w, way) in enumerate(zip(sizes, paces, ways, strict=True)):
        wave, run, back = np.sin(w * since), w * np.cos(w * since), -w * w * np.sin(w * since)
        offset = way * size * ease * wave
        speed = way * size * (slope * wave + ease * run)
        feed = way * size * (bend * wave + 2 * slope * run + ease * back)
        if k < 3:
            goals[:, k] += offset
            goals[:, 3 + k], goals[:, 6 + k] = speed, feed
        else:
            goals[:, 9] = offset
    return goals


def steps(t: Array, seed: int) -> Array:
    """Up and down by 2 m and round by a quarter turn, every 6 s one of them, in a drawn order and sense."""
    random = np.random.default_rng([seed, 0x57E9])
    goals = hover(t, seed)
    count = 1 + int(max(float(t[-1]), 0.0) // 6.0)
    turns = random.choice([-1.0, 0.0, 1.0], count)
    climbs = np.where(turns == 0.0, 1.0, 0.0)
    k = np.clip((t // 6.0).astype(int), 0, count - 1)
    goals[:, 9] = np.where((t > 0.0) & (t % 6.0 > 2.0), 0.5 * math.pi * turns[k], 0.0)
    goals[:, 2] -= np.where((t > 0.0) & (t % 6.0 > 2.0), 2.0 * climbs[k], 0.0)
    return goals


PLANS: dict[str, Callable[[Array, int], Array]] = {
    "hover": hover,
    "circle": circle,
    "wander": wander,
    "steps": steps,
}
