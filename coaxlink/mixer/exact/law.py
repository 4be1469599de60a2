"""The exact law: the speeds that deliver the wrench on the identified rotors at least power.

    min sum tau_i u_i   subject to   W(u) = mu,   u_min <= u <= u_max,   no lower rotor windmills

u are speeds, rpm over the rotor file's speed_max_rpm; what motors are told for them is the vehicle's to say
(`Vehicle.commanded`). Where no speeds do, axes are given up in strict order of priority (see `exact.solver`).
Beyond Berra, Trujillo and Heredia 2024: eq. 13 is solved for all rotors at once, with the power of eq. 5 as
the choice among them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coaxlink.airframe import AXES
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.errors import InputError
from coaxlink.mixer.exact import solver
from coaxlink.mixer.exact.arms import scaled, standing
from coaxlink.mixer.law import checked_wrench
from coaxlink.vehicle import Vehicle

PRIORITY = ("roll", "pitch", "thrust", "yaw")
STEPS = 6  # quadratic steps before the sure way is taken
FAR = 4.0  # of the vehicle's authority: a demand beyond is as far out of reach as at it
GIVEN_UP = 1e-8  # of the vehicle's authority


@dataclass(frozen=True)
class Certificate:
    """What the last call can vouch for."""

    steps: int  # quadratic steps; negative when the optimum was not settled (speeds are in bounds even so)
    rounds: int  # active-set rounds over all steps
    miss: NDArray[np.float64]  # (4,) demanded minus delivered, N and N m
    power: float  # sum of torque x speed, N m
    looks: int  # all round, so far: calls in which the last solution led nowhere
    active: NDArray[np.int64]  # (N,) -1 at the lower bound, 0 between, 1 at the upper
    prices: NDArray[np.float64]  # (4,) what one more N or N m of each axis costs in power


class ExactLaw:
    """See the module. Keeps the last solution and starts from it; make one for each stream of wrenches.

    `low`, `high` bound all commands; `failed` are numbers of rotors that stand still, allocated around;
    `priority` orders the axes, first kept longest; `compiled` True takes numba (it compiles once, then it is
    cached), None takes it when it is there.

    Raises InputError on bounds out of order, an unknown rotor or axis, and without numba where that is meant.
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
        compiled: bool | None = False,
    ) -> None:
        self.arms, self.units = scaled(vehicle, low=low, high=high, failed=failed, priority=priority)
        self._optimum = _function(compiled)
        self.compiled = self._optimum is not solver.optimum
        self._ranks = [
            (int(o), 1.0 / float(s)) for o, s in zip(self.units.order, self.units.scale, strict=True)
        ]
        self._slots, self._lines = self.units.slots.tolist(), self.arms.line.tolist()
        self._weight = vehicle.airframe.mass_kg * GRAVITY_M_S2
        # where rotors stand still too: a hover without them leaves others at their bounds, from which not all
        # that can be had is found
        whole = scaled(vehicle, low=low, high=high, failed=(), priority=priority)[0] if failed else self.arms
        self.arms.home[:] = np.clip(self._hover(whole), self.arms.lo, self.arms.hi)
        self.reset()

    def __repr__(self) -> str:
        how = "compiled" if self.compiled else "in Python"
        return f"ExactLaw({len(self._slots)} rotors, {how}; hovers at {self._weight:.1f} N)"

    def _hover(self, numbers: solver.Arms) -> NDArray[np.float64]:
        """(2K,) where the vehicle hovers: what calls begin from."""
        arms, state = as_lists(numbers), as_lists(standing(numbers))
        for j, (axis, inverse) in enumerate(self._ranks):
            state.mu[j] = self._weight * inverse if axis == 0 else 0.0
        before = 1e300
        for which in range(solver.STARTS):
            solver.stand_at(arms, state, which)
            solver.persist(arms, state)
            solver.solve(arms, state, STEPS)
            solver.miss(arms, state)
            before = solver.better(arms, state, before)
        return np.array(state.best)

    def reset(self) -> None:
        """Forget the last solution: the next call starts from hover."""
        arms, state = self.arms, standing(self.arms)
        self._arms = arms if self.compiled else as_lists(arms)
        self._state = state if self.compiled else as_lists(state)
        self._steps = self._rounds = 0

    def speeds(self, wrench: ArrayLike) -> NDArray[np.float64]:
        """Normalised speeds (N,) for a wrench (4,)."""
        return np.array(self.plain(checked_wrench(wrench).tolist()))

    def plain(self, wrench: Sequence[float]) -> list[float]:
        """`speeds` for four finite numbers that are known to be so, without an array made."""
        self.solve(wrench)
        return self._speeds()

    def _speeds(self) -> list[float]:
        """(N,) of the coordinates."""
        x = self._state.x.tolist() if self.compiled else self._state.x[:]
        for k, (a, b, c, d) in enumerate(self._lines):
            u = x[2 * k]
            low = a + b * u
            x[2 * k + 1] = low + (c + d * u - low) * x[2 * k + 1]
        return [x[i] for i in self._slots]

    def solve(self, wrench: Sequence[float]) -> int:
        """One call without checks or copies, for the live loop; returns the certificate's `steps`."""
        mu = self._state.mu
        for j, (axis, inverse) in enumerate(self._ranks):
            mu[j] = min(max(wrench[axis] * inverse, -FAR), FAR)
        self._steps, self._rounds = self._optimum(self._arms, self._state, STEPS)
        return int(self._steps)

    def many(self, wrenches: ArrayLike) -> NDArray[np.float64]:
        """Normalised speeds (rows, N) of wrenches (rows, 4), each started from the row before."""
        demands = np.atleast_2d(np.asarray(wrenches, float))
        if demands.shape[1:] != (4,) or not np.isfinite(demands).all():
            raise InputError("wrenches", "", f"finite rows of {', '.join(AXES)} expected")
        return np.array([self.plain(wrench) for wrench in demands.tolist()])

    @property
    def certificate(self) -> Certificate:
        """Of the last call."""
        units, state = self.units, self._state
        miss, prices = np.zeros(4), np.zeros(4)
        miss[units.order] = np.array(state.miss) * units.scale
        prices[units.order] = np.array(state.price) * units.power / units.scale
        active = np.array([state.act[i] for i in self._slots])
        power = float(state.power[0]) * units.power
        looks = int(state.looks[0])
        return Certificate(int(self._steps), int(self._rounds), miss, power, looks, active, prices)

    @property
    def dropped(self) -> tuple[str, ...]:
        """Axes that the last call could not deliver whole, the first to be given up first."""
        miss, order = self._state.miss, self.units.order
        return tuple(AXES[int(order[j])] for j in (3, 2, 1, 0) if abs(miss[j]) > GIVEN_UP)


def as_lists(arrays: Any) -> Any:
    """`Arms` or `State` with lists for arrays, which plain Python is quicker at."""
    return type(arrays)(*(a.tolist() if isinstance(a, np.ndarray) else a for a in arrays))


def _function(compiled: bool | None) -> Any:
    """`solver.optimum`, compiled or as it is."""
    if compiled is False:
        return solver.optimum
    try:
        from coaxlink.mixer.exact.compiled import function

        return function()
    except ImportError as error:
        if compiled:
            raise InputError("exact", "compiled", "numba is not installed") from error
        return solver.optimum
