"""One airframe and rotor model as the flat, normalised arrays of `exact.kernel`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import AXES
from coaxlink.errors import InputError
from coaxlink.load import Load
from coaxlink.mixer.exact.loads import ARM, SUMS
from coaxlink.mixer.exact.warm import NEVER, ROWS, SPEEDS
from coaxlink.rotor.polynomial import Polynomial
from coaxlink.vehicle import Vehicle, require_vehicle

PRIORITY = ("roll", "pitch", "thrust", "yaw")
CAPS = (1e6, 1e6, 1e4, 1e2)  # in full powers per full authority, by rank


@dataclass(frozen=True)
class Problem:
    """See `exact.kernel` for the arrays; `order` maps ranks to AXES, `slots` arms to rotors."""

    c: NDArray[np.float64]
    g: NDArray[np.float64]
    shape: NDArray[np.int64]
    lo: NDArray[np.float64]
    hi: NDArray[np.float64]
    cap: NDArray[np.float64]
    order: NDArray[np.int64]  # (4,) index into AXES of each rank
    scale: NDArray[np.float64]  # (4,) N or N m of a unit, by rank
    power: float  # N m (sum of torque x speed) of a unit of power
    slots: NDArray[np.int64]  # (N,) which of the 2K speeds is rotor n's
    arms: int

    def scratch(self) -> list[NDArray[np.float64]]:
        """The kernel's `work`, `sums` and `box`."""
        return [np.zeros((self.arms, ARM)), np.zeros(SUMS), np.zeros(6 * self.arms)]

    def past(self) -> NDArray[np.float64]:
        """The kernel's `past`, with nothing kept yet."""
        rows = np.zeros((ROWS, SPEEDS + 4 * self.arms))
        rows[:, 0] = NEVER
        return rows


def build(
    vehicle: Vehicle,
    *,
    low: float = 0.0,
    high: float = 1.0,
    failed: Sequence[int] = (),
    priority: Sequence[str] = PRIORITY,
) -> Problem:
    """The problem of a vehicle. `failed` are numbers of rotors that stand still.

    Raises InputError on bounds out of order, an unknown rotor or axis.
    """
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
    arms = [*airframe.pairs, *((i, -1) for i in airframe.singles)]
    thrust_gain, torque_gain = airframe.gains
    loads = [model.surface(load) for load in Load]
    nu = max([2, *(a for p in loads for a, _ in p.exponents)])
    nl = max([2, *(b for p in loads for _, b in p.exponents)])
    dense = [_dense(p, nu, nl) for p in loads]
    order = np.array([AXES.index(axis) for axis in priority])
    per_thrust, per_torque = airframe.effectiveness()
    full_thrust, full_torque = airframe.loads(model, np.full(len(numbers), high))
    scale = (np.abs(per_thrust) @ np.abs(full_thrust) + np.abs(per_torque) @ np.abs(full_torque))[order]
    scale = np.where(scale > 1e-9, scale, 1.0)
    power = float(np.abs(full_torque).sum()) * high
    c, g, lo, hi = [], [], [], []
    slots = np.zeros(len(numbers), np.int64)
    for k, (upper, lower) in enumerate(arms):
        for i, side in ((upper, 0), (lower, 1)):
            still = i < 0 or numbers[i] in failed
            lo.append(0.0 if still else low)
            hi.append(0.0 if still else high)
            if i >= 0:
                slots[i] = 2 * k + side
        for p, (i, columns) in zip(
            dense,
            ((upper, per_thrust), (upper, per_torque), (lower, per_thrust), (lower, per_torque)),
            strict=True,
        ):
            torque = columns is per_torque
            # a single rotor has nothing below it: its lower loads must not count, not even their constant
            own = float((torque_gain if torque else thrust_gain)[i]) if i >= 0 else 0.0
            c.append(own * p / power if torque else own * p)
            column = columns[order, i] / scale * (power if torque else 1.0) if i >= 0 else np.zeros(4)
            g.append(column)
    deaf = all(b == 0 for p in loads[:2] for _, b in p.exponents)
    return Problem(
        np.array([x.ravel() for x in c]).reshape(len(arms), 4, -1),
        np.array(g).reshape(len(arms), 16),
        np.array([len(arms), nu, nl, int(deaf and nu == nl == 2)]),
        np.array(lo),
        np.array(hi),
        np.array(CAPS),
        order,
        scale,
        power,
        slots,
        len(arms),
    )


def _dense(load: Polynomial, nu: int, nl: int) -> NDArray[np.float64]:
    table = np.zeros((nu + 1, nl + 1))
    for (a, b), coefficient in zip(load.exponents, load.coefficients, strict=True):
        table[a, b] += coefficient
    return table
