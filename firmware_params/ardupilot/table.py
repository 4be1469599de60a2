"""A mixer table as ArduCopter holds it: factors of each motor, and the MOT_ parameters around them.

ArduPilot's own frames have factors of their own (see `frames`); class 15
takes them from a script and scales every axis to a largest factor of 0.5 (throttle to 1); class 17 takes
them from a script as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from firmware_params.ardupilot.frames import frame_of
from firmware_params.errors import TableError

SCRIPTING_MATRIX, DYNAMIC_MATRIX = 15, 17
MAX_MOTORS = 32  # AP_MOTORS_MAX_NUM_MOTORS, since 4.5; boards with fewer outputs hold fewer
Factors = tuple[float, float, float, float]  # roll, pitch, yaw, throttle


@dataclass(frozen=True)
class MotorParameters:
    """The MOT_ parameters that shape a motor's output."""

    thst_expo: float = 0.65
    spin_min: float = 0.15
    spin_max: float = 0.95
    spin_arm: float = 0.1
    yaw_headroom: float = 200.0
    pwm_min: float = 1000.0
    pwm_max: float = 2000.0
    thst_hover: float = 0.35

    @classmethod
    def from_params(cls, params: Mapping[str, float | int]) -> MotorParameters:
        """From MOT_ names; a missing one has ArduPilot's default."""
        given = {
            name: float(params[f"MOT_{name.upper()}"])
            for name in cls.__dataclass_fields__
            if f"MOT_{name.upper()}" in params
        }
        return replace(cls(), **given)

    def to_params(self) -> dict[str, float]:
        """{"MOT_THST_EXPO": ..., ...}."""
        return {f"MOT_{name.upper()}": float(getattr(self, name)) for name in self.__dataclass_fields__}


@dataclass(frozen=True)
class ApTable:
    """Everything ArduPilot's multirotor mixer reads."""

    frame_class: int
    factors: tuple[Factors, ...] = ()  # (N,) as the script gives them; empty for a built-in frame
    parameters: MotorParameters = field(default_factory=MotorParameters)
    frame_type: int = 1


def expo_for(factor: float, spin_min: float, spin_max: float = 1.0) -> float:
    """MOT_THST_EXPO that keeps the curve thrust = f u^2 + (1 - f) u over the spin range, up to a constant.

    With u = s + (S - s) a the quadratic in a has its terms in the ratio Q : L, and ArduPilot's curve is
    e a^2 + (1 - e) a. What stays is the thrust at SPIN_MIN, the same share of every motor.
    """
    span = spin_max - spin_min
    quadratic = factor * span**2
    linear = span * (2.0 * factor * spin_min + 1.0 - factor)
    return quadratic / (quadratic + linear)


def motor_test_sequence(frame_class: int, frame_type: int) -> tuple[int, ...]:
    """Where motor 1, 2, ... stand in the order of the firmware's motor test (its parameter 1, from 1).

    Our scripts (classes 15 and 17) number them as the motors. Raises TableError for a frame not known here.
    """
    if frame_class in (SCRIPTING_MATRIX, DYNAMIC_MATRIX):
        return tuple(range(1, MAX_MOTORS + 1))
    frame = frame_of(frame_class, frame_type)
    if frame is None:
        raise TableError(f"FRAME_CLASS {frame_class} type {frame_type} is not known to coaxlink")
    return tuple(motor.test_place for motor in frame)


def used_factors(table: ApTable) -> NDArray[np.float64]:
    """(N, 4) factors inside ArduPilot. Raises TableError for a frame or factors that it would not take."""
    frame = frame_of(table.frame_class, table.frame_type)
    if table.frame_class in (SCRIPTING_MATRIX, DYNAMIC_MATRIX):
        given = list(table.factors)
    elif frame is not None:
        given = [motor.factors for motor in frame]
    else:
        raise TableError(f"FRAME_CLASS {table.frame_class} type {table.frame_type} is not known to coaxlink")
    if not 1 <= len(given) <= MAX_MOTORS:
        raise TableError(f"{len(given)} rotors: ArduPilot holds 1..{MAX_MOTORS}")
    factors = np.array(given, float)
    if not np.isfinite(factors).all():
        raise TableError("a rotor's factor is not a finite number")
    return factors if table.frame_class == DYNAMIC_MATRIX else _normalised(factors)


def _normalised(factors: NDArray[np.float64]) -> NDArray[np.float64]:
    scaled = factors.copy()
    scaled[:, 3] = np.maximum(scaled[:, 3], 0.0)
    for axis, largest in ((0, 0.5), (1, 0.5), (2, 0.5), (3, 1.0)):
        top = np.abs(scaled[:, axis]).max()
        if top > 0.0:
            scaled[:, axis] *= largest / top
    return scaled
