"""Flight modes by PX4's numbers, and what a set-point of attitude is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from sim.px4.cascade import Four, Three


class Mode(IntEnum):
    """PX4's main mode << 16 | sub mode << 24, as HEARTBEAT.custom_mode."""

    MANUAL = 1 << 16
    ALTCTL = 2 << 16
    POSCTL = 3 << 16
    ACRO = 5 << 16
    OFFBOARD = 6 << 16
    STABILIZED = 7 << 16
    READY = 4 << 16 | 1 << 24
    TAKEOFF = 4 << 16 | 2 << 24
    HOLD = 4 << 16 | 3 << 24
    MISSION = 4 << 16 | 4 << 24
    RTL = 4 << 16 | 5 << 24
    LAND = 4 << 16 | 6 << 24


FLOWN = (
    Mode.POSCTL,
    Mode.ALTCTL,
    Mode.OFFBOARD,
    Mode.TAKEOFF,
    Mode.HOLD,
    Mode.MISSION,
    Mode.RTL,
    Mode.LAND,
)


@dataclass(frozen=True)
class AttitudeGoal:
    """What SET_ATTITUDE_TARGET asks: an attitude or body rates, and thrust 0..1."""

    attitude: Four | None
    rates: Three
    thrust: float


class Refused(Exception):
    """The autopilot says no, and why."""
