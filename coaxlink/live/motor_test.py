"""The bench check before live mixing: turn one motor after another, propellers off, and ask what turned.

MAV_CMD_ACTUATOR_TEST (310; PX4 from 1.13) where the autopilot knows it, else MAV_CMD_DO_MOTOR_TEST (209; PX4
up to 1.13, ArduPilot, whose parameter 1 is the place in its test order). The autopilot itself refuses either
in the air and stops the motor after the time given.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.airframe import Airframe, Rotor
from coaxlink.errors import SafetyRefusal
from coaxlink.mavlink.parameters import Parameters
from firmware_params.ardupilot import motor_test_sequence
from firmware_params.errors import TableError

if TYPE_CHECKING:
    from coaxlink.mavlink.session import Session

THROTTLE = 0.10
SECONDS = 1.5


@dataclass(frozen=True)
class MotorAnswer:
    """What was seen when motor `number` was told to turn."""

    number: int
    mount: str
    right: bool

    def to_json(self) -> dict[str, Any]:
        """As `coaxlink mix --props-off --json` writes it."""
        return {"motor": self.number, "expected": self.mount, "right": self.right}


def mount(rotor: Rotor) -> str:
    """Where a rotor is and which way it turns, in words."""
    x, y, _ = rotor.position_m
    words = [
        "front" if x > 0.02 else "rear" if x < -0.02 else "",
        "right" if y > 0.02 else "left" if y < -0.02 else "",
    ]
    spin = "counter-clockwise" if rotor.yaw_sign > 0 else "clockwise"
    where = " ".join(w for w in words if w) or "centre"
    return f"{where}, {rotor.level}, {spin} from above"


def turn_motors(
    session: Session, airframe: Airframe, ask: Callable[[int, str], bool], throttle: float = THROTTLE
) -> tuple[MotorAnswer, ...]:
    """Turn every motor in the airframe's order; `ask(number, place)` says whether that one turned that way.

    Raises SafetyRefusal when the vehicle is armed (asked again before every motor) or will not turn one.
    """
    answers = []
    numbers_ = _test_numbers(session, airframe)
    for rotor in airframe.rotors:
        if session.armed:
            raise SafetyRefusal("the vehicle is armed: motors are tested disarmed, propellers off")
        _turn(session, rotor.number, numbers_[rotor.number], throttle)
        where = mount(rotor)
        answers.append(MotorAnswer(rotor.number, where, ask(rotor.number, where)))
    return tuple(answers)


def _test_numbers(session: Session, airframe: Airframe) -> dict[int, int]:
    """Parameter 1 of DO_MOTOR_TEST for each motor: its number on PX4, its place in ArduPilot's test order."""
    numbers = [r.number for r in airframe.rotors]
    if session.identity.is_px4:
        return {n: n for n in numbers}
    read = Parameters(session).read_many(["FRAME_CLASS", "FRAME_TYPE"])
    try:
        numbers_ = motor_test_sequence(int(read["FRAME_CLASS"].value), int(read["FRAME_TYPE"].value))
    except TableError as e:
        raise SafetyRefusal(f"{e}: in which order this frame tests its motors cannot be told") from None
    if max(numbers) > len(numbers_):
        raise SafetyRefusal(
            f"the frame on board has {len(numbers_)} rotors, the airframe file {len(numbers)}"
        )
    return {n: numbers_[n - 1] for n in numbers}


def _turn(session: Session, number: int, test_number: int, throttle: float) -> None:
    unsupported = mavlink.MAV_RESULT_UNSUPPORTED
    result = unsupported
    if session.identity.is_px4:
        result = session.command(mavlink.MAV_CMD_ACTUATOR_TEST, throttle, SECONDS, 0, 0, number)
    if result == unsupported:
        result = session.command(mavlink.MAV_CMD_DO_MOTOR_TEST, test_number, 0, 100.0 * throttle, SECONDS, 1)
    if result != mavlink.MAV_RESULT_ACCEPTED:
        known = mavlink.enums["MAV_RESULT"].get(result)
        raise SafetyRefusal(f"rotor {number}: the autopilot answered {known.name if known else result}")
