"""Layouts from frames, parameters and templates; what is missing is asked for, never guessed."""

import math

import pytest

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
    for upper, said in cases.items():
        with pytest.raises(InputError, match=said):
            completed(layout, Body("x8", 20.0, upper=upper))


def test_px4_parameters_that_hold_no_vehicle():
    for params, said in (
        ({}, "CA_ROTOR_COUNT"),
        ({"CA_ROTOR_COUNT": 8, "CA_AIRFRAME": 2}, "no multirotor"),
        (px4_params(X8) | {"CA_ROTOR3_KM": 0.0}, "CA_ROTOR3_KM"),
    ):
        with pytest.raises(InputError, match=said):
            px4_layout(params, "board")


def test_three_rotors_on_one_place():
    params = px4_params(X8) | {"CA_ROTOR1_PX": 0.1807, "CA_ROTOR1_PY": 0.1807}
    with pytest.raises(InputError, match="share one position"):
        completed(px4_layout(params, "board"), Body("x8", 20.0))


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
    assert list(refused.value.fields) == ["mass_kg", "arm_m", "spacing_m", "upper"]
    assert "1 or 5" in refused.value.fields["upper"]
    assert missing(layout, Body("y6", 10.0, 0.4, 0.1, (1, 2, 4))) == {}


def test_our_own_script_gives_the_layout_back():
    factors = [m.factors for m in FRAMES[4, 1]]
    text = scripts.matrix_script(factors, title="t").encode()
    layout = ardupilot_layout({"FRAME_CLASS": 15}, "board", lambda: text)
    body = Body("x8", 20.0, arm_m=0.2556, spacing_m=0.15, upper=(1, 2, 3, 4))
    assert ring(completed(layout, body)) == ring(X8)
    with pytest.raises(InputError, match="not here"):
        ardupilot_layout({"FRAME_CLASS": 15}, "board")


def test_ardupilot_frames_that_are_no_pairs():
    for params in ({"FRAME": 1}, {"FRAME_CLASS": 1, "FRAME_TYPE": 1}):
        with pytest.raises(InputError, match="FRAME_CLASS"):
            ardupilot_layout(params, "board")


def test_every_frame_has_pairs_that_turn_against_each_other():
    for frame, motors in FRAMES.items():
        stacks = {}
        for motor in motors:
            stacks.setdefault(round(motor.angle_deg), []).append(motor)
        for pair in stacks.values():
            assert len(pair) == 2 and pair[0].yaw * pair[1].yaw < 0, frame
            assert {m.layer for m in pair} in ({"upper", "lower"}, {""}), frame


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
