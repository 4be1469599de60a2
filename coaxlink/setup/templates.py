"""Layouts to start from, in the motor order of the firmware that will fly them."""

from __future__ import annotations

import math

from coaxlink.errors import InputError
from coaxlink.setup.layout import Layout, Mount
from firmware_params.ardupilot.frames import DODECAHEXA, FRAMES, OCTAQUAD, Y6, Motor

# ArduCopter's frames are PX4's as well: its airframes 12001 (octo coax) and 11001 (hexa coax, which is Y6B)
# number and turn their motors alike
TEMPLATES = {
    "x8": ((OCTAQUAD, 1), "four arms in X, eight rotors"),
    "coax-quad": ((OCTAQUAD, 0), "four arms in +, eight rotors"),
    "y6": ((Y6, 10), "three arms, six rotors, the upper ones all clockwise (Y6B)"),
    "hexa-coax": ((DODECAHEXA, 1), "six arms in X, twelve rotors"),
}


def template(name: str) -> Layout:
    """A layout without a scale. Raises InputError for an unknown name."""
    if name not in TEMPLATES:
        raise InputError("`template`", name, f"one of {', '.join(TEMPLATES)} is expected")
    frame, words = TEMPLATES[name]
    return frame_layout(FRAMES[frame], f"template {name}: {words}")


def frame_layout(motors: tuple[Motor, ...], source: str) -> Layout:
    """The layout of one of ArduCopter's own frames."""
    mounts = []
    for motor in motors:
        angle = math.radians(motor.angle_deg)
        spin = "ccw" if motor.yaw > 0 else "cw"
        mounts.append(
            Mount(_clean(math.cos(angle)), _clean(math.sin(angle)), None, spin, motor.layer or None)
        )
    return Layout(source, tuple(mounts), metres=False)


def _clean(value: float) -> float:
    return 0.0 if abs(value) < 1e-12 else value
