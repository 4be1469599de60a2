"""ArduCopter's table parameters: type and range of each, as its own metadata states them.

Every value travels as a float; the board keeps int8 and int16 parameters truncated (3.7 becomes 3, 300 in an
int8 becomes 127).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

import numpy as np

from firmware_params import parameters
from firmware_params.errors import Finding
from firmware_params.parameters import FLOAT, INT8, INT16, INT32, BoardParameter

_LIMITS = {INT8: (-128, 127), INT16: (-32768, 32767), INT32: (-(2**31), 2**31 - 1)}

PARAMETERS = parameters.by_name(
    [
        BoardParameter("FRAME_CLASS", INT8, 0, 17),
        BoardParameter("FRAME_TYPE", INT8, 0, 21),
        BoardParameter("MOT_PWM_MAX", INT16, 0, 2000),
        BoardParameter("MOT_PWM_MIN", INT16, 0, 2000),
        BoardParameter("MOT_SPIN_ARM", FLOAT, 0, 0.3),
        BoardParameter("MOT_SPIN_MAX", FLOAT, 0.9, 1.0),
        BoardParameter("MOT_SPIN_MIN", FLOAT, 0, 0.3),
        BoardParameter("MOT_THST_EXPO", FLOAT, -1, 1),
        BoardParameter("MOT_THST_HOVER", FLOAT, 0.125, 0.6875),
        BoardParameter("MOT_YAW_HEADROOM", INT16, 0, 500),
        BoardParameter("SCR_ENABLE", INT8, 0, 2),
        BoardParameter("SCR_LD_CHECKSUM", INT32, -1, 0x7FFFFF),
        BoardParameter("SCR_VM_I_COUNT", INT32, 1000, 1_000_000),
        *(BoardParameter(f"SERVO{n}_FUNCTION", INT16, -1, 200) for n in range(1, 33)),
    ]
)


def as_stored(name: str, value: float, kind: int | None = None) -> float:
    """The value the board keeps: integers truncated towards zero and clipped, else the nearest float32."""
    known = PARAMETERS.get(name)
    kind = kind if kind is not None else known.type if known else FLOAT
    if kind not in _LIMITS or not math.isfinite(value):
        return float(np.float32(value))
    low, high = _LIMITS[kind]
    return float(min(max(math.trunc(value), low), high))


def out_of_range(params: Mapping[str, float]) -> list[Finding]:
    """Findings for values that are not finite, out of ArduPilot's documented range, or to be truncated."""
    found = parameters.out_of_range(params, PARAMETERS, "ap", "ArduPilot")
    wrong = {finding.text.split()[0] for finding in found}
    for name, value in params.items():
        known = PARAMETERS.get(name)
        if known and known.type != FLOAT and name not in wrong and value != int(value):
            found.append(
                Finding("ap.truncated", "error", f"{name} = {value:g} would be kept as {int(value)}")
            )
    return found


SURFACES = {  # SERVOn_FUNCTION of what is no motor of a multirotor (SRV_Channel.h)
    2: "flap", 3: "flap", 4: "aileron", 16: "differential spoiler", 17: "differential spoiler",
    19: "elevator", 21: "rudder", 24: "flaperon", 25: "flaperon", 26: "ground steering",
    31: "helicopter rotor speed", 41: "tilt", 70: "throttle", 73: "left throttle", 74: "right throttle",
    75: "tilt", 76: "tilt", 77: "elevon", 78: "elevon", 79: "V-tail", 80: "V-tail",
    86: "differential spoiler", 87: "differential spoiler",
}  # fmt: skip

# names that ArduCopter has not and another of ArduPilot's firmwares has (Parameters.cpp of each, 4.5): their
# FRAME_CLASS has other meanings, or stands nowhere
_OTHERS = {
    "a rover or boat": r"CRUISE_(SPEED|THROTTLE)|PILOT_STEER_TYPE|MODE(_CH|[1-6])|ATC_(STR|SPEED)_.*",
    "a submarine": r"FRAME_CONFIG|SURFACE_DEPTH|JS_(GAIN|LIGHTS|THR)_.*|BTN\d+_.*|FS_LEAK_ENABLE",
    "a blimp": r"FINS_.*|(VEL|POS)(XY|YAW)_.*",
    "an antenna tracker": r"SERVO_(PITCH|YAW)_TYPE",
    "a plane": r"(RLL|PTCH)2SRV_.*|LIM_ROLL_CD|ROLL_LIMIT_DEG|TRIM_ARSPD_CM|AIRSPEED_(MIN|MAX|CRUISE)",
}


def other_vehicle(params: Mapping[str, float]) -> str:
    """Whose parameters these are, where ArduCopter's are not, and a name that tells; "" where none does.

    A quadplane with its lift motors on is a plane that hovers, and no other.

    >>> other_vehicle({"FRAME_CLASS": 1, "CRUISE_THROTTLE": 50, "MODE_CH": 8})
    'a rover or boat (CRUISE_THROTTLE, MODE_CH)'
    """
    hovers = bool(params.get("Q_ENABLE", "Q_FRAME_CLASS" in params))
    for kind, marks in _OTHERS.items():
        found = [name for name in params if re.fullmatch(marks, name)]
        if found and not hovers:
            return f"{kind} ({', '.join(found[:2])})"
    return ""


def motor_range(params: Mapping[str, float]) -> tuple[float, float] | None:
    """Pulses (us) of a motor at nothing and at full command; None where the parameters do not say.

    MOT_PWM_MIN and MOT_PWM_MAX; where they are 0, as until 4.2 they were by default, or not there, as before
    3.4, those of the throttle's channel (AP_MotorsMulticopter::get_pwm_output_min).

    >>> motor_range({"MOT_PWM_MIN": 0, "MOT_PWM_MAX": 0, "RC3_MIN": 1100, "RC3_MAX": 1900})
    (1100.0, 1900.0)
    """
    channel = int(params.get("RCMAP_THROTTLE", 3))
    ends = [
        params.get(f"MOT_PWM_{end}") or params.get(f"RC{channel}_{end}") or math.nan for end in ("MIN", "MAX")
    ]
    return (float(ends[0]), float(ends[1])) if 0.0 < ends[0] < ends[1] < 1e4 else None


def servo_function(motor: int) -> int:
    """SERVOn_FUNCTION of a motor, counted from 1: 33..40, then 82..85, then 160..179 (SRV_Channel.h)."""
    return 32 + motor if motor <= 8 else 73 + motor if motor <= 12 else 147 + motor


MOTOR_FUNCTIONS = {servo_function(motor): motor for motor in range(1, 33)}
