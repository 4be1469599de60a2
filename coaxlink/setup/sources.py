"""Layouts from PX4's parameters, from ArduPilot's, and from templates in the motor order of both."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace

from coaxlink.errors import InputError
from coaxlink.setup.layout import Layout, Mount
from firmware_params import px4
from firmware_params.ardupilot import scripts, servo_function
from firmware_params.ardupilot.frames import DODECAHEXA, FRAMES, OCTAQUAD, Y6, Motor
from firmware_params.ardupilot.table import DYNAMIC_MATRIX, SCRIPTING_MATRIX, Factors
from firmware_params.errors import TableError

_PX4_OUTPUT = re.compile(r"PWM_(MAIN|AUX)_FUNC(\d+)|(UAVCAN|HIL|TAP)_(?:ESC_FUNC|EC_FUNC|ACT_FUNC)(\d+)")
_PX4_MOTOR_1 = 101  # of the *_FUNC parameters
_FLAT_M = 1e-3  # heights that differ by less are no heights
_SERVO_OUTPUTS = 32
# ArduCopter's frames are PX4's as well: its airframes 12001 (octo coax) and 11001 (hexa coax, which is Y6B)
# number and turn their motors alike
TEMPLATES = {
    "x8": ((OCTAQUAD, 1), "four arms in X, eight rotors"),
    "coax-quad": ((OCTAQUAD, 0), "four arms in +, eight rotors"),
    "y6": ((Y6, 10), "three arms, six rotors, the upper ones all clockwise (Y6B)"),
    "hexa-coax": ((DODECAHEXA, 1), "six arms in X, twelve rotors"),
}
Params = Mapping[str, float | int]


def template(name: str) -> Layout:
    """A layout without a scale. Raises InputError for an unknown name."""
    if name not in TEMPLATES:
        raise InputError("`template`", name, f"one of {', '.join(TEMPLATES)} is expected")
    frame, words = TEMPLATES[name]
    return _frame_layout(FRAMES[frame], f"template {name}: {words}")


def px4_layout(params: Params, source: str) -> Layout:
    """CA_* parameters (v1.14 and later; v1.13 with SYS_CTRL_ALLOC = 1).

    Raises InputError where the parameters hold no multirotor.
    """
    if "CA_ROTOR_COUNT" not in params:
        raise InputError(
            source, "CA_ROTOR_COUNT", "missing: PX4 v1.14 or later with a multirotor is expected"
        )
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
        x, y, z = rotor.position_m
        spin = "ccw" if rotor.km > 0 else "cw"
        connectors = " and ".join(outputs.get(n, ()))
        mounts.append(Mount(x, y, None if flat else z, spin, None, connectors, rotor.axis))
    notes = []
    if flat:
        notes.append("CA_ROTOR*_PZ are all alike: which rotor of a pair is the upper one stands nowhere")
    unassigned = [str(n) for n in range(1, len(mounts) + 1) if n not in outputs]
    if outputs and unassigned:
        notes.append(f"no output is assigned to rotor {', '.join(unassigned)}")
    return Layout(source, tuple(mounts), metres=True, notes=tuple(notes))


def ardupilot_layout(
    params: Params, source: str, script: Callable[[], bytes | None] = lambda: None
) -> Layout:
    """FRAME_CLASS, FRAME_TYPE or a script's table: directions and spin, no lengths.

    Raises InputError where the frame is not a coaxial one known here.
    """
    if "FRAME_CLASS" not in params:
        raise InputError(source, "FRAME_CLASS", "missing: ArduCopter 3.5 or later is expected")
    frame, kind = int(params["FRAME_CLASS"]), int(params.get("FRAME_TYPE", 1))
    where = f"FRAME_CLASS {frame}, FRAME_TYPE {kind}"
    if frame in (SCRIPTING_MATRIX, DYNAMIC_MATRIX):
        layout = _scripted(params, source, frame, script)
    elif (frame, kind) in FRAMES:
        layout = _frame_layout(FRAMES[frame, kind], f"{source}: {where}")
    else:
        raise InputError(source, where, "no coaxial frame known here; start from a template")
    outputs = _servo_outputs(params)
    mounts = tuple(
        replace(mount, output=" and ".join(outputs.get(n, ())))
        for n, mount in enumerate(layout.mounts, start=1)
    )
    notes = list(layout.notes)
    if any(p.level is None for p in mounts):
        notes.append("which rotor of a pair is the upper one stands nowhere on this board")
    return replace(layout, mounts=mounts, notes=tuple(notes))


def _frame_layout(motors: tuple[Motor, ...], source: str) -> Layout:
    """The layout of one of ArduCopter's own frames."""
    mounts = []
    for motor in motors:
        angle = math.radians(motor.angle_deg)
        x, y = (0.0 if abs(share) < 1e-12 else share for share in (math.cos(angle), math.sin(angle)))
        mounts.append(Mount(x, y, None, "ccw" if motor.yaw > 0 else "cw", motor.layer or None))
    return Layout(source, tuple(mounts), metres=False)


def _scripted(params: Params, source: str, frame: int, script: Callable[[], bytes | None]) -> Layout:
    """From our own scripts' factors. Each axis may be scaled apart from the others (class 15), so an arm's
    angle is only as good as the vehicle's symmetry."""
    try:
        if frame == DYNAMIC_MATRIX:
            factors: tuple[Factors, ...] = scripts.params_factors(params)
        else:
            data = script()
            if data is None:
                raise TableError(f"the layout stands in {scripts.MATRIX_NAME}, which is not here")
            factors = scripts.script_factors(data.decode("utf-8", "replace"))
    except TableError as error:
        raise InputError(source, f"FRAME_CLASS {frame}", f"{error}; start from a template") from error
    top = [max(abs(f[axis]) for f in factors) or 1.0 for axis in range(2)]
    mounts = []
    for n, (roll, pitch, yaw, _) in enumerate(factors, start=1):
        if yaw == 0.0:
            raise InputError(source, f"rotor {n}", "no yaw factor: which way it turns is not known")
        x, y = pitch / top[1], -roll / top[0]
        length = math.hypot(x, y) or 1.0
        mounts.append(Mount(x / length, y / length, None, "ccw" if yaw > 0 else "cw"))
    note = "arm angles from the script's factors, whose axes are scaled apart: hold them against the vehicle"
    return Layout(f"{source}: FRAME_CLASS {frame}, the table of its script", tuple(mounts), False, (note,))


def _px4_outputs(params: Params) -> dict[int, list[str]]:
    """Motor number -> connectors."""
    found: dict[int, list[str]] = {}
    for name, value in params.items():
        match = _PX4_OUTPUT.fullmatch(name)
        if match and value >= _PX4_MOTOR_1:
            connector = f"{match[1] or match[3]} {match[2] or match[4]}"
            found.setdefault(int(value) - _PX4_MOTOR_1 + 1, []).append(connector)
    return found


def _servo_outputs(params: Params) -> dict[int, list[str]]:
    """Motor number -> connectors."""
    found: dict[int, list[str]] = {}
    motors = {servo_function(n): n for n in range(1, 13)}
    for output in range(1, _SERVO_OUTPUTS + 1):
        motor = motors.get(int(params.get(f"SERVO{output}_FUNCTION", 0)))
        if motor:
            found.setdefault(motor, []).append(f"SERVO {output}")
    return found
