"""Which of ArduCopter's own frames a vehicle is, motor n being its rotor n."""

from __future__ import annotations

import math

from firmware_params.ardupilot.frames import FRAMES, UNSTATED, Frame, Motor
from sim.vehicle import LEVELS, SimVehicle

APART_DEG = 14.0  # frames with arms elsewhere are 30 degrees and more apart


def own_frame(vehicle: SimVehicle) -> tuple[int, int] | None:
    """FRAME_CLASS and FRAME_TYPE of the frame that fits motor for motor; None where none does."""
    for key, frame in FRAMES.items():
        if len(frame) == vehicle.rotors and all(_is(vehicle, k, motor) for k, motor in enumerate(frame)):
            return key
    return None


def why_none(vehicle: SimVehicle) -> str:
    """What to do about a vehicle without a frame of its own: other numbers, or the other firmware."""
    for (number, kind), frame in FRAMES.items():
        order = _renumbered(vehicle, frame)
        if order:
            frame_name = f"FRAME_CLASS {number}, FRAME_TYPE {kind}"
            return (
                f"ArduCopter numbers them otherwise: rotors {', '.join(map(str, order))} are motors 1 to "
                f"{len(order)} of {frame_name}; number them so, or use --firmware px4"
            )
    return "no frame of ArduCopter's own has such rotors; use --firmware px4"


def _renumbered(vehicle: SimVehicle, frame: Frame) -> list[int]:
    """Numbers of the rotors that are motors 1, 2, ... of a frame; none where it is another."""
    if len(frame) != vehicle.rotors:
        return []
    fitting = [[k + 1 for k in range(vehicle.rotors) if _is(vehicle, k, motor)] for motor in frame]
    order = [numbers[0] for numbers in fitting if len(numbers) == 1]
    return order if len(set(order)) == vehicle.rotors else []


def _is(vehicle: SimVehicle, k: int, motor: Motor) -> bool:
    """Whether rotor k (from 0) stands, turns and is stacked as a motor of a frame."""
    x, y, _ = vehicle.position_m[k]
    apart = (math.degrees(math.atan2(y, x)) - motor.angle_deg + 180.0) % 360.0 - 180.0
    level = int(vehicle.level[k])
    stacked = motor.layer == UNSTATED or level == LEVELS[motor.layer]
    return abs(apart) < APART_DEG and bool(motor.yaw * vehicle.spin[k] > 0.0) and stacked
