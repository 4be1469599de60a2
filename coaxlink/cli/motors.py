"""`coaxlink motors`: one motor after another on the bench, which turned and which way, and what to change."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Container
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coaxlink.cli.shared.line import address_of, vehicle_at
from coaxlink.cli.shared.shell import JsonOption, say
from coaxlink.cli.upload import SigningOption, SystemOption, TimeoutOption, VehicleConnectOption
from coaxlink.errors import CheckFailed, InputError, SafetyRefusal

if TYPE_CHECKING:
    from coaxlink.airframe import Airframe
    from coaxlink.live.motor_test import Mending, Seen
    from coaxlink.mavlink.parameters import Number

_OUTPUT_NAMES = r"SERVO\d+_FUNCTION|\w+_FUNC\d+|SERVO_BLH_RVMASK|MOT_PWM_TYPE"
_OFF = "they are off"


def motors(
    airframe: Annotated[Path, typer.Argument(help="Airframe file.")],
    connect: VehicleConnectOption = None,
    numbers: Annotated[
        list[int] | None, typer.Argument(metavar="[NUMBER]...", help="Rotors to turn; all of them if none.")
    ] = None,
    throttle: Annotated[float, typer.Option(metavar="%", min=1, max=30, help="How hard they turn.")] = 10.0,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the parameters to change (.param, .params).")
    ] = None,
    json_file: JsonOption = None,
    timeout: TimeoutOption = 10.0,
    system: SystemOption = None,
    signing_key: SigningOption = None,
) -> None:
    """Turn one motor after another, propellers off; ask which rotor turned and which way; say what to change.

    The autopilot turns each for 1.5 s and only while disarmed. Nothing is written to it.
    """
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.live.motor_test import mending, turn_motors
    from coaxlink.mavlink.confirm import alone
    from coaxlink.mavlink.parameters import Parameters

    for output in (out, json_file):
        files.refuse_unwritable(output)
    frame = load_airframe(airframe)
    connect = address_of(connect, airframe)
    with vehicle_at(
        connect, timeout_s=timeout, system=system, signing_key=signing_key, station=True
    ) as session:
        alone(session)
        if _answer(f"Are all propellers off? Type: {_OFF}: ") != _OFF:
            raise SafetyRefusal("motors are tested with the propellers off")
        ask = _asker(frame)
        answers = turn_motors(session, frame, ask, tuple(numbers or ()), throttle / 100.0)
        params: dict[str, Number] = {}
        if not all(answer.right for answer in answers):
            params = {n: v.value for n, v in Parameters(session).read_all().values.items()}
        px4 = session.identity.is_px4
    change = mending(answers, {n: v for n, v in params.items() if re.fullmatch(_OUTPUT_NAMES, n)}, px4=px4)
    for a in answers:
        turned = ", ".join(map(str, a.seen.rotors)) or "none"
        way = f" {a.seen.spin}" if a.seen.spin else ""
        found = "right" if a.right else f"WRONG, turned: {turned}{way}"
        sys.stdout.write(f"rotor {a.number}: {a.mount}: {found}\n")
    for name, (old, new) in change.params.items():
        sys.stdout.write(f"change {name}: {old:g} -> {new:g}\n")
    for words in change.words:
        sys.stdout.write(f"{words}\n")
    if json_file:
        rows = [{"name": n, "old": old, "new": new} for n, (old, new) in change.params.items()]
        made = {"motors": [a.to_json() for a in answers], "changes": rows, "words": list(change.words)}
        files.write_json(json_file, made)
    if out and change.params:
        _write(out, change, px4=px4)
    wrong = [str(a.number) for a in answers if not a.right]
    if wrong:
        raise CheckFailed(f"rotor {', '.join(wrong)}: not where, or not turning as, the airframe file says")


def _asker(frame: Airframe) -> Callable[[int, str], Seen]:
    """The questions at one motor: which rotor, and which way."""
    from coaxlink.live.motor_test import SPINS, Seen

    rotors = {rotor.number: rotor for rotor in frame.rotors}

    def ask(number: int, where: str) -> Seen:
        seen = None
        while seen is None:
            reported = _answer(f"rotor {number} ({where}): which rotor turned? [{number}, 0 for none] ")
            seen = _numbers(reported or str(number), rotors)
        if not seen:
            return Seen(())
        wanted = SPINS[rotors[seen[0]].yaw_sign]
        turn = "counter-clockwise" if wanted == "ccw" else "clockwise"
        reported = _answer(f"did rotor {seen[0]} turn {turn}, seen from above? [Y/n] ")
        other = "cw" if wanted == "ccw" else "ccw"
        return Seen(seen, other if reported.lower().startswith("n") else wanted)

    return ask


def _numbers(reported: str, rotors: Container[int]) -> tuple[int, ...] | None:
    """Numbers of rotors in an answer, () for none, None where it is no answer."""
    parts = reported.replace(",", " ").split()
    if not all(part.isdecimal() and (int(part) in rotors or not int(part)) for part in parts):
        say(f"numbers of rotors are expected, found '{reported}'")
        return None
    return tuple(int(part) for part in parts if int(part))


def _answer(question: str) -> str:
    """One line from the keyboard; the question is talk. Raises InputError at the end of it."""
    sys.stderr.write(question)
    sys.stderr.flush()
    line = sys.stdin.readline()
    if not line:
        raise InputError("motors", "", "an answer is expected at the keyboard, found the end of input")
    return line.strip()


def _write(out: Path, change: Mending, *, px4: bool) -> None:
    """The parameters to change, as this firmware's ground stations load them."""
    from firmware_params import ardupilot
    from firmware_params import px4 as px4_params

    values = {name: new for name, (_, new) in change.params.items()}
    header = ["coaxlink motors: outputs as they were seen to turn; load them, then turn the motors again"]
    if px4:
        px4_params.write_params_file(out, {n: int(v) for n, v in values.items()}, header=header)
    else:
        ardupilot.write_param_file(out, {n: float(v) for n, v in values.items()}, header)
    say(f"wrote {out}: load it with the ground station, then turn the motors again")
