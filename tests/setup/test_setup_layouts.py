"""Layouts from frames, parameters and templates; what is missing is asked for, never guessed."""

import math
import re

import pytest
from case_table import case_table

from coaxlink.airframe import load_airframe
from coaxlink.errors import InputError
from coaxlink.files import example
from coaxlink.setup import (
    TEMPLATES,
    Body,
    MissingError,
    airframe_toml,
    ardupilot_layout,
    check_airframe,
    check_outputs,
    completed,
    draw,
    missing,
    px4_layout,
    template,
)
from firmware_params.ardupilot import scripts
from firmware_params.ardupilot.frames import FRAMES

X8 = load_airframe(example("x8_paper.toml"))


def px4_params(frame, heights=True):
    """As PX4 holds a vehicle, written by hand: places, spin by the sign of KM, outputs."""
    params = {"CA_AIRFRAME": 0, "CA_ROTOR_COUNT": len(frame.rotors)}
    for n, rotor in enumerate(frame.rotors):
        x, y, z = rotor.position_m
        params |= {f"CA_ROTOR{n}_PX": x, f"CA_ROTOR{n}_PY": y, f"CA_ROTOR{n}_PZ": z if heights else 0.0}
        params[f"CA_ROTOR{n}_KM"] = 0.05 * rotor.yaw_sign
        params[f"PWM_MAIN_FUNC{n + 1}"] = 101 + n
    return params


def ring(frame):
    return [(r.number, r.level, r.pair, r.yaw_sign) for r in frame.rotors]


def test_px4_with_heights_needs_only_the_mass():
    made = completed(px4_layout(px4_params(X8), "board"), Body("x8", 20.0))
    assert ring(made) == ring(X8)
    for here, there in zip(made.rotors, X8.rotors, strict=True):
        assert here.position_m == pytest.approx(there.position_m, abs=1e-6)
    assert [p.output for p in px4_layout(px4_params(X8), "board").mounts] == [
        f"MAIN {n}" for n in range(1, 9)
    ]


def test_px4_without_heights_asks_for_the_upper_rotors_and_the_spacing():
    layout = px4_layout(px4_params(X8, heights=False), "board")
    with pytest.raises(InputError, match=r"which rotor of each pair is on top: 1 or 6, 2 or 5"):
        completed(layout, Body("x8", 20.0, spacing_m=0.15))
    with pytest.raises(InputError, match=r"spacing_m"):
        completed(layout, Body("x8", 20.0, upper=(1, 2, 3, 4)))
    made = completed(layout, Body("x8", 20.0, spacing_m=0.15, upper=(1, 2, 3, 4)))
    assert ring(made) == ring(X8)
    exchanged = completed(layout, Body("x8", 20.0, spacing_m=0.15, upper=(5, 6, 7, 8)))
    assert [r.level for r in exchanged.rotors] == ["lower"] * 4 + ["upper"] * 4


def test_upper_rotors_that_contradict_the_board():
    layout = px4_layout(px4_params(X8), "board")
    cases = {(1, 6, 2, 3, 4): "both", (1, 2, 3): "neither", (9,): "from 1 to 8", (5, 6, 7, 8): "on top"}
    for upper, reported in cases.items():
        with pytest.raises(InputError, match=reported):
            completed(layout, Body("x8", 20.0, upper=upper))


def test_px4_parameters_that_hold_no_vehicle():
    for params, reported in (
        ({}, "CA_ROTOR_COUNT"),
        ({"CA_ROTOR_COUNT": 8, "CA_AIRFRAME": 2}, "a multirotor"),
        (px4_params(X8) | {"CA_ROTOR3_KM": 0.0}, "CA_ROTOR3_KM"),
    ):
        with pytest.raises(InputError, match=reported):
            px4_layout(params, "board")


def test_three_rotors_on_one_place():
    params = px4_params(X8) | {"CA_ROTOR1_PX": 0.1807, "CA_ROTOR1_PY": 0.1807}
    with pytest.raises(InputError, match="share one position"):
        completed(px4_layout(params, "board"), Body("x8", 20.0))


def test_a_rotor_where_no_vehicle_reaches_or_without_a_direction():
    for changed, reported in (
        ({"CA_ROTOR1_PX": -3e30}, "rotor 2: 3e"),
        ({"CA_ROTOR2_AZ": 0.0}, "CA_ROTOR2_AX, _AY and _AZ: are no direction"),
        ({"CA_ROTOR2_AX": math.nan}, "no direction"),
    ):
        with pytest.raises(InputError, match=reported):
            px4_layout(px4_params(X8) | changed, "board")
    with pytest.raises(InputError, match="m from the centre"):
        completed(template("x8"), Body("x8", 20.0, 1e6, 0.1))


def test_an_axis_of_another_length_is_the_direction_that_px4_makes_of_it():
    params = px4_params(X8) | {"CA_ROTOR0_AX": 0.3, "CA_ROTOR0_AZ": -0.4}
    assert px4_layout(params, "board").mounts[0].axis == pytest.approx((0.6, 0.0, -0.8))


def test_ardupilots_octaquad_is_the_papers_numbering():
    params = {"FRAME_CLASS": 4, "FRAME_TYPE": 1} | {f"SERVO{n}_FUNCTION": 32 + n for n in range(1, 9)}
    layout = ardupilot_layout(params, "board")
    with pytest.raises(InputError, match=r"arm_m"):
        completed(layout, Body("x8", 20.0, spacing_m=0.15))
    made = completed(layout, Body("x8", 20.0, arm_m=0.1807 * math.sqrt(2.0), spacing_m=0.15))
    assert ring(made) == ring(X8)
    for here, there in zip(made.rotors, X8.rotors, strict=True):
        assert here.position_m == pytest.approx(there.position_m, abs=1e-6)
    assert layout.mounts[0].output == "SERVO 1"


def test_all_that_is_missing_is_named_at_once():
    layout = ardupilot_layout({"FRAME_CLASS": 5, "FRAME_TYPE": 1}, "board")
    with pytest.raises(MissingError) as refused:
        completed(layout, Body("y6", None))
    assert list(refused.value.fields) == ["mass_kg", "arm_m", "spacing_m"]
    assert missing(layout, Body("y6", 10.0, 0.4, 0.1)) == {}
    flat = px4_layout({**px4_params(X8), **{f"CA_ROTOR{n}_PZ": 0.0 for n in range(8)}}, "board")
    assert "1 or 6" in missing(flat, Body("x8", 10.0))["upper"]


def test_the_motor_test_tells_the_upper_rotor_where_nobody_says_it():
    layout = ardupilot_layout({"FRAME_CLASS": 5, "FRAME_TYPE": 1}, "board")
    assert "motor test turns first" in layout.notes[-1]
    levels = [r.level for r in completed(layout, Body("y6", 10.0, 0.4, 0.1)).rotors]
    assert levels == ["lower", "upper", "lower", "lower", "upper", "upper"]
    reported = completed(layout, Body("y6", 10.0, 0.4, 0.1, (1, 2, 4)))
    assert [r.number for r in reported.rotors if r.level == "upper"] == [1, 2, 4]


def test_our_own_script_gives_the_layout_back():
    factors = [m.factors for m in FRAMES[4, 1]]
    text = scripts.matrix_script(factors, title="t").encode()
    layout = ardupilot_layout({"FRAME_CLASS": 15}, "board", lambda: text)
    body = Body("x8", 20.0, arm_m=0.2556, spacing_m=0.15, upper=(1, 2, 3, 4))
    assert ring(completed(layout, body)) == ring(X8)
    with pytest.raises(InputError, match="not here"):
        ardupilot_layout({"FRAME_CLASS": 15}, "board")


def test_what_no_matrix_of_rotors_holds_is_named():
    names = {
        (0,): "no frame", (6,): "helicopter", (7,): "tricopter", (8,): "single copter", (9,): "CoaxCopter",
        (10,): "bicopter", (11,): "helicopter", (13,): "heli-quad", (16,): "all axes",
        (4, 99): "X8s of this type", (1, 4): "quadcopters of this type", (40,): "not known to coaxlink",
    }  # fmt: skip
    with case_table() as case:
        for (frame, *kind), says in names.items():
            with case(says), pytest.raises(InputError, match=says):
                ardupilot_layout({"FRAME_CLASS": frame, "FRAME_TYPE": kind[0] if kind else 1}, "board")
        with case("before 3.5"), pytest.raises(InputError, match="FRAME_CLASS"):
            ardupilot_layout({"FRAME": 1}, "board")
        with case("no quadplane"), pytest.raises(InputError, match="without lift motors"):
            ardupilot_layout({"Q_ENABLE": 0, "Q_FRAME_CLASS": 4}, "board")


def test_every_coaxial_frame_flies():
    """Pairs of one place and two layers, four axes, and each motor once in the order of the test."""
    with case_table() as case:
        for (kind, shape), motors in FRAMES.items():
            with case(f"{kind} {shape}"):
                layout = ardupilot_layout({"FRAME_CLASS": kind, "FRAME_TYPE": shape}, "board")
                made = completed(layout, Body("a", 10.0, 0.5, 0.1))
                assert sorted(m.test_place for m in motors) == list(range(1, len(motors) + 1))
                alike = {20: 4, 21: 4}.get(shape, 0) if kind == 4 else 0
                assert len(made.co_rotating) == alike
                if kind in (4, 5, 12):
                    assert len(made.pairs) == len(motors) // 2
                plane = ardupilot_layout({"Q_FRAME_CLASS": kind, "Q_FRAME_TYPE": shape}, "board")
                assert plane.mounts == layout.mounts and "quadplane" in plane.notes[-1] + plane.notes[0]


def test_two_outputs_a_motor_are_pairs_that_turn_alike():
    outputs = {f"SERVO{n}_FUNCTION": f for n, f in enumerate((33, 34, 35, 36) * 2, start=1)}
    layout = ardupilot_layout({"FRAME_CLASS": 1, "FRAME_TYPE": 1, **outputs}, "board")
    made = completed(layout, Body("a", 12.0, 0.55, 0.15))
    assert made.co_rotating == ((0, 4), (1, 5), (2, 6), (3, 7))
    assert [m.output for m in layout.mounts] == [f"SERVO {n}" for n in range(1, 9)]
    assert "`upper`" in layout.notes[0]


OWN = """
local CCW, CW = 1, -1
local function add(n, degrees, yaw, order)
  MotorsMatrix:add_motor_raw(n, math.cos(math.rad(degrees + 90)), math.cos(math.rad(degrees)), yaw, order)
end
for arm = 0, 7 do
  local turn = arm % 2 == 0 and CW or CCW
  add(2 * arm, 45 * arm, turn, 2 * arm + 1)
  add(2 * arm + 1, 45 * arm, -turn, 2 * arm + 2)
end
assert(MotorsMatrix:init(16), "no init")
motors:set_frame_string("sixteen")
"""


def test_an_owners_script_gives_sixteen_rotors():
    layout = ardupilot_layout({"FRAME_CLASS": 15}, "board", OWN.encode)
    made = completed(layout, Body("a", 60.0, 1.1, 0.2))
    assert made.pairs == tuple((n, n + 1) for n in range(0, 16, 2)) and made.co_rotating == ()
    for n, rotor in enumerate(made.rotors):
        angle = math.radians(45 * (n // 2))
        assert rotor.position_m[:2] == pytest.approx((1.1 * math.cos(angle), 1.1 * math.sin(angle)), abs=1e-6)
        assert rotor.yaw_sign == (-1 if (n // 2 + n) % 2 == 0 else 1)


def test_rotors_that_cannot_command_all_axes_are_refused_at_once():
    line = [(0.5 * k, 0.0, 1 if k % 2 else -1) for k in (-2, -1, 1, 2)]
    alike = [(x, y, 1) for x in (-0.3, 0.3) for y in (-0.3, 0.3)]
    flat = {"x": line, "y": [(y, x, s) for x, y, s in line], "alike": alike}
    lost = {"x": "roll", "y": "pitch", "alike": "yaw"}
    with case_table() as case:
        for name, rotors in flat.items():
            params = {"CA_ROTOR_COUNT": len(rotors)}
            for n, (x, y, spin) in enumerate(rotors):
                params |= {f"CA_ROTOR{n}_PX": x, f"CA_ROTOR{n}_PY": y, f"CA_ROTOR{n}_KM": 0.05 * spin}
            with case(name), pytest.raises(InputError, match=lost[name]):
                completed(px4_layout(params, "board"), Body("a", 5.0))
        for airframe, kind in ((2, "VTOL"), (12, "coaxial helicopter")):
            with case(kind), pytest.raises(InputError, match=kind):
                px4_layout({"CA_AIRFRAME": airframe, "CA_ROTOR_COUNT": 4}, "board")


def test_templates_are_sound_and_survive_their_file(tmp_path):
    for name in TEMPLATES:
        layout = template(name)
        made = completed(layout, Body(name, 12.0, arm_m=0.5, spacing_m=0.12))
        assert check_airframe(made) == (), name
        path = tmp_path / "a.toml"
        path.write_text(airframe_toml(made, layout.source))
        back = load_airframe(path)
        assert ring(back) == ring(made)
        assert back.sources == made.sources and back.source_of("inertia_kg_m2") == "estimated"
        for a, b in zip(back.rotors, made.rotors, strict=True):
            assert a.position_m == pytest.approx(b.position_m, abs=1e-6)
        assert all(f"{r.number:>2} {r.level} " in draw(made) for r in made.rotors)


def test_the_front_right_rotor_is_drawn_front_right():
    rows = draw(X8).splitlines()
    front = next(k for k, row in enumerate(rows) if "1 upper ccw" in row)
    rear = next(k for k, row in enumerate(rows) if "3 upper ccw" in row)
    assert front < rear
    assert rows[front].index("1 upper") > rows[front].index("2 upper")


def test_what_a_few_parameters_leave_out_is_said():
    """A type that stands nowhere, surfaces, motors without an output."""
    motors = {f"SERVO{n}_FUNCTION": 32 + n for n in range(1, 9)}
    sound = ardupilot_layout({"FRAME_CLASS": 4, "FRAME_TYPE": 1, **motors}, "board")
    assert not sound.idle and not any("nowhere: X" in note or "drive no" in note for note in sound.notes)
    few = ardupilot_layout({"FRAME_CLASS": 4}, "few.param")
    assert not few.idle and any("FRAME_TYPE stands nowhere: X (1)" in note for note in few.notes)
    assert any("not all SERVOn_FUNCTION are there" in note for note in few.notes)
    wrong = ardupilot_layout({"FRAME_CLASS": 4, "FRAME_TYPE": 1, **motors, "SERVO3_FUNCTION": 4}, "board")
    assert wrong.idle == (3,) and any("SERVO3_FUNCTION 4 (aileron)" in note for note in wrong.notes)
    (finding,) = check_outputs(wrong)
    assert finding.severity == "error" and "no output drives rotor 3" in finding.text
    px4 = px4_params(X8) | {f"PWM_MAIN_FUNC{n}": 100 + n for n in range(1, 8)} | {"PWM_MAIN_FUNC8": 0}
    assert px4_layout(px4, "board").idle == (8,) and not px4_layout(px4_params(X8), "few").idle


@pytest.mark.parametrize(
    "arm_m, spacing_m, reported", [(400.0, 0.1, "0.4 for mill"), (0.5, 140.0, "0.14 for mill")]
)
def test_millimetres_are_asked_about(arm_m, spacing_m, reported):
    with pytest.raises(InputError, match=f"metres are expected: {reported}"):
        completed(template("x8"), Body("x8", 20.0, arm_m, spacing_m))


def test_an_unusual_order_of_outputs_is_a_warning():
    motors = {f"SERVO{n}_FUNCTION": 32 + n for n in range(1, 9)}
    swapped = motors | {"SERVO1_FUNCTION": 37, "SERVO5_FUNCTION": 33}
    for functions, found in ((motors, 0), (swapped, 1), ({}, 0)):
        layout = ardupilot_layout({"FRAME_CLASS": 4, "FRAME_TYPE": 1, **functions}, "board")
        findings = check_outputs(layout)
        assert len(findings) == found
        assert all(f.severity == "warning" and "1 on SERVO 5" in f.text for f in findings)
    px4 = px4_params(X8) | {f"PWM_MAIN_FUNC{n}": 109 - n for n in range(1, 9)}
    (finding,) = check_outputs(px4_layout(px4, "board"))
    assert "1 on MAIN 8" in finding.text


def test_parameters_of_another_vehicle_are_no_frame_of_ours():
    """FRAME_CLASS 1 is a quadcopter's of ArduCopter alone."""
    with case_table() as case:
        for params, said in (
            ({"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0, "CRUISE_SPEED": 2.0}, "a rover or boat (CRUISE_SPEED)"),
            ({"FRAME_CLASS": 1.0, "MODE1": 0.0, "SERVO1_FUNCTION": 33.0}, "a rover or boat (MODE1)"),
            ({"FRAME_CLASS": 2.0, "SERVO1_FUNCTION": 73.0}, "no output drives a motor (SERVO1_FUNCTION 73"),
            ({"FRAME_CONFIG": 1.0, "SYSID_THISMAV": 1.0}, "a submarine (FRAME_CONFIG)"),
            ({"FRAME_CLASS": 1.0, "FINS_TURBO_MODE": 0.0}, "a blimp"),
            ({"RLL2SRV_TCONST": 0.5, "SYSID_THISMAV": 1.0}, "a plane (RLL2SRV_TCONST)"),
            ({"RLL2SRV_TCONST": 0.5, "Q_ENABLE": 0.0, "Q_FRAME_CLASS": 4.0}, "a plane"),
        ):
            with case(said), pytest.raises(InputError, match=re.escape(said)):
                ardupilot_layout(params, "b.param")
    quadplane = {"RLL2SRV_TCONST": 0.5, "Q_ENABLE": 1.0, "Q_FRAME_CLASS": 4.0, "Q_FRAME_TYPE": 1.0}
    assert len(ardupilot_layout(quadplane, "b.param").mounts) == 8
    assert len(ardupilot_layout({"FRAME_CLASS": 4.0, "SERVO9_FUNCTION": 7.0}, "b.param").mounts) == 8
