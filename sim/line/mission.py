"""Missions on board: the items as they were sent, and how they are flown.

Knows no MAVLink beyond the numbers that items carry; `mission_link.py` brings them. A first item that
ArduPilot keeps for home is never flown.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Three = tuple[float, float, float]
WAYPOINT, LOITER, LOITER_TIME, RTL, LAND, TAKEOFF, SPLINE, DELAY = 16, 17, 19, 20, 21, 22, 82, 93
CHANGE_SPEED, JUMP = 178, 177
NAVIGATION = {WAYPOINT, LOITER, LOITER_TIME, RTL, LAND, TAKEOFF, SPLINE, DELAY}
# cameras, gimbals, servos, yaw and the like: taken, of no effect
REST = {112, 115, 179, 181, 183, 187, 189, 195, 197, 203, 205, 206, 211, 214, 530, 531, 532, 1000, 1001}
REST |= {2000, 2001, 2500, 2501}
KNOWN = NAVIGATION | REST | {CHANGE_SPEED, JUMP}
ABOVE_SEA, ABOVE_HOME = (0, 5), (3, 6)  # frames
FRAMES = (*ABOVE_SEA, *ABOVE_HOME, 2)


@dataclass(frozen=True)
class Item:
    """One item: places as 1e7 degrees, as it came."""

    frame: int
    command: int
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float
    autocontinue: int = 1

    def position(self, home: Any, here: Three) -> Three:
        """Where it is, NED from home; (0, 0) is the place one is at."""
        north, east = here[:2] if self.x == 0 and self.y == 0 else home.local(self.x * 1e-7, self.y * 1e-7)
        return north, east, home.alt - self.z if self.frame in ABOVE_SEA else -self.z


@dataclass(frozen=True)
class Leg:
    """What to fly to now: a place and perhaps a heading (rad), or down to the ground."""

    target: Three
    yaw: float = math.nan
    climb_first: bool = False
    landing: bool = False


class Mission:
    """The items of an autopilot, by mission type (0 flown, 1 fence, 2 rally points), and its progress."""

    def __init__(self, first: int = 0) -> None:
        self.first = first
        self.items: dict[int, list[Item]] = {0: [], 1: [], 2: []}
        self.reached: Callable[[int], None] = lambda seq: None
        self.speed = 0.0  # along the ground, once an item has set it
        self.restart()

    def put(self, kind: int, items: list[Item]) -> None:
        """A new list, whole."""
        self.items[kind] = items
        if kind == 0:
            self.restart()

    def restart(self) -> None:
        """From its first item."""
        self.go_to(self.first)
        self.complete = False
        self._jumps: dict[int, int] = {}

    def go_to(self, seq: int) -> bool:
        """Make `seq` the current item; False if there is none."""
        if seq != self.first and not 0 <= seq < len(self.items[0]):
            return False
        self.current, self.complete, self.landing = seq, False, False
        self._arrived_s: float | None = None
        self._start: Three | None = None
        self.speed = 0.0 if seq == self.first else self.speed
        return True

    @property
    def flyable(self) -> bool:
        """Whether there is something to fly."""
        return len(self.items[0]) > self.first

    @property
    def starts_with_takeoff(self) -> bool:
        """Whether the first item that moves is a take-off."""
        moves = [item.command for item in self.items[0][self.first :] if item.command in NAVIGATION]
        return bool(moves) and moves[0] == TAKEOFF

    @property
    def state(self) -> int:
        """As MISSION_CURRENT words it: none, not started, complete (the pilot knows active from paused)."""
        return 1 if not self.flyable else 5 if self.complete else 2

    def resume(self) -> None:
        """Entered again: places that are relative to here are taken anew."""
        self._arrived_s = self._start = None
        self.landing = False
        if self.complete:
            self.restart()

    def leg(self, home: Any, here: Three, now_s: float, radius: float, high: float) -> Leg | None:
        """What to fly now, moving on through items that are done; None when all are.

        `here` NED m; `radius` and `high`: how near is there, level and up, where the item does not say.
        """
        for _ in range(len(self.items[0]) + 1):
            if self.current >= len(self.items[0]):
                break
            item = self.items[0][self.current]
            leg = self._fly(item, home, here, now_s, radius, high)
            if leg is not None:
                return leg
        self.complete = True
        return None

    def _fly(
        self, item: Item, home: Any, here: Three, now_s: float, radius: float, high: float
    ) -> Leg | None:
        if item.command not in NAVIGATION:
            self._do(item)
            return None
        if self._start is None:
            self._start = here
        north, east, down = item.position(home, self._start)
        if item.command == TAKEOFF:
            target = (self._start[0], self._start[1], min(down, self._start[2]))
            return None if self._there(here, target, math.inf, 0.3, now_s, 0.0) else Leg(target)
        if item.command in (LAND, RTL):
            return self._come_down((0.0, 0.0) if item.command == RTL else (north, east), here, radius)
        if item.command == DELAY:
            wait = max(item.params[0], 0.0)
            return None if self._there(here, here, 1.0, 1.0, now_s, wait) else Leg(self._start)
        target = (north, east, down)
        near = item.params[1] if item.command in (WAYPOINT, SPLINE) and item.params[1] > 0 else radius
        hold = item.params[0] if item.command != LOITER and math.isfinite(item.params[0]) else 0.0
        hold = math.inf if item.command == LOITER else hold
        return (
            None
            if self._there(here, target, near, high, now_s, hold)
            else Leg(target, math.radians(item.params[3]), climb_first=True)
        )

    def _come_down(self, over: tuple[float, float], here: Three, radius: float) -> Leg:
        assert self._start is not None
        if not self.landing and math.hypot(here[0] - over[0], here[1] - over[1]) < min(radius, 0.5):
            self.landing = True
        return Leg((over[0], over[1], self._start[2]), landing=self.landing)

    def landed(self) -> None:
        """On the ground of a landing item."""
        self._next()
        if self.current >= len(self.items[0]):
            self.complete = True

    def _there(
        self, here: Three, target: Three, near: float, high: float, now_s: float, hold_s: float
    ) -> bool:
        """Whether an item is done: once there, and for `hold_s` after."""
        close = (
            math.hypot(here[0] - target[0], here[1] - target[1]) < near and abs(here[2] - target[2]) < high
        )
        if self._arrived_s is None and close:
            self._arrived_s = now_s
            if math.isinf(hold_s):
                self.reached(self.current)
        if self._arrived_s is None or now_s - self._arrived_s < hold_s:
            return False
        self._next()
        return True

    def _next(self) -> None:
        self.reached(self.current)
        self.current += 1
        self._arrived_s = self._start = None
        self.landing = False

    def _do(self, item: Item) -> None:
        """What is done at once."""
        here = self.current
        if item.command == CHANGE_SPEED and item.params[1] > 0:
            self.speed = item.params[1]
        self._next()
        if item.command == JUMP:
            to, times = int(item.params[0]), int(item.params[1])
            done = self._jumps.get(here, 0)
            if self.first <= to < here and (times < 0 or done < times):
                self._jumps[here] = done + 1
                self.current = to
