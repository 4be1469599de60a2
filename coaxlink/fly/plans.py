"""What `coaxlink fly` and `sim --fly` can fly: named plans sized by a height and a reach, and the files of
`refine --plan` and `identify --next`.

Positions are local NED relative to the place of take-off, headings relative to the one there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from coaxlink import files
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.errors import InputError
from coaxlink.fly.trajectory import (
    Circle,
    FlightPlan,
    Hold,
    Move,
    Segment,
    Swing,
    planned_flight,
    table_4_flight,
)
from coaxlink.mixer.authority import doublet_deg
from firmware_params.keys import unknown_key

HEIGHT_M, REACH_M = 4.0, 2.0  # of the named plans, where nobody says (cli/fly has them too)
PERIOD_S = 8.0  # of a lap of the paper's 2 m circle; other radii keep its acceleration
KEYS = ("height_m", "pieces", "kind", "separates")  # of a file
PIECE_KEYS = ("what", "seconds", "cycles", "north_m", "east_m", "height_m", "yaw_deg")
CLIMB = 0.5  # of the reach, up and down
DOUBLETS_S, DOUBLETS = 12.0, 4
# of yaw where no vehicle is known: what `doublet_acceleration` has for the weakest of twenty drawn vehicles
# on their priors' tables (research/flights_convergence.py); the paper's X8 has six times that
CAUTIOUS_RAD_S2 = 0.25


def hover(height_m: float, reach_m: float) -> FlightPlan:
    """20 s in one place."""
    return FlightPlan((Hold("hover", (0.0, 0.0, -height_m), 20.0),))


def circle(height_m: float, reach_m: float) -> FlightPlan:
    """A hover, two laps of radius `reach_m` around the place of take-off, and back."""
    middle, rim = (0.0, 0.0, -height_m), (reach_m, 0.0, -height_m)
    period = PERIOD_S * math.sqrt(max(reach_m, 0.5) / 2.0)
    there = max(3.0, reach_m)
    return FlightPlan(
        (
            Hold("hover", middle, 4.0),
            Move("to the circle", middle, rim, there),
            Circle("circle", reach_m, -height_m, period, 2),
            Move("back", rim, middle, there),
            Hold("last hover", middle, 2.0),
        )
    )


def steps(height_m: float, reach_m: float) -> FlightPlan:
    """Forward, right, up and a turn of 60 degrees, each there, held, and back."""
    middle = (0.0, 0.0, -height_m)
    parts: list[Segment] = [Hold("hover", middle, 4.0)]
    for name, there, yaw in (
        ("forward", (reach_m, 0.0, -height_m), 0.0),
        ("right", (0.0, reach_m, -height_m), 0.0),
        ("up", (0.0, 0.0, -height_m - CLIMB * reach_m), 0.0),
        ("turn", middle, math.radians(60.0)),
    ):
        parts += [
            Move(name, middle, there, 2.5, 0.0, yaw),
            Hold(f"{name}, held", there, 2.0, yaw),
            Move(f"{name}, back", there, middle, 2.5, yaw, 0.0),
            Hold("hover", middle, 1.5),
        ]
    return FlightPlan(tuple(parts))


def identify(height_m: float, reach_m: float, yaw_rad_s2: float = CAUTIOUS_RAD_S2) -> FlightPlan:
    """What tells a rotor model most without a stand: hovers, climbs, yaw doublets, swings each way.

    `yaw_rad_s2` is the doublets' largest acceleration: `mixer.authority` has a vehicle's.
    """
    middle = (0.0, 0.0, -height_m)
    up = (0.0, 0.0, -height_m - CLIMB * reach_m)
    turn = math.radians(doublet_deg(yaw_rad_s2, DOUBLETS_S, DOUBLETS))
    return FlightPlan(
        (
            Hold("hover", middle, 8.0),
            Swing("climbs", middle, up, 12.0, 4),
            Hold("hover", middle, 3.0),
            Swing("yaw doublets", middle, middle, DOUBLETS_S, DOUBLETS, 0.0, turn),
            Hold("hover", middle, 3.0),
            Swing("forward and back", middle, (reach_m, 0.0, -height_m), 12.0, 3),
            Swing("right and back", middle, (0.0, reach_m, -height_m), 12.0, 3),
            Hold("last hover", middle, 5.0),
        )
    )


LONGEST_S = 7200.0  # of a flight: no multirotor's pack lasts longer


NAMED: dict[str, Callable[..., FlightPlan]] = {
    "hover": hover,
    "circle": circle,
    "steps": steps,
    "identify": identify,
    "paper": lambda height_m, reach_m: table_4_flight(),
}


def plan_of(what: str, height_m: float, reach_m: float, yaw_rad_s2: float = CAUTIOUS_RAD_S2) -> FlightPlan:
    """A named plan or a file that `refine --plan` or `identify --next` wrote. Raises InputError.

    `yaw_rad_s2` is the largest acceleration of the yaw doublets of `identify`.

    >>> plan_of("hover", 3.0, 2.0).duration_s
    20.0
    """
    if what == "identify":
        return identify(height_m, reach_m, yaw_rad_s2)
    if what in NAMED:
        return NAMED[what](height_m, reach_m)
    if not what.endswith(".toml"):
        named = ", ".join(NAMED)
        raise InputError(
            "`plan`", what, f"{named} or a PLAN.toml as refine or identify writes it is expected"
        )
    document = files.read_toml(Path(what))
    _refuse_unknown(what, document)
    try:
        plan = planned_flight(document)
        plan.at(0.0)
    except KeyError as error:
        raise InputError(what, str(error.args[0]), "missing; refine and identify write it") from error
    except (TypeError, ValueError) as error:
        raise InputError(what, "", f"not a flight plan as refine or identify writes it ({error})") from error
    if not plan.duration_s <= LONGEST_S:  # NaN too
        raise InputError(what, "seconds", f"{LONGEST_S:g} s in all at most, found {plan.duration_s:g}")
    return plan


def _refuse_unknown(path: str, document: Mapping[str, Any]) -> None:
    """Raise InputError for a key that no plan has: a piece would go nowhere, or stay at the usual height."""
    pieces = document.get("pieces", ())
    tables: list[tuple[str, Mapping[str, Any], tuple[str, ...]]] = [("", document, KEYS)]
    tables += [(f"pieces[{n}].", p, PIECE_KEYS) for n, p in enumerate(pieces, 1) if isinstance(p, dict)]
    for where, table, known in tables:
        if odd := unknown_key(table, known):
            raise InputError(path, f"{where}{odd[0]}", odd[1])


def peaks(plan: FlightPlan) -> dict[str, float]:
    """What a plan asks for at most: distance from the start, heights, m; speed, m/s; tilt, degrees."""
    times = np.arange(0.0, plan.duration_s + 0.05, 0.05)
    points = [plan.at(float(t))[1] for t in times]
    place = np.array([p.position_m for p in points])
    velocity = np.array([p.velocity_m_s for p in points])
    pull = np.array([p.acceleration_m_s2 for p in points])
    return {
        "radius_m": float(np.hypot(place[:, 0], place[:, 1]).max()),
        "highest_m": float(-place[:, 2].min()),
        "lowest_m": float(-place[:, 2].max()),
        "speed_m_s": float(np.linalg.norm(velocity, axis=1).max()),
        "tilt_deg": float(np.degrees(np.arctan2(np.hypot(pull[:, 0], pull[:, 1]), GRAVITY_M_S2)).max()),
    }
