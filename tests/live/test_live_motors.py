"""`coaxlink motors`: which rotor turned, which way, and what is to be changed for it."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import pytest
from case_table import case_table
from live_flight import EXAMPLES, X8, Companion, Faults, Flight, LiveLine

from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run
from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.live.motor_test import MotorAnswer, Seen, mending, mount, turn_motors
from coaxlink.mavlink.opening import connect
from firmware_params.reading import read_params

AIRFRAME = str(EXAMPLES / "x8_demo.toml")
SERVOS = {f"SERVO{n}_FUNCTION": 32 + n for n in range(1, 9)}
MAINS = {f"PWM_MAIN_FUNC{n}": 100 + n for n in range(1, 5)} | {f"UAVCAN_EC_FUNC{n}": 100 + n for n in (5, 6)}
SPIN = ("ccw", "cw", "ccw", "cw", "ccw", "cw", "ccw", "cw")


def answers(turned: dict[int, int], backwards: tuple[int, ...] = ()) -> list[MotorAnswer]:
    """As an X8's are: motor n turned rotor `turned[n]`."""
    other = {"ccw": "cw", "cw": "ccw"}
    rows = []
    for n, rotor in turned.items():
        spin = SPIN[rotor - 1] if rotor else ""
        seen = Seen((rotor,), other[spin] if rotor in backwards else spin) if rotor else Seen(())
        rows.append(MotorAnswer(n, "", (n,), seen, spin))
    return rows


def test_what_is_to_be_changed() -> None:
    dshot = SERVOS | {"MOT_PWM_TYPE": 6, "SERVO_BLH_RVMASK": 1}
    everyone = {n: n for n in range(1, 9)}
    table: dict[str, tuple[Any, ...]] = {
        "all right": (answers(everyone), SERVOS, False, {}, ""),
        "two exchanged": (
            answers(everyone | {2: 5, 5: 2}), SERVOS, False,
            {"SERVO2_FUNCTION": (34, 37), "SERVO5_FUNCTION": (37, 34)}, "",
        ),
        "three in a ring": (
            answers({1: 2, 2: 3, 3: 1}), SERVOS, False,
            {"SERVO1_FUNCTION": (33, 34), "SERVO2_FUNCTION": (34, 35), "SERVO3_FUNCTION": (35, 33)}, "",
        ),
        "PX4, across drivers": (
            answers({4: 5, 5: 4}), MAINS, True,
            {"PWM_MAIN_FUNC4": (104, 105), "UAVCAN_EC_FUNC5": (105, 104)}, "",
        ),
        "one alone": (answers({2: 5}), SERVOS, False, {}, "turn rotor 5 too"),
        "two turn one": (answers({1: 2, 2: 2}), SERVOS, False, {}, "rotor 2 was seen for two motors"),
        "none": (answers({3: 0}), SERVOS, False, {}, "rotor 3: nothing turned; look at the ESC on SERVO3"),
        "the other way": (answers(everyone, (3,)), SERVOS, False, {}, "turns the other way: swap two wires"),
        "the other way, DShot": (answers(everyone, (3,)), dshot, False, {"SERVO_BLH_RVMASK": (1, 5)}, ""),
        "back again, DShot": (answers(everyone, (1,)), dshot, False, {"SERVO_BLH_RVMASK": (1, 0)}, ""),
        "exchanged and the other way, DShot": (
            answers({2: 5, 5: 2}, (2,)), dshot, False,
            {"SERVO2_FUNCTION": (34, 37), "SERVO5_FUNCTION": (37, 34), "SERVO_BLH_RVMASK": (1, 17)}, "",
        ),
        "the other way, PX4": (answers({3: 3}, (3,)), MAINS, True, {}, "QGroundControl's Actuators page"),
        "no outputs known": (answers({1: 2, 2: 1}), {}, True, {}, "plug the ESC that motor 1"),
        "two at once": (
            [MotorAnswer(1, "", (1,), Seen((1, 5), "ccw"), "ccw")], SERVOS, False, {}, "rotor 1: 1, 5 turned",
        ),
    }  # fmt: skip
    with case_table() as case:
        for name, (given, params, px4, changes, says) in table.items():
            with case(name):
                found = mending(given, params, px4=px4)
                assert found.params == changes
                assert says in " ".join(found.words) and bool(found.words) >= bool(says)


def test_a_pair_on_one_command_is_right_when_both_turn() -> None:
    both = MotorAnswer(1, "", (1, 5), Seen((5, 1), "ccw"), "ccw")
    assert both.right and not mending([both], SERVOS, px4=False).params
    assert not MotorAnswer(1, "", (1, 5), Seen((1,), "ccw"), "ccw").right


@pytest.mark.slow
def test_motors_are_turned_one_by_one_on_the_ground_and_never_when_armed() -> None:
    ground = Flight(airborne=False)
    session, frame = Companion(ground).session, X8
    assert mount(frame.rotors[0]) == "front right, upper, counter-clockwise from above"
    assert mount(frame.rotors[7]) == "rear left, lower, clockwise from above"
    turned: list[int] = []
    session.subscribe(lambda m: turned.append(m.command) if m.get_type() == "COMMAND_ACK" else None)
    found = turn_motors(session, frame, lambda number, where: Seen((4 if number == 3 else number,)))
    assert [a.number for a in found] == list(range(1, 9))
    assert [a.number for a in found if not a.right] == [3]
    assert turned.count(310) == 8
    assert [a.number for a in turn_motors(session, frame, lambda n, where: Seen((n,)), (6, 2))] == [6, 2]
    with pytest.raises(InputError, match="from 1 to 8"):
        turn_motors(session, frame, lambda number, where: Seen(()), (9,))
    ground.autopilot.arm()
    ground.fly(2.0)
    with pytest.raises(SafetyRefusal, match="armed"):
        turn_motors(session, frame, lambda number, where: Seen((number,)))


@pytest.mark.slow
def test_the_verb_asks_which_and_which_way_and_writes_what_to_change(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Any
) -> None:
    ground, line = Flight(airborne=False), Faults()

    class Beside:
        flight = ground

    beside = Beside()
    beside.line = line  # type: ignore[attr-defined]

    def opened(url: str, **options: Any) -> Any:
        here = LiveLine(ground.net, ground.addresses[0])
        ground.companions[here.address] = beside
        return connect(url, transport=here, clock=ground.clock, **options)

    monkeypatch.setattr("coaxlink.mavlink.connect", opened)
    out, result = tmp_path / "mend.params", tmp_path / "motors.json"
    words = ["motors", AIRFRAME, "--connect", ground.url(), "--out", str(out), "--json", str(result)]
    for typed, code in (("they are on\n", 4), ("they are off\n", 2)):
        monkeypatch.setattr("sys.stdin", io.StringIO(typed))
        assert run(build_app(), words) == code
    asked = ["\n", "\n", "7\n", "\n", "\n", "\n", "99\nx\n3\n", "\n"]
    ways = ["\n"] * 4 + ["n\n"] + ["\n"] * 3
    typed = "they are off\n" + "".join(a + b for a, b in zip(asked, ways, strict=True))
    monkeypatch.setattr("sys.stdin", io.StringIO(typed))
    assert run(build_app(), words) == 1
    reported = capsys.readouterr()
    assert reported.out.startswith("rotor 1: ")
    assert "rotor 3: rear left, upper, counter-clockwise from above: WRONG, turned: 7 ccw" in reported.out
    assert reported.out.count(": right\n") == 5 and "rotor 5 turns the other way" in reported.out
    assert "rotor 3, 5, 7: not where" in reported.err and "found '99'" in reported.err
    document = json.loads(result.read_text())
    assert [m["motor"] for m in document["motors"]] == list(range(1, 9))
    assert read_params(out).params == {c["name"]: c["new"] for c in document["changes"]}
    assert sorted(read_params(out).params.values()) == [103, 107]
