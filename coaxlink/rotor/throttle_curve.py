"""What a rotor turns at a throttle, where rpm are not proportional to it.

    rpm = b_0 + b_1 t + b_2 t^2,    t the throttle, 0..1, of rows in which the rotor turns

A table commands throttles: u = 1 has to mean full throttle, not the fastest row of a log that stops before,
and a command the speed that it gives. The rotor file keeps the curve (`identified.rpm_over_throttle`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coaxlink.data import Samples
from coaxlink.data.aliases import SIDES

Array = NDArray[np.float64]
TURNS = 0.05  # of full throttle, of the fastest rpm: below, an ESC starts or stops its motor
AT_FULL = 0.98  # of throttle: full throttle was measured
LEAST_ROWS, LEAST_SPAN = 8, 0.3  # rows and range of throttle that tell a bend
SURE = 0.02  # of the speed at full throttle, its standard error: what two rpm sensors are apart
BENT = 0.05  # of full speed, between a throttle and the speed it gives: more is said


@dataclass(frozen=True)
class ThrottleCurve:
    """rpm over throttle of one rotor."""

    coefficients: tuple[float, float, float]  # b_0, b_1, b_2, rpm
    top: float  # the greatest throttle of the log
    error_rpm: float  # standard error at full throttle

    @property
    def full_rpm(self) -> float:
        """At throttle 1."""
        return float(sum(self.coefficients))

    @property
    def reaches_full(self) -> bool:
        """Whether speeds may be taken from throttles by it: full throttle was measured, or is known."""
        return self.known or self.top >= AT_FULL

    @property
    def known(self) -> bool:
        """Whether the log tells what full throttle gives."""
        return self.error_rpm <= SURE * self.full_rpm

    def bend(self) -> tuple[float, float]:
        """(throttle, share of full speed there) where the two are furthest apart, of the log's throttles."""
        t = np.linspace(TURNS, self.top, 50)
        share = speed_at(self.coefficients, t) / self.full_rpm
        at = int(np.argmax(np.abs(share - t)))
        return float(t[at]), float(share[at])


def speed_at(coefficients: Sequence[float], throttle: ArrayLike) -> Array:
    """rpm at throttles (...), a straight line from rest to where the motor surely turns.

    >>> speed_at((600.0, 6000.0, -1600.0), [0.0, 0.5, 1.0]).tolist()
    [0.0, 3200.0, 5000.0]
    """
    t = np.asarray(throttle, float)
    curve = np.polynomial.Polynomial(coefficients)
    return np.asarray(np.maximum(np.where(t < TURNS, t / TURNS * curve(TURNS), curve(t)), 0.0))


def throttle_curves(samples: Samples) -> dict[str, ThrottleCurve]:
    """Of each side whose throttle and rpm are measured, where the rows tell one."""
    found: dict[str, ThrottleCurve] = {}
    for side in SIDES:
        if samples.has(f"{side}_rpm", f"{side}_throttle") and np.any(samples[f"{side}_rpm"] > 0):
            curve = throttle_curve(samples[f"{side}_throttle"], samples[f"{side}_rpm"])
            found |= {side: curve} if curve is not None else {}
    return found


def throttle_curve(throttle: Array, rpm: Array) -> ThrottleCurve | None:
    """The curve through (rows,), None where they are too few or too much alike."""
    turning = (throttle > TURNS) & (rpm > TURNS * float(rpm.max(initial=0.0)))
    t, n = throttle[turning], rpm[turning]
    if len(t) < LEAST_ROWS or np.ptp(t) < LEAST_SPAN:
        return None
    X = np.stack([np.ones_like(t), t, t**2], axis=1)
    b = np.linalg.lstsq(X, n, rcond=None)[0]
    left = n - X @ b
    variance = float(left @ left) / (len(t) - 3)
    reach = np.ones(3) @ np.linalg.pinv(X.T @ X) @ np.ones(3)
    rises = b[1] + 2 * b[2] > 0  # at full throttle still
    error = float(np.sqrt(variance * reach)) if rises else float("inf")
    return ThrottleCurve((float(b[0]), float(b[1]), float(b[2])), float(t.max()), error)


def at_full_throttle(curves: Mapping[str, ThrottleCurve]) -> float | None:
    """The fastest rotor's rpm at full throttle by its curve; None where one is not known or not needed."""
    if (
        not curves
        or not all(c.known for c in curves.values())
        or max(c.top for c in curves.values()) >= AT_FULL
    ):
        return None
    return max(c.full_rpm for c in curves.values())
