"""The bench check, propellers off: turn one motor after another, ask what turned, say what to change.

MAV_CMD_ACTUATOR_TEST (310; PX4 from 1.13) where the autopilot knows it, else MAV_CMD_DO_MOTOR_TEST (209; PX4
up to 1.13, ArduPilot, whose parameter 1 is the place in its test order). The autopilot itself refuses either
in the air and stops the motor after the time given.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.airframe import Airframe, Rotor
from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.mavlink.ftp import Files
from coaxlink.mavlink.parameters import Number, Parameters
from coaxlink.uploading.ardupilot_scripts import matrix_script
from firmware_params.ardupilot import motor_test_sequence, servo_function
from firmware_params.ardupilot.owners_script import own_matrix
from firmware_params.ardupilot.scripts import PREFIX
from firmware_params.ardupilot.table import DYNAMIC_MATRIX, SCRIPTING_MATRIX
from firmware_params.errors import TableError
from firmware_params.px4.parameters import MOTOR_1

if TYPE_CHECKING:
    from coaxlink.mavlink.session import Session

THROTTLE = 0.10  # of full command, props off
SECONDS = 1.5  # of one motor
SPINS = {1: "ccw", -1: "cw"}
_OUTPUT = re.compile(r"SERVO\d+_FUNCTION|\w+_FUNC\d+")  # of any driver
_DSHOT = range(4, 8)  # of MOT_PWM_TYPE: DShot150 to DShot1200, whose ESCs SERVO_BLH_RVMASK turns round


@dataclass(frozen=True)
class Seen:
    """What was seen at one command."""

    rotors: tuple[int, ...]  # their numbers; empty: none turned
    spin: str = ""  # "ccw" or "cw" from above, of the first of them; "": not looked at


@dataclass(frozen=True)
class MotorAnswer:
    """What was commanded to turn, and what did."""

    number: int
    mount: str
    expected: tuple[int, ...]
    seen: Seen
    spin: str  # that the first rotor seen should have

    @property
    def right(self) -> bool:
        """Whether all of it is as the airframe file says."""
        return set(self.seen.rotors) == set(self.expected) and self.seen.spin in ("", self.spin)

    def to_json(self) -> dict[str, Any]:
        """As `coaxlink motors --json` writes it."""
        return {
            "motor": self.number,
            "expected": self.mount,
            "right": self.right,
            "turned": list(self.seen.rotors),
            "spin": self.seen.spin or None,
        }


@dataclass(frozen=True)
class Mending:
    """What makes the vehicle turn as the airframe file says."""

    params: Mapping[str, tuple[Number, Number]]  # name: (on board, to be)
    words: tuple[str, ...]  # what no parameter does


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
    session: Session,
    airframe: Airframe,
    ask: Callable[[int, str], Seen],
    numbers: Sequence[int] = (),
    throttle: float = THROTTLE,
) -> tuple[MotorAnswer, ...]:
    """Turn the motors of these rotors (all if none is named); `ask(number, place)` says what turned.

    Raises SafetyRefusal when the vehicle is armed (asked again before every motor) or will not turn one,
    InputError for a number that is none.
    """
    rotors = {rotor.number: rotor for rotor in airframe.rotors}
    if wrong := [n for n in numbers if n not in rotors]:
        raise InputError("rotor", str(wrong[0]), f"numbers from 1 to {len(rotors)} are expected")
    answers = []
    places, groups = _test_places(session, airframe)
    for number in numbers or [n for n in rotors if n in groups]:
        motor = next(m for m, group in groups.items() if number in group)
        if session.armed:
            raise SafetyRefusal("the vehicle is armed: motors are tested disarmed, propellers off")
        _turn(session, motor, places[motor], throttle)
        where = mount(rotors[motor])
        seen = ask(motor, where)
        first = rotors.get(seen.rotors[0]) if seen.rotors else None
        answers.append(MotorAnswer(motor, where, groups[motor], seen, SPINS[first.yaw_sign] if first else ""))
    return tuple(answers)


def mending(answers: Sequence[MotorAnswer], params: Mapping[str, Number], *, px4: bool) -> Mending:
    """What to change so that every motor turns its own rotor, its own way; nothing is written.

    An output whose ESC turned rotor m gets the function of motor m. `params` are the board's.
    """
    function = (lambda motor: MOTOR_1 + motor - 1) if px4 else servo_function
    outputs = {n: v for n, v in params.items() if _OUTPUT.fullmatch(n)}
    changes: dict[str, tuple[Number, Number]] = {}
    words: list[str] = []
    drives: dict[int, list[str]] = {}  # rotor: the outputs that its ESC is on
    single = {a.number: a.seen.rotors[0] for a in answers if len(a.seen.rotors) == len(a.expected) == 1}
    for answer in answers:
        own = [name for name, held in outputs.items() if held == function(answer.number)]
        shown = ", ".join(own) or "its output"
        if not answer.seen.rotors:
            words.append(
                f"rotor {answer.number}: nothing turned; look at the ESC on {shown}, its power and its signal"
            )
        elif answer.number not in single:
            if set(answer.seen.rotors) != set(answer.expected):
                both = ", ".join(map(str, answer.seen.rotors))
                words.append(
                    f"rotor {answer.number}: {both} turned; one function on several outputs: {shown}"
                )
        else:
            drives[single[answer.number]] = own
    moved = {n: m for n, m in single.items() if n != m}
    twice = sorted({m for m in single.values() if list(single.values()).count(m) > 1})
    if twice:
        named = ", ".join(map(str, twice))
        words.append(f"rotor {named} was seen for two motors: turn those again; no output is changed")
    elif set(moved) != set(moved.values()):
        unknown = sorted(set(moved.values()) - set(moved))
        named = ", ".join(map(str, unknown))
        words.append(f"turn rotor {named} too: what drives it is not known yet, so no output is changed")
    else:
        for motor, rotor in moved.items():
            own = [name for name, held in outputs.items() if held == function(motor)]
            changes |= {name: (outputs[name], function(rotor)) for name in own}
            if not own:
                words.append(f"plug the ESC that motor {motor} drives now where motor {rotor} is driven")
    reverse = [a.seen.rotors[0] for a in answers if a.seen.rotors and a.seen.spin not in ("", a.spin)]
    mask = params.get("SERVO_BLH_RVMASK")
    for rotor in reverse:
        own = drives.get(rotor, [])
        if mask is not None and int(params.get("MOT_PWM_TYPE", 0)) in _DSHOT and own:
            bits = sum(1 << int(name.removeprefix("SERVO").partition("_")[0]) - 1 for name in own)
            before, after = changes.get("SERVO_BLH_RVMASK", (mask, mask))
            changes["SERVO_BLH_RVMASK"] = (before, int(after) ^ bits)
        else:
            how = (
                "set its spin direction in QGroundControl's Actuators page (DShot)"
                if px4
                else "reverse its ESC"
            )
            words.append(f"rotor {rotor} turns the other way: swap two wires of its motor, or {how}")
    if reverse:
        words.append(
            "where the propellers are made for that way, the spin in the airframe file is wrong instead"
        )
    return Mending(changes, tuple(words))


def _test_places(session: Session, airframe: Airframe) -> tuple[dict[int, int], dict[int, tuple[int, ...]]]:
    """Parameter 1 of DO_MOTOR_TEST for each motor, and the rotors that each motor turns.

    A motor's number on PX4; its place in ArduPilot's test order.
    """
    numbers = [r.number for r in airframe.rotors]
    if session.identity.is_px4:
        return {n: n for n in numbers}, {n: (n,) for n in numbers}
    places = _order(session)
    count = len(places)
    if len(numbers) == 2 * count and _doubled(session, count):
        return dict(enumerate(places, start=1)), {n: (n, n + count) for n in range(1, count + 1)}
    if max(numbers) > len(places):
        raise SafetyRefusal(f"the frame on board has {len(places)} rotors, the airframe file {len(numbers)}")
    return {n: places[n - 1] for n in numbers}, {n: (n,) for n in numbers}


def _doubled(session: Session, count: int) -> bool:
    """Whether each of so many motor functions is on two outputs of an ArduPilot."""
    names = [f"SERVO{n}_FUNCTION" for n in range(1, 33)]
    held = [v.value for v in Parameters(session).read_many(names, missing_ok=True).values()]
    return all(held.count(servo_function(motor)) == 2 for motor in range(1, count + 1))


def _order(session: Session) -> tuple[int, ...]:
    """The place of motor 1, 2, ... in an ArduPilot's motor test. Raises SafetyRefusal where it is unknown."""
    names = ("FRAME_CLASS", "FRAME_TYPE", f"{PREFIX}N")
    read = {n: v.value for n, v in Parameters(session).read_many(names, missing_ok=True).items()}
    frame = int(read.get("FRAME_CLASS", 0))
    try:
        if frame == SCRIPTING_MATRIX or (frame == DYNAMIC_MATRIX and f"{PREFIX}N" not in read):
            script = matrix_script(Files(session))
            if script is None:
                raise TableError(f"FRAME_CLASS {frame} without a script on the card")
            return own_matrix(script.decode("utf-8", "replace"), {"FRAME_CLASS": frame}).order
        return motor_test_sequence(frame, int(read.get("FRAME_TYPE", 0)))
    except TableError as e:
        raise SafetyRefusal(f"{e}: in which order this frame tests its motors is not known") from None


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
