"""Where to fly: smooth position set-points as pure functions of time.

Positions are local NED relative to the place of take-off, in m; heights are given positive up.
`table_4_flight` is the paper's test (hover at 3 m, circle of radius 2 m at 4.5 m; Berra, Trujillo and
Heredia 2024, section 5.3); `paper_flight` adds what a residual needs: speed, climb, low hover, yaw.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, Protocol


@dataclass(frozen=True)
class Setpoint:
    """One offboard set-point, NED."""

    position_m: tuple[float, float, float]
    velocity_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    acceleration_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_rad: float = 0.0


class Segment(Protocol):
    """A named stretch of flight."""

    @property
    def name(self) -> str: ...
    @property
    def duration_s(self) -> float: ...
    def at(self, t: float) -> Setpoint:
        """Set-point at `t` s into the segment."""
        ...


@dataclass(frozen=True)
class Hold:
    """Stay at a place."""

    name: str
    position_m: tuple[float, float, float]
    duration_s: float
    yaw_rad: float = 0.0

    def at(self, t: float) -> Setpoint:
        return Setpoint(self.position_m, yaw_rad=self.yaw_rad)


@dataclass(frozen=True)
class Move:
    """Straight from rest to rest along the minimum-jerk polynomial 10 s^3 - 15 s^4 + 6 s^5."""

    name: str
    start_m: tuple[float, float, float]
    end_m: tuple[float, float, float]
    duration_s: float
    yaw_start_rad: float = 0.0
    yaw_end_rad: float = 0.0

    def at(self, t: float) -> Setpoint:
        s, T = min(max(t / self.duration_s, 0.0), 1.0), self.duration_s
        p = s**3 * (10 - 15 * s + 6 * s * s)
        v = 30 * s**2 * (1 - s) ** 2 / T
        a = 60 * s * (1 - 3 * s + 2 * s * s) / T**2
        return _between(self, p, v, a)


@dataclass(frozen=True)
class Circle:
    """Level circle, entered and left at rest at (radius, 0): the rate rises and falls over `ramp_s`."""

    name: str
    radius_m: float
    down_m: float
    period_s: float
    laps: int
    ramp_s: float = 2.0

    @property
    def duration_s(self) -> float:
        return self.laps * self.period_s + self.ramp_s

    def at(self, t: float) -> Setpoint:
        rate = 2 * math.pi / self.period_s
        end, ramp = self.duration_s, self.ramp_s

        def eased(x: float) -> tuple[float, float, float]:
            s = min(max(x / ramp, 0.0), 1.0)
            return ramp * (s**3 - s**4 / 2) + max(x - ramp, 0.0), 3 * s**2 - 2 * s**3, 6 * s * (1 - s) / ramp

        # the rate is a smooth step up at the start less a smooth step up that begins ramp_s before the end
        rise, fall = eased(t), eased(t - (end - ramp))
        angle, w, dw = (rate * (a - b) for a, b in zip(rise, fall, strict=True))
        r, c, s = self.radius_m, math.cos(angle), math.sin(angle)
        return Setpoint(
            (r * c, r * s, self.down_m),
            (-r * w * s, r * w * c, 0.0),
            (-r * (w * w * c + dw * s), r * (dw * c - w * w * s), 0.0),
        )


@dataclass(frozen=True)
class FlightPlan:
    """Segments flown one after the other."""

    segments: tuple[Segment, ...]

    @property
    def duration_s(self) -> float:
        return sum(s.duration_s for s in self.segments)

    def at(self, t: float) -> tuple[str, Setpoint]:
        """Name of the segment and its set-point at `t` s; before the start and after the end it holds."""
        ends = list(accumulate(s.duration_s for s in self.segments))
        index = min(bisect_right(ends, t), len(ends) - 1)
        segment = self.segments[index]
        start = ends[index] - segment.duration_s
        return segment.name, segment.at(min(max(t - start, 0.0), segment.duration_s))


HOVER, RIM = (0.0, 0.0, -3.0), (2.0, 0.0, -4.5)
_PAPER: tuple[Segment, ...] = (
    Hold("hover", HOVER, 6.0),
    Move("to the circle", HOVER, RIM, 3.0),
    Circle("circle", 2.0, -4.5, 8.0, 2),
)


def table_4_flight() -> FlightPlan:
    """The paper's own test: hover at 3 m, the circle of 2 m at 4.5 m; 27 s."""
    return FlightPlan(_PAPER)


def mixer_flight() -> FlightPlan:
    """What separates mixers: hover, a slow and a fast circle of 2 m, a climb, quick turns; 32 s."""
    rim, high, turn = RIM, (0.0, 0.0, -8.0), math.radians(100)
    return FlightPlan(
        (
            Hold("hover", HOVER, 5.0),
            Move("to the circle", HOVER, rim, 3.0),
            Circle("circle", 2.0, -4.5, 8.0, 1),
            Circle("fast circle", 2.0, -4.5, 3.6, 2),
            Move("climb", rim, high, 4.0),
            Move("yaw right", high, high, 2.5, 0.0, turn),
            Move("yaw left", high, high, 2.5, turn, 0.0),
        )
    )


def paper_flight() -> FlightPlan:
    """The paper's test, then a fast circle, climb and descent, yaw, low hover; about 65 s."""
    hover, rim, high, low = HOVER, RIM, (0.0, 0.0, -8.0), (0.0, 0.0, -0.55)
    turn = math.radians(100)
    return FlightPlan(
        (
            *_PAPER,
            Circle("fast circle", 2.0, -4.5, 3.6, 3),
            Move("climb", rim, high, 3.0),
            Move("descent", high, hover, 6.5),
            Move("yaw right", hover, hover, 2.5, 0.0, turn),
            Move("yaw left", hover, hover, 2.5, turn, 0.0),
            Move("to low hover", hover, low, 2.5),
            Hold("low hover", low, 5.0),
            Move("up again", low, hover, 2.5),
            Hold("last hover", hover, 3.0),
        )
    )


@dataclass(frozen=True)
class Swing:
    """To another place and heading and back, `cycles` times along a cosine; or, with none, there to stay."""

    name: str
    start_m: tuple[float, float, float]
    end_m: tuple[float, float, float]
    duration_s: float
    cycles: int
    yaw_start_rad: float = 0.0
    yaw_end_rad: float = 0.0

    def at(self, t: float) -> Setpoint:
        if not self.cycles:
            yaws = self.yaw_start_rad, self.yaw_end_rad
            return Move(self.name, self.start_m, self.end_m, self.duration_s, *yaws).at(t)
        w = 2.0 * math.pi * self.cycles / self.duration_s
        p, v, a = 0.5 * (1 - math.cos(w * t)), 0.5 * w * math.sin(w * t), 0.5 * w * w * math.cos(w * t)
        return _between(self, p, v, a)


def _between(way: Move | Swing, p: float, v: float, a: float) -> Setpoint:
    """At share `p` of a way between two places, with its derivatives in 1/s and 1/s^2."""
    step = [e - b for b, e in zip(way.start_m, way.end_m, strict=True)]
    north, east, down = (b + p * d for b, d in zip(way.start_m, step, strict=True))
    return Setpoint(
        (north, east, down),
        (v * step[0], v * step[1], v * step[2]),
        (a * step[0], a * step[1], a * step[2]),
        way.yaw_start_rad + p * (way.yaw_end_rad - way.yaw_start_rad),
    )


def planned_flight(document: Mapping[str, Any]) -> FlightPlan:
    """A plan as `coaxlink refine --plan` writes it (height_m, pieces), settled in a hover first."""
    place, yaw = (0.0, 0.0, -float(document["height_m"])), 0.0
    segments: list[Segment] = [Hold("settle", place, 4.0)]
    for number, piece in enumerate(document["pieces"], start=1):
        north, east = (float(piece.get(k, p)) for k, p in zip(("north_m", "east_m"), place[:2], strict=True))
        there = (north, east, -float(piece.get("height_m", -place[2])))
        heading = math.radians(float(piece["yaw_deg"])) if "yaw_deg" in piece else yaw
        cycles = int(piece.get("cycles", 0))
        what = str(piece.get("what", f"piece {number}"))
        segments.append(Swing(what, place, there, float(piece["seconds"]), cycles, yaw, heading))
        if not cycles:
            place, yaw = there, heading
    return FlightPlan(tuple(segments))
