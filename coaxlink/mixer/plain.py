"""The rotors of one airframe as plain numbers: speeds to loads to wrench in tens of microseconds.

The same physics as `Airframe.loads` and `Airframe.wrench`, for laws and the live loop, which evaluate one
point at a time: a `Polynomial` of numpy arrays alone costs tens of microseconds a call.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import mul

import numpy as np
from numpy.typing import NDArray

from coaxlink.rotor.polynomial import Polynomial
from coaxlink.vehicle import Vehicle


@dataclass(frozen=True)
class PlainLoad:
    """f(u_u, u_l) = sum_ab coefficients[a][b] u_u^a u_l^b, dense."""

    coefficients: tuple[tuple[float, ...], ...]  # [power of u_u][power of u_l]

    @classmethod
    def of(cls, load: Polynomial) -> PlainLoad:
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


@dataclass(frozen=True)
class PlainRotors:
    """Pairs and singles with their four loads, and what each load does to the body."""

    pairs: tuple[tuple[int, int], ...]  # (upper, lower) indices
    singles: tuple[int, ...]
    upper_thrust: PlainLoad
    upper_torque: PlainLoad
    lower_thrust: PlainLoad
    lower_torque: PlainLoad
    per_load: NDArray[np.float64]  # (4, 2N) wrench per unit thrust of the model at each rotor, then torque
    rows: tuple[tuple[float, ...], ...]  # the same
    gains: tuple[tuple[float, float], ...]  # (N,) thrust and torque of each rotor over the model's

    @classmethod
    def of(cls, vehicle: Vehicle) -> PlainRotors:
        """The rotors of `vehicle`, each with its own gains."""
        airframe, model = vehicle.airframe, vehicle.model
        per_thrust, per_torque = airframe.effectiveness()
        thrust_gain, torque_gain = airframe.gains
        return cls(
            airframe.pairs,
            airframe.singles,
            PlainLoad.of(model.upper_thrust),
            PlainLoad.of(model.upper_torque),
            PlainLoad.of(model.lower_thrust),
            PlainLoad.of(model.lower_torque),
            per_load := np.concatenate([per_thrust * thrust_gain, per_torque * torque_gain], axis=1),
            tuple(map(tuple, per_load.tolist())),
            tuple((float(f), float(q)) for f, q in zip(thrust_gain, torque_gain, strict=True)),
        )

    def wrench(self, speeds: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
        """(4,) wrench of normalised speeds (N,)."""
        return np.array(self.plain_wrench(speeds))

    def plain_wrench(self, speeds: Sequence[float] | NDArray[np.float64]) -> list[float]:
        """`wrench` as a list, without an array made."""
        loads = self.loads(speeds)
        return [sum(map(mul, row, loads)) for row in self.rows]

    def loads(self, speeds: Sequence[float] | NDArray[np.float64]) -> list[float]:
        """(2N,) thrusts, then torques, by the model: without the rotors' own gains, which `per_load` has."""
        n = self.per_load.shape[1] // 2
        loads = [0.0] * (2 * n)
        for a, b in self.pairs:
            upper, lower = float(speeds[a]), float(speeds[b])
            loads[a], loads[n + a] = (
                self.upper_thrust.value(upper, lower),
                self.upper_torque.value(upper, lower),
            )
            loads[b], loads[n + b] = (
                self.lower_thrust.value(upper, lower),
                self.lower_torque.value(upper, lower),
            )
        for i in self.singles:
            u = float(speeds[i])
            loads[i], loads[n + i] = self.upper_thrust.value(u, 0.0), self.upper_torque.value(u, 0.0)
        return loads


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
    # Newton kept inside a shrinking bracket: sure on any curve that rises from one end to the other
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
