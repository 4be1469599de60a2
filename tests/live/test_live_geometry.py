"""Live mixing is held against the board's own rotors, as an upload is."""

from pathlib import Path

import pytest
from case_table import case_table
from memory_net import Net, meet, plugged
from px4_board import x8
from scripted_autopilot import FLOAT, INT32, ScriptedAutopilot
from verb import run

from coaxlink.airframe import load_airframe
from coaxlink.errors import SafetyRefusal
from coaxlink.files import example
from coaxlink.live.geometry import refuse_other_vehicle

X8 = example("x8_paper.toml")


def _ardupilot(frame_class, frame_type, **more):
    held = {"FRAME_CLASS": frame_class, "FRAME_TYPE": frame_type, **more}
    return {name: (value, INT32) for name, value in held.items()}


def _y6b(tmp_path: Path, capsys):
    """A vehicle file of the Y6B's numbers, made by the product's own template."""
    out = tmp_path / "y6b.toml"
    code, _, err = run(capsys, "init", out, "--template", "y6", "--mass", 3, "--arm", 0.3, "--spacing", 0.1)
    assert code == 0, err
    return load_airframe(out)


def test_a_board_that_numbers_its_motors_otherwise_is_refused(tmp_path, capsys):
    y6b = _y6b(tmp_path, capsys)
    with case_table() as case:
        for kind, right in ((10, True), (1, False)):
            board = ScriptedAutopilot(_ardupilot(5, kind), net=Net(), px4=False)
            board.param_errors = True
            with case(f"FRAME_TYPE {kind}"), board, meet(board) as session:
                if right:
                    assert refuse_other_vehicle(session, y6b) == []
                    continue
                with pytest.raises(SafetyRefusal, match=r"another vehicle: rotor \d is another on the board"):
                    refuse_other_vehicle(session, y6b)
                assert refuse_other_vehicle(session, y6b, new_geometry=True)


def test_px4s_rotors_are_held_against_the_file_and_what_is_not_known_is_said():
    frame = load_airframe(X8)
    held = {name: (v, kind) for name, (v, kind) in x8().items()}
    turned = dict(held)
    turned["CA_ROTOR2_KM"] = (-held["CA_ROTOR2_KM"][0], FLOAT)
    legacy = held | {"SYS_CTRL_ALLOC": (0, INT32)}
    for params, refused in ((held, False), (turned, True), (legacy, False)):
        with ScriptedAutopilot(params, net=Net()) as board, meet(board) as session:
            if refused:
                with pytest.raises(SafetyRefusal, match=r"rotor 3 is another on the board: spin"):
                    refuse_other_vehicle(session, frame)
            else:
                reported = refuse_other_vehicle(session, frame)
                assert bool(reported) is (params is legacy)


@pytest.mark.slow
def test_mix_and_bridge_refuse_before_anything_is_sent(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    turned = x8()
    turned["CA_ROTOR2_KM"] = (-turned["CA_ROTOR2_KM"][0], FLOAT)
    for verb in (("mix", X8, "--seconds", 1), ("bridge", X8, "--firmware", "px4")):
        with plugged(Net()) as net, ScriptedAutopilot(turned, net=net, version=(1, 13, 3)) as board:
            code, _, err = run(capsys, *verb, "--connect", board.url)
            assert code == 4 and "rotor 3 is another on the board" in err and "--new-geometry" in err
            assert not any(h.get_type() == "SET_ACTUATOR_CONTROL_TARGET" for h in board.heard)
