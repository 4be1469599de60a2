"""What either firmware's own metadata states of a parameter, and values held against it.

Neither checks a range when a parameter is set over MAVLink, so the check is ours.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from firmware_params.errors import Finding

INT8, INT16, INT32, FLOAT = 2, 4, 6, 9  # MAV_PARAM_TYPE, also the last column of QGC's files


@dataclass(frozen=True)
class BoardParameter:
    """One parameter: `minimum` and `maximum` are inclusive."""

    name: str
    type: int  # MAV_PARAM_TYPE
    minimum: float
    maximum: float
    default: float = 0.0


def by_name(rows: Iterable[BoardParameter]) -> Mapping[str, BoardParameter]:
    """A firmware's parameters."""
    return {row.name: row for row in rows}


def out_of_range(
    params: Mapping[str, float | int], known: Mapping[str, BoardParameter], prefix: str, firmware: str
) -> list[Finding]:
    """Findings (`prefix`.not-finite, `prefix`.out-of-range) for values outside the documented range."""
    found = []
    for name, value in params.items():
        limits = known.get(name)
        if not math.isfinite(value):
            found.append(Finding(f"{prefix}.not-finite", "error", f"{name} is {value}; a number is expected"))
        elif limits and not limits.minimum <= value <= limits.maximum:
            text = f"{name} = {value:g} is outside {limits.minimum:g}..{limits.maximum:g}"
            found.append(Finding(f"{prefix}.out-of-range", "error", text, f"{firmware} stores it unchecked"))
    return found
