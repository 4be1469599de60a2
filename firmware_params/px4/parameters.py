"""PX4's table parameters: type, range and default of each, as its own metadata states them.

PX4 does not check a range when a parameter is set over MAVLink (CT = 150 is stored), so the check is ours.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from firmware_params.errors import Finding

INT32, FLOAT = 6, 9  # MAV_PARAM_TYPE_INT32 and _REAL32, also the last column of QGC's files
MAX_ROTORS = 12


@dataclass(frozen=True)
class Parameter:
    """One parameter: `minimum` and `maximum` are inclusive."""

    name: str
    type: int  # INT32 or FLOAT
    minimum: float
    maximum: float
    default: float


def _table() -> dict[str, Parameter]:
    rows = [
        Parameter("CA_AIRFRAME", INT32, 0, 15, 0),
        Parameter("CA_METHOD", INT32, 0, 2, 2),
        Parameter("CA_ROTOR_COUNT", INT32, 0, MAX_ROTORS, 0),
        Parameter("CA_R_REV", INT32, 0, 4095, 0),
        Parameter("MC_AIRMODE", INT32, 0, 2, 0),
        Parameter("MPC_THR_HOVER", FLOAT, 0.1, 0.8, 0.5),
        Parameter("SYS_CTRL_ALLOC", INT32, 0, 1, 0),
        Parameter("THR_MDL_FAC", FLOAT, 0, 1, 0),
    ]
    for n in range(MAX_ROTORS):
        for axis in "XYZ":
            rows.append(Parameter(f"CA_ROTOR{n}_A{axis}", FLOAT, -100, 100, -1.0 if axis == "Z" else 0.0))
            rows.append(Parameter(f"CA_ROTOR{n}_P{axis}", FLOAT, -100, 100, 0))
        rows.append(Parameter(f"CA_ROTOR{n}_CT", FLOAT, 0, 100, 6.5))
        rows.append(Parameter(f"CA_ROTOR{n}_KM", FLOAT, -1, 1, 0.05))
    return {row.name: row for row in rows}


PARAMETERS: Mapping[str, Parameter] = _table()


def type_of(name: str, value: float | int) -> int:
    """MAV_PARAM_TYPE of a parameter: from the table, else from the Python type of its value."""
    known = PARAMETERS.get(name)
    if known:
        return known.type
    return INT32 if isinstance(value, int) else FLOAT


def as_stored(name: str, value: float | int) -> float | int:
    """The value PX4 keeps: int32, or the nearest float32. Raises ValueError when it cannot hold it."""
    if type_of(name, value) == INT32:
        if not math.isfinite(value) or value != int(value) or not -(2**31) <= value < 2**31:
            raise ValueError(f"{name} is an int32, found {value}")
        return int(value)
    if abs(value) > np.finfo(np.float32).max and math.isfinite(value):
        raise ValueError(f"{name} is a float32, found {value}")
    return float(np.float32(value))


def out_of_range(params: Mapping[str, float | int]) -> list[Finding]:
    """Findings for values that are not finite or outside PX4's documented range."""
    found = []
    for name, value in params.items():
        if not math.isfinite(value):
            found.append(Finding("px4.not-finite", "error", f"{name} is {value}; a number is expected"))
            continue
        known = PARAMETERS.get(name)
        if known and not known.minimum <= value <= known.maximum:
            text = f"{name} = {value:g} is outside {known.minimum:g}..{known.maximum:g}"
            found.append(Finding("px4.out-of-range", "error", text, "PX4 stores it unchecked"))
    return found
