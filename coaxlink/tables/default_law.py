"""Which table a vehicle gets where nobody asked for a law: as much of the fitted one as its margins allow.

The fitted table flies at least power and follows the rotors; the standard one climbs and yaws hardest. A
vehicle that carries much or hardly yaws needs the latter's margins, so the choice is made by them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.errors import CheckFailed
from coaxlink.mixer.constrained import ConstrainedTable, constrained_table
from coaxlink.mixer.demands import Speeds
from coaxlink.mixer.fitted import FittedTable, fit_table
from coaxlink.mixer.limits import Limit
from coaxlink.mixer.worth import weigh
from coaxlink.vehicle import Vehicle

THRUST_TO_WEIGHT = 2.0  # what multirotors are laid out for (eCalc, PX4 and ArduPilot frame advice)
YAW_SHARE = (
    0.8  # of the standard table's: a pilot's yaw loop is tuned within such a factor (ArduPilot AutoTune)
)
_REACH = 0.99  # of the standard table's ceiling, where that itself is below the first number

SpeedsOf = Callable[[str, FittedTable | None], Speeds]  # a law and, if it is made already, its table


@dataclass(frozen=True)
class ChosenLaw:
    """A law, its table where it was worked out on the way, and why."""

    law: str
    fit: FittedTable | None
    limited: ConstrainedTable | None
    why: str

    def to_json(self) -> dict[str, Any]:
        """The key `chosen` of the JSON of `table`."""
        return {"law": self.law, "why": self.why}


def choose_law(
    vehicle: Vehicle, speeds_of: SpeedsOf, *, spin_min: float = 0.0, spin_max: float = 1.0
) -> ChosenLaw:
    """The law by what the vehicle needs; `speeds_of` says how the firmware flies a law.

    `spin_min`, `spin_max` as for `fit_table`. Raises InputError.
    """
    fit = fit_table(vehicle, spin_min=spin_min, spin_max=spin_max)
    fitted, standard = weigh(vehicle, speeds_of("fitted", fit)), weigh(vehicle, speeds_of("standard", None))
    weight = vehicle.airframe.mass_kg * GRAVITY_M_S2
    wanted = THRUST_TO_WEIGHT * weight
    low = Limit("ceiling_N", low=min(wanted, _REACH * standard.ceiling_N))
    yaw = Limit("yaw_Nm", low=YAW_SHARE * standard.limits[2].moment_Nm)
    assert low.low is not None and yaw.low is not None
    yaws = fitted.limits[2].moment_Nm
    has = (
        f"its ceiling is {fitted.thrust_to_weight:.2f} times the weight ({THRUST_TO_WEIGHT:g} wanted), its "
        f"yaw {yaws / standard.limits[2].moment_Nm:.0%} of the standard table's ({YAW_SHARE:.0%} wanted)"
    )
    if not (fitted.ceiling_N < low.low or yaws < yaw.low):
        return ChosenLaw("fitted", fit, None, f"the fitted table: {has}")
    try:
        limited = constrained_table(vehicle, (low, yaw), spin_min=spin_min, spin_max=spin_max)
    except CheckFailed as error:
        return ChosenLaw("standard", None, None, f"the standard table, not the fitted one: {has}; {error}")
    why = f"a table between the fitted and the standard one, not the fitted one: {has}"
    return ChosenLaw("fitted", limited.table, limited, why)
