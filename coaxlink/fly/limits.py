"""What `coaxlink fly` does not go beyond, whatever the autopilot's own fence and failsafes say.

All of it is asked of the plan before arming, and of the vehicle at every position it sends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from coaxlink.fly.plans import peaks
from coaxlink.fly.trajectory import FlightPlan

# metres that a vehicle in gusts is off its set-point at most: three times what the paper's X8 was in 8 m/s
OFF_PLAN_M = 3.0
# tilt is what the plan may ask; gusts add theirs, and beyond 50 degrees half of the thrust is gone sideways
TILT_IN_FLIGHT_DEG = 50.0
PLAN_TILT_DEG = 30.0


@dataclass(frozen=True)
class FlightLimits:
    """A cylinder around the place of take-off, a speed, and what must stay in the battery."""

    radius_m: float = 30.0
    ceiling_m: float = 15.0
    floor_m: float = 1.0  # of a plan: lower is the landing's
    speed_m_s: float = 6.0
    battery: float = 0.3  # share of the charge; 0 asks for nothing
    off_plan_m: float = OFF_PLAN_M


@dataclass(frozen=True)
class PositionState:
    """What the vehicle says of itself, relative to the place of take-off."""

    north_m: float
    east_m: float
    height_m: float
    off_plan_m: float
    tilt_deg: float
    battery: float | None  # share of the charge, None where it is not reported


def plan_faults(plan: FlightPlan, limits: FlightLimits) -> list[str]:
    """What of a plan is beyond the limits, a line each; empty when all is within."""
    found = peaks(plan)
    faults = []
    for what, value, most, unit in (
        ("distance", found["radius_m"], limits.radius_m, "m"),
        ("height", found["highest_m"], limits.ceiling_m, "m"),
        ("speed", found["speed_m_s"], limits.speed_m_s, "m/s"),
        ("tilt", found["tilt_deg"], PLAN_TILT_DEG, "degrees"),
    ):
        if value > most:
            faults.append(f"the plan's {what} reaches {value:.1f} {unit}, {most:g} is the limit")
    if found["lowest_m"] < limits.floor_m:
        faults.append(f"the plan comes down to {found['lowest_m']:.2f} m, {limits.floor_m:g} is the limit")
    return faults


def breach(state: PositionState, limits: FlightLimits) -> str | None:
    """The first limit that a vehicle in flight is beyond, in words; None while all is well.

    >>> breach(PositionState(0.0, 31.0, 3.0, 0.2, 4.0, 0.8), FlightLimits())
    '31.0 m from the take-off point, 30 is the limit'
    """
    away = math.hypot(state.north_m, state.east_m)
    if away > limits.radius_m:
        return f"{away:.1f} m from the take-off point, {limits.radius_m:g} is the limit"
    if state.height_m > limits.ceiling_m:
        return f"{state.height_m:.1f} m high, {limits.ceiling_m:g} is the limit"
    if state.off_plan_m > limits.off_plan_m:
        return f"{state.off_plan_m:.1f} m off its set-point, {limits.off_plan_m:g} is the limit"
    if state.tilt_deg > TILT_IN_FLIGHT_DEG:
        return f"tilted by {state.tilt_deg:.0f} degrees, {TILT_IN_FLIGHT_DEG:g} is the limit"
    if limits.battery > 0 and state.battery is not None and state.battery < limits.battery:
        return f"battery at {100 * state.battery:.0f} %, {100 * limits.battery:.0f} is the limit"
    return None
