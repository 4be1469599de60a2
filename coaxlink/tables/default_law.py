"""Which table a vehicle gets where nobody asked for a law: as much of the fitted one as its margins allow.

The fitted table flies at least power and follows the rotors; the standard one climbs and yaws hardest. A
vehicle that carries much or hardly yaws needs the latter's margins, so the choice is made by them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.errors import InputError
from coaxlink.mixer.demands import Commands
from coaxlink.mixer.fitted import FittedTable, TableFit
from coaxlink.mixer.worth import weigh
from coaxlink.vehicle import Vehicle

THRUST_TO_WEIGHT = 2.0  # what multirotors are laid out for (eCalc, PX4 and ArduPilot frame advice)
YAW_SHARE = (
    0.8  # of the standard table's: a pilot's yaw loop is tuned within such a factor (ArduPilot AutoTune)
)
_REACH = 0.99  # of the standard table's ceiling, where that itself is below the first number

SpeedsOf = Callable[[str, FittedTable | None], Commands]  # a law and, if it is made already, its table


BALANCED = "balanced"  # the fitted table, as far towards the standard one as keeps its margins


@dataclass(frozen=True)
class ChosenLaw:
    """A law, its table where it was worked out on the way, and why."""

    law: str  # fitted, balanced or standard
    fit: FittedTable | None
    why: str
    fitted: FittedTable  # the fitted table, chosen or not

    def to_json(self) -> dict[str, Any]:
        """The key `chosen` of the JSON of `table`."""
        return {"law": self.law, "why": self.why}


def choose_law(
    vehicle: Vehicle, speeds_of: SpeedsOf, *, spin_min: float = 0.0, spin_max: float = 1.0
) -> ChosenLaw:
    """The law by what the vehicle needs; `speeds_of` says how the firmware flies a law.

    `spin_min`, `spin_max` as for `fit_table`. Raises InputError.
    """
    search = TableFit(vehicle, spin_min, spin_max)
    fit = search.fitted()
    fitted, standard = weigh(vehicle, speeds_of("fitted", fit)), weigh(vehicle, speeds_of("standard", None))
    weight = vehicle.airframe.mass_kg * GRAVITY_M_S2
    wanted = THRUST_TO_WEIGHT * weight
    ceiling = min(wanted, _REACH * standard.ceiling_N)
    yaw = YAW_SHARE * standard.limits[2].moment_Nm
    has = (
        f"its ceiling is {fitted.thrust_to_weight:.2f} times the weight ({THRUST_TO_WEIGHT:g} is the least), "
        f"its yaw {fitted.limits[2].moment_Nm / standard.limits[2].moment_Nm:.0%} of the standard table's "
        f"({YAW_SHARE:.0%} is the least)"
    )
    if fitted.ceiling_N >= ceiling and fitted.limits[2].moment_Nm >= yaw:
        return ChosenLaw("fitted", fit, f"the fitted table: {has}", fit)
    between = search.with_margins(fit, ceiling, yaw)
    if between is None:
        why = f"the standard table, not the fitted one: {has}; no table near the fitted one keeps both"
        return ChosenLaw("standard", None, why, fit)
    return ChosenLaw(BALANCED, between, f"the balanced table, not the fitted one: {has}", fit)


def balanced_fit(
    vehicle: Vehicle, speeds_of: SpeedsOf, *, spin_min: float = 0.0, spin_max: float = 1.0
) -> FittedTable:
    """The balanced table: the fitted one where that keeps the margins. Raises InputError where none does."""
    chosen = choose_law(vehicle, speeds_of, spin_min=spin_min, spin_max=spin_max)
    if chosen.fit is None:
        raise InputError("`law`", BALANCED, chosen.why)
    return chosen.fit
