"""`coaxlink table` as a user runs it."""

import json
from pathlib import Path

import pytest

from coaxlink.cli import main
from firmware_params import px4

EXAMPLES = Path(__file__).parents[2] / "examples"
X8 = str(EXAMPLES / "x8_paper.toml")


def _run(capsys, *arguments):
    with pytest.raises(SystemExit) as ended:
        main(["table", *map(str, arguments)])
    captured = capsys.readouterr()
    return ended.value.code, captured.out, captured.err


def test_writes_a_file_that_qgc_reads_and_says_the_mix(tmp_path, capsys):
    arguments = (X8, "--firmware", "px4", "--law", "reduced", "--rotor", EXAMPLES / "rotor_eq15.toml")
    code, out, err = _run(capsys, *arguments, "--out", tmp_path / "t", "--json", tmp_path / "t.json")
    assert code == 0 and "lower/upper u^2 = 1.4877" in out and "ceiling 405.9 N" in out
    (path,) = (tmp_path / "t").iterdir()
    assert path.name == "paper-x8.params" and str(path) in err
    read = px4.read_params_file(path)
    assert read.params["CA_ROTOR_COUNT"] == 8 and read.params["THR_MDL_FAC"] == 1.0
    assert read.params["MPC_THR_HOVER"] == pytest.approx(0.404)
    assert len(read.params) == 4 + 8 * 8 + 1
    shown = json.loads((tmp_path / "t.json").read_text())
    assert shown["pairs"][0]["lower_over_upper_u2"] == pytest.approx(1.487654, abs=1e-5)
    assert shown["parameters"] == pytest.approx(read.params)
    assert shown["files"] == [str(path)]


def test_without_out_nothing_is_written(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert _run(capsys, X8, "--firmware", "px4")[0] == 0
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((X8, "--firmware", "betaflight"), "--firmware: betaflight: expected"),
        ((X8, "--firmware", "px4", "--law", "nope"), "--law: nope: "),
        (("none.toml", "--firmware", "px4"), "none.toml"),
        ((X8, "--firmware", "px4", "--rotor", X8), "x8_paper.toml: form"),
    ],
)
def test_bad_use_is_one_line_and_two(capsys, arguments, text):
    code, out, err = _run(capsys, *arguments)
    assert code == 2 and text in err and err.count("\n") == 1 and out == ""


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


def test_ardupilot_files_and_an_explanation(tmp_path, capsys):
    code, out, err = _run(
        capsys,
        X8,
        "--firmware",
        "ardupilot",
        "--out",
        tmp_path / "a",
        "--explain",
        "--json",
        tmp_path / "a.json",
    )
    assert code == 0 and "FRAME_CLASS 15" in out and "ATC_RAT_RLL_* x" in out and "wrote" in err
    names = sorted(p.relative_to(tmp_path / "a").as_posix() for p in (tmp_path / "a").rglob("*.*"))
    assert names == ["paper-x8.param", "scripts/coaxlink_matrix.lua"]
    shown = json.loads((tmp_path / "a.json").read_text())
    assert shown["explain"]["worst_relative"]["roll"] < 1e-6 and shown["explain"]["against"] == "standard law"
    code, out, _ = _run(capsys, X8, "--firmware", "px4", "--law", "reduced", "--explain")
    assert code == 0 and "MC_YAWRATE_K x" in out and "asked -> done" in out


def test_the_research_fork_s_file_is_the_same_mix(tmp_path, capsys):
    arguments = (X8, "--firmware", "px4", "--law", "reduced", "--out", tmp_path, "--csv")
    code, _, err = _run(capsys, *arguments)
    assert code == 0 and "/fs/microsd/etc/mixer.csv" in err
    mix = px4.realise(px4.read_params_file(tmp_path / "paper-x8.params").params).mix
    assert px4.read_mixer_csv(tmp_path / "mixer.csv") == pytest.approx(mix, abs=1e-6)
