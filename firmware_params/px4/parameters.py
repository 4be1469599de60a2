"""PX4's table parameters: type, range and default of each, as its own metadata states them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from firmware_params import parameters
from firmware_params.errors import Finding
from firmware_params.parameters import FLOAT, INT32, BoardParameter

MAX_ROTORS = 12
MOTOR_1 = 101  # as a value of the *_FUNC parameters; motors count on from it

PARAMETERS = parameters.by_name(
    [
        BoardParameter("CA_AIRFRAME", INT32, 0, 15, 0),
        BoardParameter("CA_METHOD", INT32, 0, 2, 2),
        BoardParameter("CA_ROTOR_COUNT", INT32, 0, MAX_ROTORS, 0),
        BoardParameter("CA_R_REV", INT32, 0, 4095, 0),
        BoardParameter("MC_AIRMODE", INT32, 0, 2, 0),
        BoardParameter("MPC_THR_HOVER", FLOAT, 0.1, 0.8, 0.5),
        BoardParameter("SYS_CTRL_ALLOC", INT32, 0, 1, 0),
        BoardParameter("THR_MDL_FAC", FLOAT, 0, 1, 0),
        *(
            BoardParameter(f"CA_ROTOR{n}_{field}", FLOAT, low, high, default)
            for n in range(MAX_ROTORS)
            for field, low, high, default in (
                ("AX", -100, 100, 0),
                ("PX", -100, 100, 0),
                ("AY", -100, 100, 0),
                ("PY", -100, 100, 0),
                ("AZ", -100, 100, -1.0),
                ("PZ", -100, 100, 0),
                ("CT", 0, 100, 6.5),
                ("KM", -1, 1, 0.05),
            )
        ),
    ]
)


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
    return parameters.out_of_range(params, PARAMETERS, "px4", "PX4")
