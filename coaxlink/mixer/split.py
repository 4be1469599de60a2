"""A law whose split between upper and lower rotors is moved in flight: fitted tables, and between them.

The split here is the upper rotors' share of all thrust in hover, by the rotor model. A table is fitted for
every level asked for; between two levels their speeds are mixed, so that a step becomes a ramp.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.errors import InputError
from coaxlink.mixer.fitted import FittedLaw, FittedTable, TableFit
from coaxlink.vehicle import Vehicle

RATIOS = (0.45, 0.6, 0.8, 1.0, 1.25, 1.5)  # upper over lower column, in which a level is looked for
CEILING = 1.3  # times the weight, that a level must be able to lift
YAW = 0.5  # of the yaw in hover of the split on board, that a level must keep

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SplitLevel:
    """One split and the table that flies it."""

    share: float  # of the hover thrust by the upper rotors, 0..1
    table: FittedTable
    law: FittedLaw


class SplitLaw:
    """What an autopilot would make of fitted tables; `share` may be moved at any time, from any thread."""

    name = "split"
    dropped: tuple[str, ...] = ()

    def __init__(self, levels: tuple[SplitLevel, ...], share: float) -> None:
        """`levels` in rising order, as `split_levels` makes them; `share` is the first to fly."""
        self.levels = levels
        self._at = [level.share for level in levels]
        self.share = share

    def speeds(self, wrench: ArrayLike) -> Array:
        """Normalised speeds (N,) for a wrench (4,)."""
        share = min(max(self.share, self._at[0]), self._at[-1])
        above = min(bisect_right(self._at, share), len(self._at) - 1)
        low, high = self.levels[above - 1], self.levels[above]
        part = (share - low.share) / (high.share - low.share)
        if part in (0.0, 1.0):
            return (high if part else low).law.speeds(wrench)
        return (1.0 - part) * low.law.speeds(wrench) + part * high.law.speeds(wrench)


def upper_share(vehicle: Vehicle, speeds: ArrayLike) -> float:
    """Share of all pairs' thrust that their upper rotors give at speeds (N,)."""
    thrust = vehicle.airframe.loads(vehicle.model, np.asarray(speeds, float))[0]
    level = np.array([rotor.level for rotor in vehicle.airframe.rotors])
    upper, lower = thrust[level == "upper"].sum(), thrust[level == "lower"].sum()
    return float(upper / (upper + lower))


def equal_share(vehicle: Vehicle) -> float:
    """`upper_share` in hover where all motors have the same command, as plain mixers do."""
    airframe, low, high = vehicle.airframe, 0.0, 1.0
    weight, ones = airframe.mass_kg * GRAVITY_M_S2, np.ones(len(airframe.rotors))
    for _ in range(40):
        middle = 0.5 * (low + high)
        thrust = airframe.loads(vehicle.model, vehicle.turned(middle * ones))[0].sum()
        low, high = (middle, high) if thrust < weight else (low, middle)
    return upper_share(vehicle, vehicle.turned(high * ones))


def split_levels(vehicle: Vehicle, on_board: float, reach: float, count: int) -> tuple[SplitLevel, ...]:
    """`count` levels (odd) from `on_board` - reach to + reach, those that keep lift and yaw enough.

    Raises InputError for a vehicle without pairs, or where fewer than three levels are left.
    """
    source = vehicle.airframe.source or vehicle.airframe.name
    maker = _Maker(vehicle)
    wanted = np.linspace(on_board - reach, on_board + reach, count)
    made = [maker.level(share) for share in wanted if maker.known[0] <= share <= maker.known[-1]]
    least_N = CEILING * vehicle.airframe.mass_kg * GRAVITY_M_S2
    least_Nm = YAW * maker.level(on_board).table.chosen.yaw_Nm
    kept = tuple(
        one for one in made
        if one.table.chosen.ceiling_N >= least_N and one.table.chosen.yaw_Nm >= least_Nm
    )  # fmt: skip
    if len(kept) < 3 or not kept[0].share - 0.01 <= on_board <= kept[-1].share + 0.01:
        problem = f"within {reach:g} of {on_board:.3f} too few splits keep lift and yaw enough"
        raise InputError(source, "rotors", problem)
    return kept


def table_of(vehicle: Vehicle, share: float, spin_min: float = 0.0, spin_max: float = 1.0) -> FittedTable:
    """The fitted table with which the upper rotors give `share` of the hover thrust.

    `spin_min`, `spin_max` as for `fit_table`. Raises InputError where no table within reach does.
    """
    maker = _Maker(vehicle, spin_min, spin_max)
    if not maker.known[0] <= share <= maker.known[-1]:
        problem = (
            f"{maker.known[0]:.2f} to {maker.known[-1]:.2f} can be had with these rotors, found {share:g}"
        )
        raise InputError("the split", "share", problem)
    return maker.level(share).table


class _Maker:
    """Levels by their share, between the shares of RATIOS. Raises InputError without pairs."""

    def __init__(self, vehicle: Vehicle, spin_min: float = 0.0, spin_max: float = 1.0) -> None:
        source = vehicle.airframe.source or vehicle.airframe.name
        if not vehicle.airframe.pairs:
            raise InputError(source, "rotors", "no pair of an upper and a lower rotor, so no split")
        self._vehicle, self._fit = vehicle, TableFit(vehicle, spin_min, spin_max)
        self.known = [self._level(ratio).share for ratio in RATIOS]
        if np.any(np.diff(self.known) <= 0.0):
            raise InputError(source, "rotors", "by this rotor model a larger column does not raise the share")

    def level(self, share: float) -> SplitLevel:
        """As near to a share as the ratios' straight lines are; its own share is that of its table."""
        return self._level(float(np.interp(share, self.known, RATIOS)))

    def _level(self, ratio: float) -> SplitLevel:
        table = self._fit.at(ratio)
        law = FittedLaw(self._vehicle, table)
        return SplitLevel(
            upper_share(self._vehicle, law.speeds([self._fit.weight, 0.0, 0.0, 0.0])), table, law
        )
