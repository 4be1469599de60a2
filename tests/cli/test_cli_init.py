"""`init`, `airframe` and `examples` as a new user types them, on files and on both stand-ins."""

import json
from pathlib import Path

import pytest
from case_table import case_table
from cli_runs import coaxlink

from coaxlink.airframe import airframe_schema, load_airframe
from coaxlink.files import example
from coaxlink.rotor.model import rotor_schema
from sim.testing import standin

SHARED = Path(__file__).parents[3] / "shared" / "data"


def test_a_template_becomes_a_vehicle(tmp_path):
    out = tmp_path / "x8.toml"
    run = coaxlink(
        "init", out, "--mass", "20", "--template", "x8", "--arm", "0.5", "--spacing", "0.15",
        "--picture", tmp_path / "x8.png", "--json", tmp_path / "x8.json",
    )  # fmt: skip
    assert run.code == 0, run.err
    assert "spins and balance fit; the inertia is estimated" in " ".join(run.out.split())
    assert len(load_airframe(out).pairs) == 4
    assert (tmp_path / "x8.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((tmp_path / "x8.json").read_text())["findings"] == []
    again = coaxlink("init", out, "--mass", "20", "--template", "x8", "--arm", "0.5", "--spacing", "0.15")
    assert again.code == 2
    assert "--force" in again.err


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_a_board_becomes_a_vehicle(tmp_path, firmware):
    out = tmp_path / "x8.toml"
    with standin("--firmware", firmware) as port:
        url = f"udpout:127.0.0.1:{port}"
        known = ["--arm", "0.2556", "--spacing", "0.15"] if firmware == "ardupilot" else []
        run = coaxlink("init", out, "--mass", "20", "--connect", url, *known)
        assert run.code == 0, run.err
        check = coaxlink("airframe", example("x8_paper.toml"), "--connect", url)
        assert check.code == 0, check.err
        assert "has the same rotors" in check.out
        wrong = tmp_path / "wrong.toml"
        text = out.read_text().replace('spin = "ccw"', 'spin = "other"')
        wrong.write_text(text.replace('spin = "cw"', 'spin = "ccw"').replace('spin = "other"', 'spin = "cw"'))
        turned = coaxlink("airframe", wrong, "--connect", url)
        assert turned.code == 1
        assert "spin (ccw on the board)" in turned.out
    made, paper = load_airframe(out), load_airframe(example("x8_paper.toml"))
    for here, there in zip(made.rotors, paper.rotors, strict=True):
        assert here.position_m == pytest.approx(there.position_m, abs=1e-3)
        assert (here.level, here.pair, here.yaw_sign) == (there.level, there.pair, there.yaw_sign)


@pytest.mark.slow
@pytest.mark.shared_data
@pytest.mark.skipif(not SHARED.is_dir(), reason="shared/data is not beside this checkout")
def test_real_boards_logs(tmp_path):
    with case_table() as case:
        for log, code, reported in (
            ("flights/px4_null_fitted.ulg", 0, "nothing to mend"),
            ("logs/sample_log_small.ulg", 2, "CA_ROTOR_COUNT"),
            ("flights/ap_null.bin", 2, "coaxlink_matrix.lua"),
            ("logs/ardupilot_24.bin", 2, "FRAME_CLASS"),
        ):
            out = tmp_path / f"{Path(log).stem}.toml"
            with case(log):
                run = coaxlink("init", out, "--mass", "20", "--from", SHARED / log)
                assert run.code == code and reported in run.out + run.err
                assert out.exists() == (code == 0)


@pytest.mark.slow
def test_what_is_missing_is_one_line(tmp_path):
    x8 = ["--mass", "20", "--template", "x8"]
    with case_table() as case:
        for arguments, reported in (
            (["--mass", "20"], "--template"),
            (["--mass", "20", "--template", "x9"], "x8, coax-quad"),
            (x8, "--arm"),
            (["--mass", "-1", "--template", "x8", "--arm", "1", "--spacing", "0.1"], "--mass"),
            ([*x8, "--arm", "nan", "--spacing", "0.1"], "--arm"),
            ([*x8, "--arm", "1", "--spacing", "0.1", "--inertia", "1,2"], "--inertia"),
            ([*x8, "--arm", "1", "--spacing", "0.1", "--upper", "a"], "--upper"),
            (["--mass", "20", "--from", "nowhere.params"], "nowhere.params"),
        ):
            with case(reported):
                run = coaxlink("init", tmp_path / "a.toml", *arguments)
                assert run.code == 2 and len(run.err.strip().splitlines()) == 1
                assert reported in run.err and not (tmp_path / "a.toml").exists()


def test_mistakes_are_exit_code_1(tmp_path):
    text = example("x8_paper.toml").read_text().replace("0.1807", "180.7")
    (tmp_path / "mm.toml").write_text(text.replace("rotor_paper.toml", str(example("rotor_paper.toml"))))
    run = coaxlink("airframe", tmp_path / "mm.toml")
    assert run.code == 1
    assert "millimetres" in run.out


@pytest.mark.slow
def test_a_board_whose_rotor_has_no_output_is_made_and_ends_with_1(tmp_path):
    functions = {n: 32 + n for n in range(1, 9)} | {3: 4, 9: 0}
    rows = [f"SERVO{n}_FUNCTION,{function}" for n, function in functions.items()]
    board = tmp_path / "b.param"
    board.write_text("\n".join(["@include more.parm", "FRAME_CLASS,4", *rows]) + "\n")
    sizes = ["--mass", "12", "--arm", "0.5", "--spacing", "0.1"]
    run = coaxlink("init", tmp_path / "v.toml", "--from", board, *sizes)
    assert run.code == 1 and (tmp_path / "v.toml").exists()
    assert "error: airframe.outputs: no output drives rotor 3" in run.out
    for reported in (
        "'@include more.parm' was not followed",
        "SERVO3_FUNCTION 4 (aileron)",
        "FRAME_TYPE stands nowhere",
    ):
        assert reported in run.err


def test_examples_are_listed_and_copied(tmp_path):
    listed = coaxlink("examples")
    assert listed.code == 0
    assert "x8_paper.toml" in listed.out
    run = coaxlink("examples", "x8_paper.toml", "rotor_paper.toml", "--out", tmp_path)
    assert run.code == 0
    assert coaxlink("airframe", tmp_path / "x8_paper.toml").code == 0
    assert coaxlink("examples", "nothing.toml", "--out", tmp_path).code == 2
    assert coaxlink("examples", "x8_paper.toml", "--out", tmp_path).code == 2


def test_the_shipped_schemas_are_the_readers_own():
    assert json.loads(example("airframe.schema.json").read_text()) == airframe_schema()
    assert json.loads(example("rotor.schema.json").read_text()) == rotor_schema()


def test_ardupilots_frame_asks_for_all_that_is_missing_in_one_line(tmp_path):
    (tmp_path / "b.param").write_text("FRAME_CLASS,5\nFRAME_TYPE,1\n")
    run = coaxlink("init", tmp_path / "a.toml", "--from", tmp_path / "b.param")
    assert run.code == 2 and len(run.err.strip().splitlines()) == 1
    for option in ("--mass", "--arm", "--spacing"):
        assert option in run.err


def test_every_example_is_described_by_a_whole_sentence_on_one_line():
    rows = coaxlink("examples").out.splitlines()
    assert len(rows) > 30
    for row in rows:
        name, _, about = row.partition(" ")
        assert about.strip().endswith((".", ")")), row
        assert "nothing but" not in about, name


def test_two_backups_are_one_too_many_and_the_line_says_which_to_take():
    run = coaxlink("restore", "A", "B", "--connect", "udpout:127.0.0.1:9")
    assert run.code == 2
    assert "one BACKUP is expected, found A, B: the oldest undoes all uploads since it" in run.err


def test_a_guess_says_how_it_is_measured(tmp_path):
    x8 = ["--template", "x8", "--mass", "20", "--arm", "0.3", "--spacing", "0.15"]
    guessed = coaxlink("init", tmp_path / "a.toml", *x8)
    assert "pendulum" in guessed.err and "step of one motor" in guessed.err
    assert load_airframe(tmp_path / "a.toml").sources["motor_lag_s"] == "default"
    given = coaxlink("init", tmp_path / "b.toml", *x8, "--inertia", "0.9,0.9,1.6", "--lag", "0.03")
    assert "guessed" not in given.err
    determined = load_airframe(tmp_path / "b.toml")
    assert determined.motor_lag_s == 0.03 and set(determined.sources.values()) == {"declared"}
