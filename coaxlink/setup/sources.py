"""Layouts from PX4's parameters, and from templates in the motor order of both autopilots."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from coaxlink.errors import InputError
from coaxlink.setup.layout import Layout, Mount, refuse_far
from firmware_params import px4
from firmware_params.ardupilot.frames import DODECAHEXA, FRAMES, OCTAQUAD, Y6, Frame
from firmware_params.errors import TableError
from firmware_params.px4.parameters import MOTOR_1
from firmware_params.px4.realise import FLT_EPSILON

_PX4_OUTPUT = re.compile(r"(\w+)_FUNC(\d+)")  # PWM_MAIN, PWM_AUX, UAVCAN_EC, any driver
_FLAT_M = 1e-3  # heights that differ by less are no heights
# ArduCopter's frames are PX4's as well: its airframes 12001 (octo coax) and 11001 (hexa coax, which is Y6B)
# number and turn their motors alike
TEMPLATES = {
    "x8": ((OCTAQUAD, 1), "four arms in X, eight rotors"),
    "coax-quad": ((OCTAQUAD, 0), "four arms in +, eight rotors"),
    "y6": ((Y6, 10), "three arms, six rotors, the upper ones all clockwise (Y6B)"),
    "hexa-coax": ((DODECAHEXA, 1), "six arms in X, twelve rotors"),
}
_PX4_AIRFRAMES = {  # module.yaml of PX4's control_allocator, v1.15
    1: "a plane", 2: "a VTOL plane with lift rotors", 3: "a VTOL plane whose rotors tilt", 4: "a tailsitter",
    5: "a rover", 6: "a rover", 7: "motors that thrust along all axes", 8: "a multirotor whose rotors tilt",
    9: "a vehicle of the owner's own matrix", 10: "a helicopter", 11: "a helicopter",
    12: "a coaxial helicopter with swash plates", 13: "a rover", 14: "a spacecraft",
}  # fmt: skip
Params = Mapping[str, float | int]


def template(name: str) -> Layout:
    """A layout without a scale. Raises InputError for an unknown name."""
    if name not in TEMPLATES:
        raise InputError("`template`", name, f"one of {', '.join(TEMPLATES)} is expected")
    frame, words = TEMPLATES[name]
    return frame_layout(FRAMES[frame], f"template {name}: {words}")


def px4_layout(params: Params, source: str) -> Layout:
    """CA_* parameters (v1.14 and later; v1.13 with SYS_CTRL_ALLOC = 1).

    Raises InputError where the parameters hold no multirotor.
    """
    if "CA_ROTOR_COUNT" not in params:
        raise InputError(
            source, "CA_ROTOR_COUNT", "missing: PX4 v1.14 or later with a multirotor is expected"
        )
    airframe = params.get("CA_AIRFRAME", 0)
    if airframe:
        kind = _PX4_AIRFRAMES.get(airframe, "a vehicle of another kind")  # type: ignore[arg-type]
        raise InputError(source, f"CA_AIRFRAME {airframe:g}", f"{kind}: a multirotor (0) is expected")
    try:
        table = px4.params_to_table(params)
    except TableError as error:
        raise InputError(source, "", f"holds no multirotor: {error}") from error
    outputs = _px4_outputs(params)
    heights = [rotor.position_m[2] for rotor in table.rotors]
    flat = max(heights) - min(heights) < _FLAT_M
    mounts = []
    for n, rotor in enumerate(table.rotors, start=1):
        if rotor.km == 0.0:
            raise InputError(source, f"CA_ROTOR{n - 1}_KM", "0: which way the rotor turns is not known")
        refuse_far(source, n, rotor.position_m)
        norm = math.hypot(*rotor.axis)
        if not FLT_EPSILON < norm < math.inf:
            raise InputError(source, f"CA_ROTOR{n - 1}_AX, _AY and _AZ", "are no direction")
        ax, ay, az = (a / norm for a in rotor.axis)  # as PX4 does
        x, y, z = rotor.position_m
        spin = "ccw" if rotor.km > 0 else "cw"
        connectors = " and ".join(outputs.get(n, ()))
        mounts.append(Mount(x, y, None if flat else z, spin, None, connectors, (ax, ay, az)))
    notes = []
    if flat:
        notes.append("CA_ROTOR*_PZ are all alike: which rotor of a pair is the upper one stands nowhere")
    idle = tuple(n for n in range(1, len(mounts) + 1) if n not in outputs)
    if sum(_PX4_OUTPUT.fullmatch(name) is not None for name in params) < len(mounts):
        idle = ()  # a file of a few parameters does not say
    return Layout(source, tuple(mounts), metres=True, notes=tuple(notes), idle=idle)


def frame_layout(motors: Frame, source: str) -> Layout:
    """The layout of one of ArduCopter's own frames."""
    mounts = []
    for motor in motors:
        x, y = motor.place
        spin = "ccw" if motor.yaw > 0 else "cw"
        mounts.append(Mount(x, y, None, spin, motor.layer or None, order=motor.test_place))
    return Layout(source, tuple(mounts), metres=False)


def _px4_outputs(params: Params) -> dict[int, list[str]]:
    """Motor number -> connectors."""
    found: dict[int, list[str]] = {}
    for name, value in params.items():
        match = _PX4_OUTPUT.fullmatch(name)
        if match and MOTOR_1 <= value < math.inf:
            connector = f"{match[1].removeprefix('PWM_').replace('_', ' ')} {match[2]}"
            found.setdefault(int(value) - MOTOR_1 + 1, []).append(connector)
    return found
