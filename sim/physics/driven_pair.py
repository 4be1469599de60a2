"""Surfaces of a rotor file with its drive and its battery watts (docs/stand.md), as tables."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from sim.documents import read_number, refuse_unknown
from sim.errors import SimulationError
from sim.physics.layout import REACH
from sim.physics.pair import Pair
from sim.physics.tabled_pair import EFFICIENCY, LOW_SPEED, POINTS, SPEED, WATTS, TabledPair, axes

Array = NDArray[np.float64]
UPPER_LOWER = ("upper", "lower")
DRIVE_KEYS = ("command", "torque_per_Nm", "torque_speed_per_Nm", "range", "error")
POWER_KEYS = ("constant", "per_rad_s", "per_rad_s2", "per_Nm2", "shaft", "error")
FIRST = (
    0.05  # throttle to which an older file's curve goes straight from rest: it does not say where it began
)


def driven_pair(path: Path, pair: Pair, document: dict[str, Any]) -> Pair:
    """The pair with the drive and the battery watts of its file, where it has them. Raises WorldError."""
    drive, power = document.get("drive"), document.get("battery_power")
    identified = document.get("identified", {})
    curves = identified.get("rpm_over_throttle") if isinstance(identified, dict) else None
    if drive is None and power is None and curves is None:
        return pair
    grid = axes()
    u, v = grid[..., 0], grid[..., 1]
    tables, volts = np.zeros((8, POINTS, POINTS)), None
    tables[:SPEED] = pair.loads(u, v)
    tables[SPEED], tables[LOW_SPEED] = u, v
    if drive is not None:
        _, given = _sides(path, "drive", drive, ("voltage_V",))
        sides = [_drive(path, name, side) for name, side in zip(UPPER_LOWER, given, strict=True)]
        if "voltage_V" in drive:
            volts = read_number(path, "drive.voltage_V", drive["voltage_V"])
            if volts <= 0.0:
                raise SimulationError(
                    path, "drive.voltage_V", f"a positive number is expected, found {volts:g}"
                )
        for _ in range(3):  # each speed changes the other's torque
            for k, side in enumerate(sides):
                tables[SPEED + k] = _solved(path, side, pair, k, grid, tables)
    elif curves is not None:
        _, given = _sides(path, "identified.rpm_over_throttle", curves)
        for k, (name, side) in enumerate(zip(UPPER_LOWER, given, strict=True)):
            numbers = _numbers(path, f"identified.rpm_over_throttle.{name}", side, 1, 8)
            bent = Polynomial(numbers)(np.maximum(grid[..., k], FIRST)) / pair.speed_max_rpm
            tables[SPEED + k] = np.maximum(bent * np.minimum(grid[..., k] / FIRST, 1.0), 0.0)
    rad_s = pair.speed_max_rpm * math.pi / 30.0
    given = [None, None] if power is None else _sides(path, "battery_power", power)[1]
    for k, (name, side) in enumerate(zip(UPPER_LOWER, given, strict=True)):
        tables[WATTS + k] = _watts(path, name, side, grid[..., k] * rad_s, tables[2 * k + 1])
    return TabledPair(pair.speed_max_rpm, pair.coefficients, tables, volts, pair.radius_m)


def _sides(
    path: Path, where: str, table: Any, more: tuple[str, ...] = ()
) -> tuple[dict[str, Any], list[Any]]:
    """A table of two sides, and the two; one that is absent is as the other. Raises WorldError."""
    if not isinstance(table, dict):
        raise SimulationError(path, where, "a table of upper and lower is expected")
    refuse_unknown(path, where, table, (*UPPER_LOWER, *more))
    present = [table[name] for name in UPPER_LOWER if name in table]
    if not present:
        raise SimulationError(path, where, "upper or lower is expected")
    return table, [table.get(name, present[0]) for name in UPPER_LOWER]


def _numbers(path: Path, where: str, value: Any, least: int, most: int) -> list[float]:
    if not isinstance(value, list) or not least <= len(value) <= most:
        wanted = f"{least} numbers are" if least == most else f"{least} to {most} numbers are"
        raise SimulationError(path, where, f"{wanted} expected")
    return [read_number(path, where, x) for x in value]


def _keyed(path: Path, where: str, side: Any, known: tuple[str, ...]) -> dict[str, Any]:
    if not isinstance(side, dict):
        raise SimulationError(path, where, f"a table of {', '.join(known)} is expected")
    refuse_unknown(path, where, side, known)
    return side


@dataclass(frozen=True)
class _Drive:
    """command = `bend`(u) + (per_Nm + speed_per_Nm u) torque, from `first` on."""

    where: str
    bend: Polynomial
    per_Nm: float
    speed_per_Nm: float
    first: float

    def command(self, u: Array, torque: Array) -> Array:
        """At a normalised speed and the torque (N m) there."""
        return np.asarray(self.bend(u) + (self.per_Nm + self.speed_per_Nm * u) * torque)


def _drive(path: Path, name: str, side: Any) -> _Drive:
    where = f"drive.{name}"
    given = _keyed(path, where, side, DRIVE_KEYS)
    bend = Polynomial(_numbers(path, f"{where}.command", given.get("command"), 2, 6))
    per = [read_number(path, f"{where}.{key}", given.get(key, 0.0)) for key in DRIVE_KEYS[1:3]]
    first, last = _numbers(path, f"{where}.range", given.get("range", [0.0, 1.0]), 2, 2)
    if not 0.0 <= first < last:
        raise SimulationError(
            path, f"{where}.range", f"two rising commands are expected, found {first:g}, {last:g}"
        )
    return _Drive(where, bend, per[0], per[1], first)


def _solved(path: Path, side: _Drive, pair: Pair, k: int, grid: Array, tables: Array) -> Array:
    """(POINTS, POINTS) speeds of side k at the commands given, by halving. Raises WorldError."""
    wanted, other = grid[..., k], tables[LOW_SPEED if k == 0 else SPEED]

    def command(speed: Array) -> Array:
        loads = pair.loads(speed, other) if k == 0 else pair.loads(other, speed)
        return side.command(speed, loads[2 * k + 1])

    low, high = np.zeros(wanted.shape), np.full(wanted.shape, REACH)
    if not (command(np.ones(wanted.shape)) > command(low)).all():
        raise SimulationError(path, f"{side.where}.command", "commands are expected to rise with speed")
    first = max(side.first, 1e-6)
    for _ in range(30):
        middle = 0.5 * (low + high)
        short = command(middle) < np.maximum(wanted, first)
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return 0.5 * (low + high) * np.minimum(wanted / first, 1.0)


def _watts(path: Path, name: str, side: Any, rad_s: Array, torque: Array) -> Array:
    """From the battery over speed and torque; without a law of the file by the shaft. Raises WorldError."""
    drawn = torque * rad_s / EFFICIENCY
    if side is not None:
        where = f"battery_power.{name}"
        given = _keyed(path, where, side, POWER_KEYS)
        c = {key: read_number(path, f"{where}.{key}", value) for key, value in given.items()}
        drawn = c.get("constant", 0.0) + c.get("per_rad_s", 0.0) * rad_s + c.get("per_rad_s2", 0.0) * rad_s**2
        drawn = drawn + c.get("per_Nm2", 0.0) * torque**2 + c.get("shaft", 1.0) * torque * rad_s
    return np.where(rad_s > 0.0, np.maximum(drawn, 0.0), 0.0)
