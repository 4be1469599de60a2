"""`coaxlink table` as a user runs it."""

import json
import re
from pathlib import Path

import pytest
from memory_net import Net, plugged
from scripted_autopilot import FLOAT, INT32, ScriptedAutopilot

from coaxlink.cli import main
from firmware_params.reading import read_params

EXAMPLES = Path(__file__).parents[2] / "examples"
X8 = str(EXAMPLES / "x8_paper.toml")


PLACES = [(1, 1), (1, -1), (-1, -1), (-1, 1), (1, -1), (1, 1), (-1, 1), (-1, -1)]
FACTORY = {
    f"CA_ROTOR{n}_{key}": value
    for n, (x, y) in enumerate(PLACES)
    for key, value in zip(
        ("PX", "PY", "PZ", "AX", "AY", "AZ", "CT", "KM"),
        (0.1807 * x, 0.1807 * y, -0.075 if n < 4 else 0.075, 0.0, 0.0, -1.0, 6.5, 0.05 * (-1) ** n),
        strict=True,
    )
}


def _run(capsys, *arguments):
    with pytest.raises(SystemExit) as ended:
        main(["table", *map(str, arguments)])
    captured = capsys.readouterr()
    return ended.value.code, captured.out, captured.err


def test_writes_a_file_that_qgc_reads_and_says_the_mix(tmp_path, capsys):
    arguments = (X8, "--firmware", "px4", "--law", "reduced", "--rotor", EXAMPLES / "rotor_eq15.toml")
    code, out, err = _run(capsys, *arguments, "--out", tmp_path / "t", "--json", tmp_path / "t.json")
    assert code == 0 and "lower/upper u^2 = 1.4877" in out and "ceiling 405.9 N" in out
    path = tmp_path / "t" / "paper-x8.params"
    assert str(path) in err and sorted(p.name for p in (tmp_path / "t").iterdir()) == [path.name, "vehicle"]
    copy = tmp_path / "t" / "vehicle" / "airframe.toml"  # for `upload`
    assert copy.read_bytes() == (EXAMPLES / "x8_paper.toml").read_bytes()
    read = read_params(path)
    assert read.params["CA_ROTOR_COUNT"] == 8 and read.params["THR_MDL_FAC"] == 1.0
    assert read.params["MPC_THR_HOVER"] == pytest.approx(0.404)
    assert len(read.params) == 4 + 8 * 8 + 1
    shown = json.loads((tmp_path / "t.json").read_text())
    assert shown["pairs"][0]["lower_over_upper_u2"] == pytest.approx(1.487654, abs=1e-5)
    assert shown["parameters"] == pytest.approx(read.params)
    assert shown["files"] == [str(path)]


@pytest.mark.slow
def test_without_out_nothing_is_written(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert _run(capsys, X8, "--firmware", "px4")[0] == 0
    assert list(tmp_path.iterdir()) == []


def test_bad_use_is_one_line_and_two(capsys):
    for arguments, text in (
        ((X8, "--firmware", "betaflight"), "--firmware: betaflight: expected"),
        ((X8, "--firmware", "px4", "--law", "nope"), "--law: nope: "),
        ((X8, "--firmware", "px4", "--keep-gains"), "--connect URL is expected"),
        (("none.toml", "--firmware", "px4"), "none.toml"),
        ((X8, "--firmware", "px4", "--rotor", X8), "x8_paper.toml: an airframe file; a rotor file"),
    ):
        code, out, err = _run(capsys, *arguments)
        assert code == 2 and text in err and err.count("\n") == 1 and out == "", arguments


def test_a_trap_is_refused_and_nothing_written(tmp_path, capsys):
    weak = tmp_path / "weak.toml"
    text = (EXAMPLES / "rotor_eq15.toml").read_text()
    for old, new in (("77.68", "1.5536"), ("69.89", "1.3978"), ("-30.7", "-0.614"), ("1.94", "0.0388")):
        text = text.replace(old, new)
    weak.write_text(text.replace("= 2.0\n", "= 0.04\n").replace("= -0.5\n", "= -0.01\n"))
    code, _, err = _run(
        capsys, X8, "--firmware", "px4", "--law", "reduced", "--rotor", weak, "--out", tmp_path / "t"
    )
    assert code == 4 and "px4.weak-axis: PX4 drops yaw" in err
    assert not (tmp_path / "t").exists()


@pytest.mark.slow
def test_ardupilot_files_and_what_the_table_costs(tmp_path, capsys):
    files = ("--out", tmp_path / "a", "--json", tmp_path / "a.json")
    code, out, err = _run(capsys, X8, "--firmware", "ardupilot", *files)
    assert code == 0 and "FRAME_CLASS 15" in out and "wrote" in err
    names = sorted(p.relative_to(tmp_path / "a").as_posix() for p in (tmp_path / "a").rglob("*.*"))
    copies = ["vehicle/airframe.toml", "vehicle/rotor.toml"]
    assert names == ["paper-x8.param", "scripts/coaxlink_matrix.lua", *copies]
    ceiling, yaw, power, *_ = json.loads((tmp_path / "a.json").read_text())["price"]
    assert all(line in " ".join(out.split()) for line in (ceiling, yaw, power))
    now, before = (float(w) for w in re.findall(r"([\d.]+) W", power))
    assert 0.03 < 1.0 - now / before < 0.07


@pytest.mark.slow
def test_beside_a_board_the_price_and_the_loops_are_told(capsys):
    held = {"CA_ROTOR_COUNT": (8, INT32)} | {
        name: (value, FLOAT) for name, value in {"MC_ROLLRATE_K": 1.5, **FACTORY}.items()
    }
    with plugged(Net()) as net, ScriptedAutopilot(held, net=net) as board:
        arguments = ["--firmware", "px4", "--law", "reduced", "--connect", board.url]
        code, out, err = _run(capsys, X8, *arguments)
    assert "system 1: PX4 1.16.1 at" in err
    reported = " ".join(out.split())
    assert code == 0 and reported.count("; on board ") == 3
    assert (
        "rate loops: the same demand gives" in reported
        and "times the moment that it gives on board" in reported
    )


def test_nothing_is_made_around_a_weak_rotor_unasked(tmp_path, capsys):
    weak = tmp_path / "weak.toml"
    effect = 'name = "degraded_rotor"\nparameters = { rotor = 3.0, thrust_loss = 0.3, torque_loss = 0.2 }\n'
    weak.write_text((EXAMPLES / "rotor_paper.toml").read_text() + f"\n[[effects]]\n{effect}")
    arguments = (X8, "--firmware", "px4", "--law", "standard", "--rotor", weak)
    code, _, err = _run(capsys, *arguments)
    assert code == 4 and "ground it, change its propeller or motor" in err
    code, out, _ = _run(capsys, *arguments, "--around-weak-rotor")
    assert code == 0 and "yaw authority: " in out
