"""The exact law: the speeds that deliver the wrench on the identified rotors at least power.

    min sum tau_i u_i   subject to   W(u) = mu,   u_min <= u <= u_max

Where no speeds do, axes are given up in strict order of priority (see `exact.solver`). Beyond Berra, Trujillo
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
from coaxlink.load import Load
from coaxlink.mixer.exact import solver
from coaxlink.mixer.exact.solver import NEVER, Arms, State
from coaxlink.mixer.law import checked_wrench
from coaxlink.rotor.polynomial import Polynomial
from coaxlink.vehicle import Vehicle, require_vehicle

PRIORITY = ("roll", "pitch", "thrust", "yaw")
CAPS = (1e6, 1e6, 1e4, 1e2)  # in full powers per full authority, by rank
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
    active: NDArray[np.int64]  # (N,) -1 at the lower bound, 0 between, 1 at the upper
    prices: NDArray[np.float64]  # (4,) what one more N or N m of each axis costs in power


@dataclass(frozen=True)
class Units:
    """From the vehicle's own axes, rotors and units to those of `exact.solver`."""

    order: NDArray[np.int64]  # (4,) index into AXES of each rank
    scale: NDArray[np.float64]  # (4,) N or N m of a unit, by rank
    power: float  # N m (sum of torque x speed) of a unit of power
    slots: NDArray[np.int64]  # (N,) which of the 2K speeds is rotor n's


class ExactLaw:
    """See the module. Keeps the last solution and starts from it; make one for each stream of wrenches.

    `low`, `high` bound all speeds; `failed` are numbers of rotors that stand still and are allocated around;
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
        self._optimum, self._batch = _functions(compiled)
        self.compiled = self._optimum is not solver.optimum
        self._ranks = [
            (int(o), 1.0 / float(s)) for o, s in zip(self.units.order, self.units.scale, strict=True)
        ]
        self._slots = self.units.slots.tolist()
        self.reset()

    def reset(self) -> None:
        """Forget the last solution: the next call starts from the middle of the bounds."""
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
        x = self._state.x
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
        ranked = np.clip(demands[:, self.units.order] / self.units.scale, -FAR, FAR)
        speeds: Any = np.zeros((len(demands), 2 * self.arms.size))
        if not self.compiled:
            ranked, speeds = ranked.tolist(), speeds.tolist()
        self._batch(self._arms, self._state, STEPS, ranked, speeds)
        return np.asarray(speeds, float)[:, self.units.slots]

    @property
    def certificate(self) -> Certificate:
        """Of the last call."""
        units, state = self.units, self._state
        miss, prices = np.zeros(4), np.zeros(4)
        miss[units.order] = np.array(state.miss) * units.scale
        prices[units.order] = np.array(state.price) * units.power / units.scale
        active = np.array([state.act[i] for i in self._slots])
        power = float(state.power[0]) * units.power
        return Certificate(int(self._steps), int(self._rounds), miss, power, active, prices)

    @property
    def dropped(self) -> tuple[str, ...]:
        """Axes that the last call could not deliver whole, the first to be given up first."""
        miss, order = self._state.miss, self.units.order
        return tuple(AXES[int(order[j])] for j in (3, 2, 1, 0) if abs(miss[j]) > GIVEN_UP)


def scaled(
    vehicle: Vehicle, *, low: float, high: float, failed: Sequence[int], priority: Sequence[str]
) -> tuple[Arms, Units]:
    """A vehicle as `exact.solver` wants it, of numpy arrays; the options as for `ExactLaw`."""
    require_vehicle(vehicle)
    airframe, model = vehicle.airframe, vehicle.model
    if not 0.0 <= low < high <= 1.0:
        raise InputError("exact", "bounds", f"0 <= low < high <= 1 expected, found {low} and {high}")
    if sorted(priority) != sorted(AXES):
        raise InputError("exact", "priority", f"each of {', '.join(AXES)} once expected, found {priority}")
    numbers = [r.number for r in airframe.rotors]
    for n in failed:
        if n not in numbers:
            raise InputError("exact", "failed", f"there is no rotor {n}")
    order = np.array([AXES.index(axis) for axis in priority])
    per_load = airframe.effectiveness()  # of thrusts and torques, (4, N) each
    least, most = (vehicle.turned(np.full(len(numbers), command)) for command in (low, high))
    full = airframe.loads(model, most)
    scale = (np.abs(per_load[0]) @ np.abs(full[0]) + np.abs(per_load[1]) @ np.abs(full[1]))[order]
    scale = np.where(scale > 1e-9, scale, 1.0)
    power = float(np.abs(full[1]).sum()) * high

    loads = [model.surface(load) for load in Load]
    orders = [max([2, *(exponents[side] for p in loads for exponents in p.exponents)]) for side in (0, 1)]
    dense = [_dense(p, *orders) for p in loads]
    pairs = [*airframe.pairs, *((i, -1) for i in airframe.singles)]
    # a single rotor has nothing below it: its lower loads must not count, not even their constant
    terms = np.zeros((len(pairs), 4, dense[0].size))
    gain = np.zeros((len(pairs), 4, 4))
    lo, hi = np.zeros(2 * len(pairs)), np.zeros(2 * len(pairs))
    slots = np.zeros(len(numbers), np.int64)
    for k, pair in enumerate(pairs):
        for side, i in enumerate(pair):
            if i < 0:
                continue
            slots[i] = 2 * k + side
            if numbers[i] not in failed:
                lo[2 * k + side], hi[2 * k + side] = least[i], most[i]
            for kind, unit in ((0, 1.0), (1, power)):  # thrust in N, torque in units of power
                n = 2 * side + kind
                terms[k, n] = airframe.gains[kind][i] * dense[n] / unit
                gain[k, n] = per_load[kind][order, i] / scale * unit
    arms = Arms(len(pairs), orders[0], orders[1], terms, gain, lo, hi, np.array(CAPS))
    return arms, Units(order, scale, power, slots)


def standing(arms: Arms) -> State:
    """The solver's state, of numpy arrays: in the middle of the bounds, nothing remembered."""
    n, speeds, free = (
        2 * arms.size,
        np.where(arms.hi > arms.lo, 0.5 * (arms.lo + arms.hi), arms.lo),
        np.zeros,
    )
    remembered = free((3, 4))
    remembered[:, 0] = NEVER
    return State(
        mu=free(4), x=speeds, act=free(n, np.int64), price=free(4), gone=free(4, np.int64), miss=free(4),
        power=free(1), slope=free(n), jacobian=free((n, 4)), hessian=free((arms.size, 3)), own=free(n),
        reply=free((n, 4)), step=free(n), schur=free((4, 4)), factor=free((4, 4)), right=free(4),
        dual=free(4), before=free(4), low=free(n), high=free(n), kept=free(n), old_mu=remembered,
        old_price=free((3, 4)), old_gone=free((3, 4), np.int64), old_x=free((3, n)),
        old_act=free((3, n), np.int64), smooth=free(1),
    )  # fmt: skip


def as_lists(arrays: Any) -> Any:
    """`Arms` or `State` with lists for arrays, which plain Python is quicker at."""
    return type(arrays)(*(a.tolist() if isinstance(a, np.ndarray) else a for a in arrays))


def _dense(load: Polynomial, upper_order: int, lower_order: int) -> NDArray[np.float64]:
    table = np.zeros((upper_order + 1, lower_order + 1))
    for (a, b), coefficient in zip(load.exponents, load.coefficients, strict=True):
        table[a, b] += coefficient
    return table.ravel()


def _functions(compiled: bool | None) -> tuple[Any, Any]:
    """`solver.optimum` and `solver.batch`, compiled or as they are."""
    if compiled is False:
        return solver.optimum, solver.batch
    try:
        from coaxlink.mixer.exact.compiled import functions

        return functions()
    except ImportError as error:
        if compiled:
            raise InputError("exact", "compiled", "numba is not installed") from error
        return solver.optimum, solver.batch
