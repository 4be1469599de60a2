"""The exact law: the speeds that deliver the wrench on the identified rotors at least power.

    min sum tau_i u_i   subject to   W(u) = mu,   u_min <= u <= u_max

Where no speeds do, axes are given up in strict order of priority (see `exact.kernel`). Beyond Berra, Trujillo
and Heredia 2024: eq. 13 is solved for all rotors at once, with the power of eq. 5 as the choice among them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coaxlink.airframe import AXES
from coaxlink.errors import InputError
from coaxlink.mixer.exact import kernel
from coaxlink.mixer.exact.loads import MISS, POWER
from coaxlink.mixer.exact.problem import PRIORITY, build
from coaxlink.mixer.law import checked_wrench
from coaxlink.vehicle import Vehicle

STEPS = 6  # quadratic steps before the sure way is taken
FAR = 4.0  # of the vehicle's authority: a demand beyond is as far out of reach as at it
GIVEN_UP = 1e-8  # of the vehicle's authority


@dataclass(frozen=True)
class Certificate:
    """What the last call can vouch for."""

    steps: (
        int  # quadratic steps; negative when the optimum was not settled (the speeds are in bounds even so)
    )
    rounds: int  # active-set rounds over all steps
    miss: NDArray[np.float64]  # (4,) demanded minus delivered, N and N m
    power: float  # sum of torque x speed, N m
    active: NDArray[np.int64]  # (N,) -1 at the lower bound, 0 between, 1 at the upper
    prices: NDArray[np.float64]  # (4,) what one more N or N m of each axis costs in power


class ExactLaw:
    """See the module. Keeps the last solution and starts from it; make one for each stream of wrenches.

    `low`, `high` bound all speeds; `failed` are numbers of rotors that stand still and are allocated around;
    `priority` orders the axes, first kept longest; `slew` is the most a speed may change from one call to the
    next; `compiled` True takes numba (it compiles for half a minute once, then it is cached), None takes it
    when it is there.
    """

    name = "exact"

    def __init__(
        self,
        vehicle: Vehicle,
        *,
        low: float = 0.0,
        high: float = 1.0,
        failed: Sequence[int] = (),
        priority: Sequence[str] = PRIORITY,
        slew: float | None = None,
        compiled: bool | None = False,
    ) -> None:
        if slew is not None and not slew > 0:
            raise InputError("exact", "slew", f"a change per call above 0 expected, found {slew}")
        self.problem = build(vehicle, low=low, high=high, failed=failed, priority=priority)
        self._limits: dict[str, Any] = {"low": low, "high": high, "priority": tuple(priority), "slew": slew}
        self.failed = tuple(failed)
        self.slew = slew
        self._optimum, self._batch = _functions(compiled)
        self.compiled = self._optimum is not kernel.optimum
        self.reset()

    def reset(self) -> None:
        """Forget the last solution: the next call starts from the middle of the bounds, at no slew limit."""
        p, arrays = self.problem, self.arrays()
        self._state = arrays if self.compiled else [a.tolist() for a in arrays]
        self._lo, self._hi, self._x = self._state[3:6]
        self._mu, self._sums = self._state[10], self._state[12]
        self._scale = [(int(o), 1.0 / float(s)) for o, s in zip(p.order, p.scale, strict=True)]
        self._slots = p.slots.tolist()
        self._calls = self._steps = self._rounds = 0

    def without(self, vehicle: Vehicle, failed: Sequence[int]) -> ExactLaw:
        """As new for what is left of its vehicle: bounds, priority and slew are this law's.

        `failed` are numbers of rotors that stand still now, beside those that did before.
        Raises InputError.
        """
        return ExactLaw(vehicle, failed=(*self.failed, *failed), compiled=self.compiled, **self._limits)

    def arrays(self) -> list[Any]:
        """What `kernel.optimum` works on, up to its `limit`: standing in the middle of the bounds."""
        p = self.problem
        middle = np.where(p.hi > p.lo, 0.5 * (p.lo + p.hi), p.lo)
        arrays: list[Any] = [p.c, p.g, p.shape, p.lo.copy(), p.hi.copy(), middle]
        arrays += [np.zeros(2 * p.arms, np.int64), np.zeros(4), np.zeros(4, np.int64), p.cap]
        return [*arrays, np.zeros(4), *p.scratch(), p.past()]

    def speeds(self, wrench: ArrayLike) -> NDArray[np.float64]:
        """Normalised speeds (N,) for a wrench (4,)."""
        demand = checked_wrench(wrench).tolist()
        self.solve(demand)
        return np.array([self._x[i] for i in self._slots])

    def plain(self, wrench: Sequence[float]) -> list[float]:
        """`speeds` for four finite numbers that are known to be so, without an array made."""
        self.solve(wrench)
        x = self._x
        return [x[i] for i in self._slots]

    def solve(self, wrench: Sequence[float]) -> int:
        """One call without checks or copies, for the live loop; returns the certificate's `steps`."""
        mu = self._mu
        for j, (axis, inverse) in enumerate(self._scale):
            mu[j] = min(max(wrench[axis] * inverse, -FAR), FAR)
        if self.slew is not None and self._calls:
            self._limit_slew(self.slew)
        self._calls += 1
        self._steps, self._rounds = self._optimum(*self._state, STEPS)
        return int(self._steps)

    def many(self, wrenches: ArrayLike) -> NDArray[np.float64]:
        """Normalised speeds (rows, N) of wrenches (rows, 4), each started from the row before."""
        demands = np.atleast_2d(np.asarray(wrenches, float))
        if demands.shape[1:] != (4,) or not np.isfinite(demands).all():
            raise InputError("wrenches", "", f"finite rows of {', '.join(AXES)} expected")
        p = self.problem
        if self.slew is not None:
            return np.array([self.speeds(row) for row in demands])
        rows = len(demands)
        arrays: list[Any] = [np.clip(demands[:, p.order] / p.scale, -FAR, FAR)]
        arrays += [np.zeros((rows, 2 * p.arms)), np.zeros((rows, 4)), np.zeros(rows, np.int64)]
        scaled, speeds, misses, steps = arrays if self.compiled else [a.tolist() for a in arrays]
        self._batch(*self._state[:10], scaled, *self._state[11:], STEPS, speeds, misses, steps)
        return np.asarray(speeds, float)[:, p.slots]

    @property
    def certificate(self) -> Certificate:
        """Of the last call."""
        p = self.problem
        miss, prices = np.zeros(4), np.zeros(4)
        miss[p.order] = np.array(self._sums[MISS : MISS + 4]) * p.scale
        prices[p.order] = np.array(self._state[7]) * p.power / p.scale
        active = np.array([self._state[6][i] for i in self._slots])
        power = float(self._sums[POWER]) * p.power
        return Certificate(int(self._steps), int(self._rounds), miss, power, active, prices)

    @property
    def dropped(self) -> tuple[str, ...]:
        """Axes that the last call could not deliver whole, the first to be given up first."""
        p = self.problem
        left = self._sums[MISS : MISS + 4]
        return tuple(AXES[int(p.order[j])] for j in (3, 2, 1, 0) if abs(left[j]) > GIVEN_UP)

    def _limit_slew(self, slew: float) -> None:
        lo, hi = self.problem.lo, self.problem.hi
        for i, x in enumerate(self._x):
            self._lo[i], self._hi[i] = max(float(lo[i]), x - slew), min(float(hi[i]), x + slew)


def _functions(compiled: bool | None) -> tuple[Any, Any]:
    if compiled is False:
        return kernel.optimum, kernel.batch
    try:
        from coaxlink.mixer.exact.compiled import compiled as build_compiled

        return build_compiled()
    except ImportError as error:
        if compiled:
            raise InputError("exact", "compiled", "numba is not installed") from error
        return kernel.optimum, kernel.batch
