"""`coaxlink allocate`: the JSON of the contract, and one line for each wrong use."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from coaxlink.cli import build_app
from coaxlink.cli._shell import run

EXAMPLES = Path(__file__).parents[2] / "examples"
X8 = str(EXAMPLES / "x8_paper.toml")


def coaxlink(*arguments: str) -> int:
    return run(build_app(), list(arguments))


def test_json_is_as_the_contract_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "a.json"
    wrench = "196.2,1,-1,0.3"
    assert coaxlink("allocate", X8, "--law", "coaxial", "--wrench", wrench, "--json", str(out)) == 0
    result = json.loads(out.read_text())
    for key in ("law", "speeds", "thrust_N", "torque_Nm", "wrench", "error", "power", "saturated", "dropped"):
        assert key in result
    assert [len(result[k]) for k in ("speeds", "thrust_N", "torque_Nm", "saturated")] == [8] * 4
    assert result["wrench"] == [196.2, 1, -1, 0.3]
    assert sum(result["thrust_N"]) == pytest.approx(196.2, abs=1e-6)
    assert result["dropped"] == []
    stdout = capsys.readouterr().out
    assert "thrust N" in stdout
    assert "coaxial" in stdout


def test_the_printed_numbers_can_be_weighed_on_the_printed_rotors(tmp_path: Path) -> None:
    out = tmp_path / "a.json"
    believed = str(EXAMPLES / "rotor_rcrm_paper.toml")
    arguments = ["--law", "reduced", "--law-rotor", believed, "--wrench", "196.2,0,0,0", "--json", str(out)]
    assert coaxlink("allocate", X8, *arguments) == 0
    assert json.loads(out.read_text())["error"][0] == pytest.approx(39.5, abs=0.2)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--law", "coaxial", "--wrench", "1,2,3"], "--wrench"),
        (["--law", "coaxial", "--wrench", "1,2,3,x"], "--wrench"),
        (["--law", "coaxial", "--wrench", "1,2,3,nan"], "--wrench"),
        (["--law", "coaxial"], "--wrench"),
        (["--law", "magic", "--wrench", "1,2,3,4"], "magic"),
        (["--rotor", "none.toml", "--wrench", "1,2,3,4"], "none.toml"),
    ],
)
def test_wrong_use_is_one_line_and_exit_2(
    arguments: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "a.json"
    assert coaxlink("allocate", X8, *arguments, "--json", str(out)) == 2
    stderr = capsys.readouterr().err
    assert says in stderr
    assert stderr.count("\n") == 1
    assert not out.exists()
