"""One load of a coaxial pair as plain numbers, for laws that evaluate it one speed at a time.

A `Polynomial` of numpy arrays costs tens of microseconds a call; these are lists and floats.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from coaxlink.rotor.polynomial import Polynomial


@dataclass(frozen=True)
class Surface:
    """f(u_u, u_l) = sum_ab coefficients[a][b] u_u^a u_l^b, dense."""

    coefficients: tuple[tuple[float, ...], ...]  # [power of u_u][power of u_l]

    @classmethod
    def of(cls, load: Polynomial) -> Surface:
        """The dense form of a polynomial (terms of equal powers are added up)."""
        orders = [max((e[i] for e in load.exponents), default=0) + 1 for i in (0, 1)]
        dense = [[0.0] * orders[1] for _ in range(orders[0])]
        for (a, b), c in zip(load.exponents, load.coefficients, strict=True):
            dense[a][b] += c
        return cls(tuple(tuple(row) for row in dense))

    def value(self, upper: float, lower: float) -> float:
        """f at one pair of normalised speeds."""
        value = 0.0
        for row in reversed(self.coefficients):
            inner = 0.0
            for c in reversed(row):
                inner = inner * lower + c
            value = value * upper + inner
        return value

    def at(self, upper: float, lower: float) -> tuple[float, float, float]:
        """(f, df/du_u, df/du_l) at one pair of normalised speeds, by Horner's rule."""
        value = slope_upper = slope_lower = 0.0
        for row in reversed(self.coefficients):
            inner = inner_slope = 0.0
            for c in reversed(row):
                inner_slope = inner_slope * lower + inner
                inner = inner * lower + c
            slope_upper = slope_upper * upper + value
            value = value * upper + inner
            slope_lower = slope_lower * upper + inner_slope
        return value, slope_upper, slope_lower

    def upper_for(self, load: float, lower: float = 0.0) -> float:
        """The u_u in [0, 1] that gives `load` at u_l = lower, or the nearer end when none does."""
        return _invert([_horner(row, lower) for row in self.coefficients], load)

    def lower_for(self, load: float, upper: float) -> float:
        """The u_l in [0, 1] that gives `load` at u_u = upper, or the nearer end when none does."""
        columns = zip(*self.coefficients, strict=True)
        return _invert([_horner(column, upper) for column in columns], load)


def _horner(coefficients: Sequence[float], x: float) -> float:
    value = 0.0
    for c in reversed(coefficients):
        value = value * x + c
    return value


def _invert(c: list[float], target: float) -> float:
    """u in [0, 1] where sum_k c[k] u^k, rising from one end to the other, is `target`."""
    if c[0] >= target:
        return 0.0
    if sum(c) <= target:
        return 1.0
    if len(c) <= 3:
        linear, square = c[1], c[2] if len(c) == 3 else 0.0
        root = math.sqrt(max(linear * linear + 4.0 * square * (target - c[0]), 0.0))
        # this form of the root has no cancellation, and holds for square = 0
        return 2.0 * (target - c[0]) / (linear + root)
    return _search(c, target)


def _search(c: list[float], target: float) -> float:
    """Newton kept inside a shrinking bracket: sure on any curve that rises from one end to the other."""
    low, high, u = 0.0, 1.0, 0.5
    slopes = [k * c[k] for k in range(1, len(c))]
    for _ in range(60):
        miss, slope = _horner(c, u) - target, _horner(slopes, u)
        if miss > 0:
            high = u
        else:
            low = u
        step = u - miss / slope if slope > 0 else low
        new = step if low < step < high else 0.5 * (low + high)
        if abs(new - u) < 1e-14:
            return new
        u = new
    return u
