"""Which output of an autopilot drives which motor, and what its pulses command: one place for all logs.

Motors and outputs are counted from 1.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PX4_MOTOR_1 = 101  # of the *_FUNC parameters
ARDUPILOT_MOTOR_1 = 33  # of SERVOn_FUNCTION
LEAST_PULSE_US = 800  # an output that never gives one carries no motor


def px4_outputs(parameters: Mapping[str, Any]) -> dict[int, int]:
    """{motor: output} by PWM_MAIN_FUNCn and PWM_AUX_FUNCn; {} before 1.13, which has none."""
    found = {}
    for name, value in parameters.items():
        match = re.fullmatch(r"PWM_(?:MAIN|AUX)_FUNC(\d+)", name)
        if match and PX4_MOTOR_1 <= value < PX4_MOTOR_1 + 12:
            found[int(value) - PX4_MOTOR_1 + 1] = int(match[1])
    return found


def ardupilot_outputs(parameters: Mapping[str, float]) -> dict[int, int]:
    """{motor: output} by SERVOn_FUNCTION; {} before 2016, where motors are the first outputs."""
    functions = {output: parameters.get(f"SERVO{output}_FUNCTION", 0) for output in range(1, 15)}
    return {
        int(function) - ARDUPILOT_MOTOR_1 + 1: output
        for output, function in functions.items()
        if ARDUPILOT_MOTOR_1 <= function < ARDUPILOT_MOTOR_1 + 8
    }


def used_outputs(pulses: Mapping[int, Array]) -> list[int]:
    """The outputs that give a pulse at all."""
    return [output for output, pulse in pulses.items() if (pulse >= LEAST_PULSE_US).any()]


def commands(
    outputs: Mapping[int, int], pulses: Mapping[int, Array], low: float = 1000.0, high: float = 2000.0
) -> dict[str, Array]:
    """motor1..N (n,), 0..1, of the pulses (us, by output) between `low` and `high`."""
    return {
        f"motor{motor}": np.clip((pulses[output] - low) / (high - low), 0, 1)
        for motor, output in sorted(outputs.items())
    }
