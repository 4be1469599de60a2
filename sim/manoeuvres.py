"""A flight from a plan file: places to go to, or to swing to and back, one after the other.

height_m = 3.0                      # where it starts, above home (default 3)

[[pieces]]
seconds = 12.0
north_m = 3.0                       # what is left out stays: north_m, east_m, height_m, yaw_deg
cycles = 3                          # there and back so often, ending where it began; else it goes and stays
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sim.documents import read_document, read_number, refuse_unknown
from sim.errors import SimulationError
from sim.px4.cascade import Goal

KEYS = ("north_m", "east_m", "height_m", "yaw_deg")
LIMITS = {"north_m": 100.0, "east_m": 100.0, "height_m": 100.0, "yaw_deg": 720.0}
LONGEST_S = 1800.0
Four = tuple[float, float, float, float]


@dataclass(frozen=True)
class PlanPiece:
    """From one place and heading (north, east, height in m, heading in rad) to another."""

    start_s: float
    seconds: float
    first: Four
    last: Four
    cycles: int

    def goal(self, t: float) -> Goal:
        """At time t of the plan."""
        x = min(max((t - self.start_s) / self.seconds, 0.0), 1.0)
        if self.cycles:
            w = 2.0 * math.pi * self.cycles
            share, rate, bend = (
                0.5 * (1 - math.cos(w * x)),
                0.5 * w * math.sin(w * x),
                0.5 * w * w * math.cos(w * x),
            )
        else:
            share, rate = x**3 * (10 - 15 * x + 6 * x * x), 30 * (x * (1 - x)) ** 2
            bend = 60 * x * (1 - x) * (1 - 2 * x)
        span = [b - a for a, b in zip(self.first, self.last, strict=True)]
        n, e, h, yaw = (a + share * d for a, d in zip(self.first, span, strict=True))
        v = [rate * d / self.seconds for d in span]
        a = [bend * d / self.seconds**2 for d in span]
        return Goal((n, e, -h), (v[0], v[1], -v[2]), (a[0], a[1], -a[2]), yaw=yaw, yaw_rate=v[3])


def read_plan(path: Path) -> tuple[Callable[[float], Goal], float]:
    """The goal over time, and how long it lasts. Raises WorldError naming the key."""
    document = read_document(path)
    refuse_unknown(path, "", document, ("height_m", "pieces", "kind", "separates"))
    tables = document.get("pieces")
    if not isinstance(tables, list) or not tables:
        raise SimulationError(path, "pieces", "an array of tables [[pieces]] is expected")
    height = read_number(path, "height_m", document.get("height_m", 3.0))
    if not 0.3 <= height <= LIMITS["height_m"]:
        raise SimulationError(path, "height_m", f"0.3 to 100 is expected, found {height:g}")
    start: Four = (0.0, 0.0, height, 0.0)
    pieces: list[PlanPiece] = []
    at = 0.0
    for number, table in enumerate(tables, 1):
        piece = _piece(path, f"pieces[{number}]", table, start, at)
        pieces.append(piece)
        at += piece.seconds
        start = piece.first if piece.cycles else piece.last
    if at > LONGEST_S:
        raise SimulationError(path, "pieces", f"no more than {LONGEST_S:g} s are flown")

    def follow(t: float) -> Goal:
        now = next((p for p in pieces if t < p.start_s + p.seconds), pieces[-1])
        return now.goal(t)

    return follow, at


def _piece(path: Path, where: str, table: Any, start: Four, at: float) -> PlanPiece:
    if not isinstance(table, dict):
        raise SimulationError(path, where, "a table is expected")
    refuse_unknown(path, where, table, ("seconds", "cycles", *KEYS, "what"))
    seconds = read_number(path, f"{where}.seconds", table.get("seconds"))
    cycles = table.get("cycles", 0)
    if seconds < 0.5:
        raise SimulationError(
            path, f"{where}.seconds", f"half a second or more is expected, found {seconds:g}"
        )
    if not isinstance(cycles, int) or isinstance(cycles, bool) or not 0 <= cycles <= 2 * seconds:
        raise SimulationError(
            path, f"{where}.cycles", f"a whole number, at most two a second, found {cycles!r}"
        )
    last = list(start)
    for k, key in enumerate(KEYS):
        if key in table:
            value = read_number(path, f"{where}.{key}", table[key])
            if abs(value) > LIMITS[key] or (key == "height_m" and value < 0.3):
                raise SimulationError(path, f"{where}.{key}", f"out of reach: {value:g}")
            last[k] = math.radians(value) if key == "yaw_deg" else value
    return PlanPiece(at, seconds, start, (last[0], last[1], last[2], last[3]), cycles)
