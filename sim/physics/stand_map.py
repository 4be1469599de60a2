"""A raw stand map of a pair, read by the world's own reader: steady rows of both rotors, nothing fitted.

Columns are coaxlink's own (`upper_throttle`, `lower_thrust_N`, ...; `voltage_V` for both or one a side) or
those that the platform of Buzzatto and Liarokapis writes (`PWM Left`, `Thrust Right [g]`, ...), left for
upper.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from firmware_params import bounded
from sim.errors import SimulationError

Array = NDArray[np.float64]
SIDES = (("upper", "left"), ("lower", "right"))
# column: the platform's heading, and scale and offset from its unit to ours
HEADINGS = {
    "throttle": (r"pwm {side}", 1e-3, -1.0), "rpm": (r"speed {side} \[rpm\]", 1.0, 0.0),
    "thrust_N": (r"thrust {side} \[g\]", 9.80665e-3, 0.0), "torque_Nm": (r"torque {side} \[nm\]", 1.0, 0.0),
    "voltage_V": (r"voltage {side} \[v\]", 1.0, 0.0), "current_A": (r"current {side} \[a\]", 1.0, 0.0),
}  # fmt: skip
NEEDED = ("throttle", "rpm", "thrust_N", "torque_Nm")
RPM_AT_REST, OFF = 1.0, 0.02  # at no throttle a rotor only runs down
LEAST_ROWS, MOST_ROWS = 20, 400  # of different throttles; more are averaged: a plate takes their cube in time
CELL = 0.002  # of throttle: rows within it are one
NARROW = 0.1  # width over length of the cloud of throttles; a line says nothing of one rotor beside the other


@dataclass(frozen=True)
class Side:
    """One rotor, a row a steady point."""

    throttle: Array  # (rows,) 0..1
    rpm: Array  # (rows,)
    thrust_N: Array  # (rows,)
    torque_Nm: Array  # (rows,) positive where the motor drives
    voltage_V: Array | None = None  # (rows,)
    current_A: Array | None = None  # (rows,)


def read_map(path: Path) -> tuple[Side, Side]:
    """Upper and lower rotor where both turn, one row for each two throttles. Raises WorldError."""
    names, lines = _table(path)
    sides = [_columns(path, names, lines, *side) for side in SIDES]
    turning = [(s["rpm"] > RPM_AT_REST) & (s["throttle"] > OFF) for s in sides]
    whole = [np.isfinite(column) for s in sides for column in s.values()]
    kept = np.logical_and.reduce([*turning, *whole])
    throttles = np.stack([s["throttle"][kept] for s in sides], axis=1)
    points, each = _points(throttles)
    if points < LEAST_ROWS:
        problem = f"{points} rows in which both rotors turn; {LEAST_ROWS} at least make a map"
        raise SimulationError(path, "", problem)
    count = np.bincount(each)
    means = [{k: np.bincount(each, x[kept]) / count for k, x in s.items()} for s in sides]
    upper, lower = (Side(**s) for s in means)
    for name, pair in (("throttles", (upper.throttle, lower.throttle)), ("speeds", (upper.rpm, lower.rpm))):
        cloud = np.stack(pair, axis=1)
        length, width = np.linalg.svd(cloud - cloud.mean(axis=0), compute_uv=False)
        if width <= NARROW * length:
            problem = f"a map has each rotor beside a slow and a fast one; here the {name} lie on a line"
            raise SimulationError(path, "", problem)
    return upper, lower


def _points(throttles: Array) -> tuple[int, NDArray[np.intp]]:
    """How many different throttles (rows, 2) there are, and of which of them each row is."""
    cell = CELL
    while True:
        found, each = np.unique(np.round(throttles / cell), axis=0, return_inverse=True)
        if len(found) <= MOST_ROWS:
            return len(found), each.reshape(-1)
        cell *= 2.0


def _table(path: Path) -> tuple[list[str], list[list[str]]]:
    """Headings in small letters, and lines of as many cells. Raises WorldError."""
    try:
        text = bounded.read_text(path, bounded.TEXT)
        head, *lines = [line for line in csv.reader(text.splitlines()) if line] or [[]]
    except OSError as error:
        raise SimulationError(path, "", f"cannot be read ({error.strerror})") from error
    except bounded.Unreadable as error:
        raise SimulationError(path, error.where, error.problem) from error
    except csv.Error as error:
        raise SimulationError(path, "", f"a table with commas is expected ({error})") from error
    for n, line in enumerate(lines, 2):
        if len(line) != len(head):
            raise SimulationError(path, f"row {n}", f"{len(head)} cells are expected, found {len(line)}")
    return [name.strip().lstrip("\ufeff").lower() for name in head], lines


def _columns(
    path: Path, names: list[str], lines: list[list[str]], ours: str, theirs: str
) -> dict[str, Array]:
    """The columns that a side has. Raises WorldError naming one that is missing, or the row of a word."""
    side: dict[str, Array] = {}
    for kind, (pattern, scale, offset) in HEADINGS.items():
        own = [f"{ours}_{kind}".lower(), *(["voltage_v"] if kind == "voltage_V" else [])]
        known = [names.index(name) for name in own if name in names]
        foreign = [i for i, name in enumerate(names) if re.fullmatch(pattern.format(side=theirs), name)]
        if known:
            side[kind] = _numbers(path, names, lines, known[0])
        elif foreign:
            side[kind] = _numbers(path, names, lines, foreign[0]) * scale + offset
        elif kind in NEEDED:
            raise SimulationError(path, f"{ours}_{kind}", "a stand map has this column of each rotor")
    if np.nansum(side["torque_Nm"]) < 0.0:  # cells read the two sides against each other
        side["torque_Nm"] = -side["torque_Nm"]
    return side


def _numbers(path: Path, names: list[str], lines: list[list[str]], column: int) -> Array:
    """A column; empty cells are NaN. Raises WorldError."""
    out = np.empty(len(lines))
    for n, line in enumerate(lines):
        try:
            out[n] = float(line[column]) if line[column].strip() else np.nan
        except ValueError:
            where = f"row {n + 2}, {names[column]}"
            raise SimulationError(path, where, f"a number is expected, found {line[column]!r}") from None
    return out
