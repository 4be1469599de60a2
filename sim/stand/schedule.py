"""What the thrust stand is told to do: a schedule file of pieces, run one after the other.

rate_hz = 10.0                      # rows a second (default 10)

[[pieces]]
seconds = 20.0
upper = [0.0, 0.9]                  # throttle from, to; one number holds it
lower = 0.5
supply_V = 30.0                     # a bench supply's setting, or [from, to]; left out, the usual supply
spacing_m = 0.2                     # rotors this far apart; left out, the usual 0.15 m
shape = "ramp"                      # ramp, or steps: switch between from and to every second
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.documents import read_document, read_number, refuse_unknown
from sim.errors import SimulationError

KEYS = ("seconds", "upper", "lower", "supply_V", "spacing_m", "shape", "what")
STEP_S = 1.0
LONGEST_S = 7200.0
MOST_PIECES = 1000


@dataclass(frozen=True)
class Schedule:
    """One row a sample; NaN where the stand is left as it is."""

    time_s: NDArray[np.float64]  # (rows,)
    upper: NDArray[np.float64]  # (rows,) throttle
    lower: NDArray[np.float64]
    supply_V: NDArray[np.float64]
    spacing_m: NDArray[np.float64]
    piece: NDArray[np.float64]  # (rows,) number of the piece


def read_schedule(path: Path) -> Schedule:
    """Read a schedule file. Raises WorldError naming the key."""
    document = read_document(path)
    refuse_unknown(path, "", document, ("rate_hz", "pieces", "kind", "separates"))
    rate = read_number(path, "rate_hz", document.get("rate_hz", 10.0))
    pieces = document.get("pieces")
    if not isinstance(pieces, list) or not pieces:
        raise SimulationError(path, "pieces", "an array of tables [[pieces]] is expected")
    if not 0.1 <= rate <= 1000.0:
        raise SimulationError(path, "rate_hz", f"0.1 to 1000 is expected, found {rate:g}")
    if len(pieces) > MOST_PIECES:
        raise SimulationError(path, "pieces", f"at most {MOST_PIECES} are expected, found {len(pieces)}")
    rows = [_piece(path, number, table, rate) for number, table in enumerate(pieces, 1)]
    rows_ = np.concatenate(rows)
    if len(rows_) / rate > LONGEST_S:
        raise SimulationError(path, "pieces", f"no more than {LONGEST_S:g} s are run")
    time = np.arange(1, len(rows_) + 1) / rate
    return Schedule(time, *rows_.T)


def _piece(path: Path, number: int, table: Any, rate: float) -> NDArray[np.float64]:
    """(rows, 5) upper, lower, supply, spacing, number."""
    where = f"pieces[{number}]"
    if not isinstance(table, dict):
        raise SimulationError(path, where, "a table is expected")
    refuse_unknown(path, where, table, KEYS)
    seconds = read_number(path, f"{where}.seconds", table.get("seconds"))
    if seconds > LONGEST_S:
        raise SimulationError(path, f"{where}.seconds", f"no more than {LONGEST_S:g} s are run")
    count = round(seconds * rate)
    if count < 1:
        raise SimulationError(path, f"{where}.seconds", f"at least one row is expected, found {seconds:g} s")
    shape = table.get("shape", "ramp")
    if shape not in ("ramp", "steps"):
        raise SimulationError(path, f"{where}.shape", f"ramp or steps is expected, found {shape!r}")
    share = np.arange(1, count + 1) / count
    if shape == "steps":
        share = np.floor(np.arange(count) / (rate * STEP_S)) % 2
    out = np.full((count, 5), np.nan)
    limits = {"upper": (0.0, 1.0), "lower": (0.0, 1.0), "supply_V": (1.0, 1000.0), "spacing_m": (0.01, 10.0)}
    for column, (key, (low, high)) in enumerate(limits.items()):
        if key in table or column < 2:
            first, last = _ends(path, f"{where}.{key}", table.get(key), low, high)
            out[:, column] = first + (last - first) * share
    out[:, 4] = number - 1
    return out


def _ends(path: Path, where: str, value: object, low: float, high: float) -> tuple[float, float]:
    ends = value if isinstance(value, list) else [value, value]
    if len(ends) != 2:
        raise SimulationError(path, where, "a number, or [from, to], is expected")
    first, last = (read_number(path, where, v) for v in ends)
    if not (low <= first <= high and low <= last <= high):
        raise SimulationError(path, where, f"{low:g} to {high:g} is expected, found {value}")
    return first, last
