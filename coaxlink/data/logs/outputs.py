"""Which output of an autopilot drives which motor, and between which numbers it runs: one map for all logs
and all columns, made of the log's own parameters.

Motors, outputs and channels of a driver are counted from 1. Sources: ArduPilot `SRV_Channel.h` (functions),
`AP_MotorsMulticopter.cpp` (MOT_PWM_*), PX4 `output_functions.yaml` and the `module.yaml` of each driver.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.samples import OUTPUTS_AS_MOTORS, RANGE
from firmware_params.ardupilot.parameters import SURFACES
from firmware_params.ardupilot.parameters import motor_range as ardupilot_range

Array = NDArray[np.float64]
Values = Mapping[int, Array]  # (n,) of each channel, as it was logged
Parameters = Mapping[str, float]
# of SERVOn_FUNCTION: the first function of a run, its first motor, how many
ARDUPILOT_MOTORS = ((33, 1, 8), (82, 9, 4), (160, 13, 20))
ARDUPILOT_OUTPUTS, ARDUPILOT_DIGITAL, ARDUPILOT_SCALED = 32, (4, 5, 6, 7), 8  # MOT_PWM_TYPE
SECOND_PROCESSOR = 8  # before 4.5 ArduPilot counts ESCs from the first output that is not the IO processor's
PX4_MOTOR_1, PX4_MOTORS = 101, 12
PULSE_US, DSHOT, CAN = (1000.0, 2000.0), (0.0, 1999.0), (0.0, 8191.0)
LEAST_PULSE_US, MOST_PULSE_US = 800.0, 2500.0  # what any servo output can give
ASSUMED = "1000 to 2000 us, assumed: the board's own are not known"
OVER = 1.05  # of the range: an output that gives more runs between other numbers


@dataclass(frozen=True)
class MotorOutput:
    """An output that drives a motor."""

    motor: int
    channel: int  # of its driver
    low: float  # what the log holds at command 0, and at 1
    high: float
    driver: str = ""

    def most(self, values: Values) -> float:
        """The greatest of its values over the top of its range."""
        given = values.get(self.channel)
        return 0.0 if given is None else float(np.nanmax(given, initial=0.0)) / self.high

    def command(self, values: Values) -> Array:
        """(n,) 0..1."""
        return np.clip((values[self.channel] - self.low) / (self.high - self.low), 0.0, 1.0)


Map = tuple[MotorOutput, ...]  # one driver's, by motor; () where the log does not say


def ardupilot_map(parameters: Parameters) -> Map:
    """By SERVOn_FUNCTION; () before 2016, where motors are the first outputs."""
    found = {}
    for channel in range(1, ARDUPILOT_OUTPUTS + 1):
        function = parameters.get(f"SERVO{channel}_FUNCTION", 0)
        for first, motor, count in ARDUPILOT_MOTORS:
            if first <= function < first + count:
                number = int(function) - first + motor
                found[number] = MotorOutput(number, channel, *_ardupilot_range(parameters, channel), "SERVO")
    return tuple(found[motor] for motor in sorted(found))


def _ardupilot_range(parameters: Parameters, channel: int) -> tuple[float, float]:
    kind = parameters.get("MOT_PWM_TYPE", 0)
    if kind in ARDUPILOT_DIGITAL:  # logged as pulses all the same
        return PULSE_US
    if kind == ARDUPILOT_SCALED:
        names = (f"SERVO{channel}_MIN", f"SERVO{channel}_MAX")
        return _range([parameters.get(n) or usual for n, usual in zip(names, PULSE_US, strict=True)])
    return ardupilot_range(parameters) or PULSE_US


def tell_range(parameters: Parameters, notes: list[str], premises: list[str]) -> None:
    """Say whence the pulses are between which an ArduPilot's motors run, where MOT_PWM_* do not hold them."""
    if parameters.get("MOT_PWM_TYPE", 0) in (*ARDUPILOT_DIGITAL, ARDUPILOT_SCALED):
        return
    found = ardupilot_range(parameters)
    if found is None:
        premises += [RANGE] * bool(parameters)
    elif not (parameters.get("MOT_PWM_MIN") and parameters.get("MOT_PWM_MAX")):
        low, high = found
        span = f"{low:g} to {high:g} us"
        notes.append(f"MOT_PWM_MIN or _MAX is 0 or not there: motors run as the radio's throttle, {span}")


def motorless(parameters: Parameters) -> str:
    """What an ArduPilot's outputs drive where none drives a motor; "" where one does, or nobody says.

    >>> motorless({"SERVO1_FUNCTION": 4.0, "SERVO3_FUNCTION": 70.0})
    'SERVO1_FUNCTION 4 (aileron), SERVO3_FUNCTION 70 (throttle)'
    """
    reported = {
        n: f for n in range(1, ARDUPILOT_OUTPUTS + 1) if (f := int(parameters.get(f"SERVO{n}_FUNCTION", 0)))
    }
    if not reported or ardupilot_map(parameters):
        return ""
    named = [f"SERVO{n}_FUNCTION {f}{f' ({SURFACES[f]})' * (f in SURFACES)}" for n, f in reported.items()]
    return ", ".join(named[:4])


def px4_maps(parameters: Parameters) -> list[Map]:
    """Of each driver that drives motors, by its *_FUNCn; [] before 1.13, which has none."""
    found: dict[str, dict[int, MotorOutput]] = {}
    for name, value in parameters.items():
        match = re.fullmatch(r"(\w+)_FUNC(\d+)", name)
        if match and PX4_MOTOR_1 <= value < PX4_MOTOR_1 + PX4_MOTORS:
            motor, channel = int(value) - PX4_MOTOR_1 + 1, int(match[2])
            run = _px4_range(parameters, match[1], channel)
            found.setdefault(match[1], {})[motor] = MotorOutput(motor, channel, *run, match[1])
    return [tuple(outputs[motor] for motor in sorted(outputs)) for outputs in found.values()]


def _px4_range(parameters: Parameters, driver: str, channel: int) -> tuple[float, float]:
    timers = [v for name, v in parameters.items() if re.fullmatch(rf"{driver}_TIM\d+", name)]
    if (timers and max(timers) < -1) or parameters.get("DSHOT_CONFIG", 0) > 0:  # -1 is OneShot: pulses
        least = parameters.get("DSHOT_MIN", 0.0)
        return DSHOT[1] * (least if 0 <= least < 1 else 0.0), DSHOT[1]
    usual = CAN if driver.startswith("UAVCAN") else (0.0, 1000.0) if driver == "SIM_GZ_EC" else PULSE_US
    ends = []
    for end, default in zip(("MIN", "MAX"), usual, strict=True):
        # until 1.12 one for all of a driver's channels, unless its own is above 0
        names = (f"{driver}_{end}{channel}", f"{driver}_{end}", *([f"PWM_{end}"] * (usual is PULSE_US)))
        ends.append(next((v for n in names if (v := parameters.get(n, -1)) > 0), default))
    return _range(ends)


def _range(ends: Sequence[float]) -> tuple[float, float]:
    """Low and high; those of any pulse where a damaged log has them the other way round."""
    return (float(ends[0]), float(ends[1])) if ends[0] < ends[1] else PULSE_US


def motor_map(parameters: Parameters, motors: int) -> tuple[Map, str]:
    """Motors 1..N on the outputs of one driver, as a board's parameters say, for who hears a link; and what
    had to be taken for granted of them, in words.

    >>> motor_map({"PWM_MAIN_FUNC3": 101, "PWM_MAIN_MIN3": 1100, "PWM_MAIN_MAX3": 1900}, 1)
    ((MotorOutput(motor=1, channel=3, low=1100.0, high=1900.0, driver='PWM_MAIN'),), '')
    >>> motor_map({}, 1)[1]
    "motor n is on output n, 1000 to 2000 us, assumed: the board's own are not known"
    """
    every = range(1, motors + 1)
    if any(name.startswith(("SERVO", "MOT_")) for name in parameters):
        determined = parameters.get("MOT_PWM_TYPE", 0) in (*ARDUPILOT_DIGITAL, ARDUPILOT_SCALED)
        taken = "" if determined or ardupilot_range(parameters) else f"motors run from {ASSUMED}"
        by_number = tuple(MotorOutput(n, n, *_ardupilot_range(parameters, n), "SERVO") for n in every)
        return ardupilot_map(parameters) or by_number, taken
    maps = [own for own in px4_maps(parameters) if {o.motor for o in own} >= set(every)]
    if len(maps) == 1:
        return maps[0], ""
    return tuple(MotorOutput(n, n, *PULSE_US) for n in every), f"motor n is on output n, {ASSUMED}"


def px4_outputs(instances: Sequence[Values], parameters: Parameters) -> tuple[list[tuple[Map, int]], bool]:
    """Drivers' maps and which logged instance is whose; and whether that is from the log's parameters.

    The instances of `actuator_outputs` are numbered as drivers start, and may be empty: a driver's is that
    in which most of its motors ran, all within its range. Before 1.13 the one with most running outputs is.
    """
    maps = px4_maps(parameters)
    if maps:
        found: list[tuple[Map, int]] = []
        for outputs in maps:
            free = [i for i in range(len(instances)) if i not in [taken for _, taken in found]]
            own = max(free, key=lambda i: _running(outputs, instances[i]), default=None)
            if own is not None and _running(outputs, instances[own]) > 0:
                found.append((outputs, own))
        return found, True
    taken = [as_motors(values, parameters, "PWM_MAIN") for values in instances]
    best = max(range(len(taken)), key=lambda i: len(taken[i]), default=0)
    return ([(taken[best], best)] if taken and taken[best] else []), False


def _running(outputs: Map, values: Values) -> int:
    """How many of a driver's outputs ran, if these are its values; -1 where they cannot be."""
    most = [o.most(values) for o in outputs]
    return -1 if max(most) > OVER else sum(m > o.low / o.high for m, o in zip(most, outputs, strict=True))


def as_motors(values: Values, parameters: Parameters, driver: str) -> Map:
    """Output n taken for motor n, where the log has no functions: a premise (OUTPUTS_AS_MOTORS).

    Numbers that no pulse has are CAN's; others are what the parameters say, or pulses.
    """
    most = max((float(np.nanmax(v, initial=0.0)) for v in values.values()), default=0.0)
    found = []
    for channel, given in values.items():
        if most > MOST_PULSE_US:
            low, high = CAN
        elif driver == "SERVO":
            low, high = _ardupilot_range(parameters, channel)
        else:
            low, high = _px4_range(parameters, driver, channel)
        least = LEAST_PULSE_US if high <= MOST_PULSE_US and low >= LEAST_PULSE_US else 1.0
        if (given >= least).any():
            found.append(MotorOutput(channel, channel, low, high, driver))
    return tuple(found)


def commands(outputs: Map, values: Values, where: str, notes: list[str]) -> dict[str, Array]:
    """motor1..N (n,), 0..1, of a driver's outputs that were logged."""
    logged = [o for o in outputs if o.channel in values]
    if not logged:
        return {}
    ranges = sorted({f"({o.low:g} to {o.high:g})" for o in logged})
    pairs = ", ".join(f"{o.channel}" for o in logged)
    names = ", ".join(f"{o.motor}" for o in logged)
    notes.append(f"motors {names} from outputs {pairs} {' and '.join(ranges)} of {where}")
    return {f"motor{o.motor}": o.command(values) for o in sorted(logged, key=lambda o: o.motor)}


def motors_of_escs(
    outputs: Map, escs: Iterable[int], notes: list[str], premises: list[str]
) -> dict[int, int]:
    """{ESC, counted from 0: motor}: an ESC bears the number of its output. Without a map, the motor's."""
    numbers = sorted(set(escs))
    if not outputs:
        if numbers:
            premises.append(OUTPUTS_AS_MOTORS)
        return {esc: esc + 1 for esc in numbers}
    motor = {o.channel: o.motor for o in outputs}
    direct, shifted = (
        {esc: motor[esc + 1 + offset] for esc in numbers if esc + 1 + offset in motor}
        for offset in (0, SECOND_PROCESSOR)
    )
    if len(direct) == len(shifted) and numbers:
        notes.append("rpm left out: the ESCs' numbers fit no motor's output")
        return {}
    found = max(direct, shifted, key=len)
    strange = [str(esc) for esc in numbers if esc not in found]
    if strange:
        notes.append(f"rpm of ESC {', '.join(strange)} left out: no motor on that output")
    return found
