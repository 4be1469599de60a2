"""A newcomer's first steps: what is copied can be used, and what is said can be read."""

from __future__ import annotations

from pathlib import Path

import cli_runs
import pytest

from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run
from coaxlink.files import example


def coaxlink(*arguments: object) -> int:
    return run(build_app(), [str(a) for a in arguments])


def test_a_copied_vehicle_brings_its_rotor_model(tmp_path: Path) -> None:
    assert coaxlink("examples", "x8_paper.toml", "--out", tmp_path) == 0
    assert coaxlink("airframe", tmp_path / "x8_paper.toml") == 0


def test_a_rotor_model_of_ones_own_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "rotor_paper.toml").write_text("mine")
    assert coaxlink("examples", "x8_paper.toml", "--force", "--out", tmp_path) == 0
    assert (tmp_path / "rotor_paper.toml").read_text() == "mine"


def test_a_lone_rotor_is_measured_at_levels_not_on_a_map(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "log.csv"
    rows = [f"{500 * i},{0.7 * i * i:.4f},{0.018 * i * i:.4f}" for i in range(1, 11)]
    log.write_text("\n".join(["upper_rpm,upper_thrust_N,upper_torque_Nm", *rows]) + "\n")
    assert coaxlink("identify", log, "--form", "srm", "--all") == 0
    assert "% of 5 levels" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--height", "--voltage"])
def test_no_vehicle_is_mixed_for_below_the_ground(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert coaxlink("examples", "x8_paper.toml", "--out", tmp_path) == 0
    capsys.readouterr()
    assert coaxlink("allocate", tmp_path / "x8_paper.toml", "--wrench", "196,0,0,0", option, "-5") == 2
    assert capsys.readouterr().err == f"coaxlink: {option}: -5: 0 or more expected\n"


def test_a_condition_that_no_effect_depends_on_is_said(tmp_path):
    given = ["allocate", example("x8_paper.toml"), "--law", "standard", "--wrench", "196,0,0,0"]
    idle = cli_runs.coaxlink(*given, "--voltage", "24", "--height", "0.4")
    assert idle.code == 0
    assert "--voltage 24 changes nothing" in idle.err and "--height 0.4 changes nothing" in idle.err
    rotor = tmp_path / "rotor.toml"
    text = example("rotor_paper.toml").read_text()
    rotor.write_text(
        text + "\n[[effects]]\nname = 'ground_effect'\ncolumns = ['height_m']\n"
        "parameters = { gain_at_ground = 0.2, height_scale_m = 0.6 }\n"
    )
    felt = cli_runs.coaxlink(*given, "--rotor", rotor, "--height", "0.4")
    assert felt.code == 0 and "compensated: ground_effect" in felt.err and "changes nothing" not in felt.err
