"""The loop ends in a better flight, where the table can hold the cure."""

import json

import pytest

from coaxlink.cli import build_app
from coaxlink.cli._shell import run

WEAK_ROTOR = '[[effects]]\nname = "degraded_rotor"\nsize = 0.3\nonset_s = 0.0\nrotor = 3\n'


@pytest.mark.timeout(300)
def test_a_weak_rotor_is_found_and_flown_around(tmp_path, capsys):
    truth, result = tmp_path / "truth.toml", tmp_path / "loop.json"
    truth.write_text(WEAK_ROTOR)
    arguments = ["loop", "--truth", str(truth), "--seed", "1", "--out", str(tmp_path / "loop")]
    assert run(build_app(), [*arguments, "--json", str(result), "--speed", "10"]) == 0
    loop = json.loads(result.read_text())
    assert [e["name"] for e in loop["effects"]] == ["degraded_rotor"]
    before, after = loop["before"], loop["after"]
    assert before.keys() == after.keys()
    assert after["thrust_error_N"] < 0.5 * before["thrust_error_N"]
    for axis in (0, 1):  # roll and pitch, which a weak rotor upsets
        assert after["torque_error_Nm"][axis] < 0.5 * before["torque_error_Nm"][axis]
    assert "degraded_rotor" in capsys.readouterr().out
    assert (tmp_path / "loop" / "report.html").is_file()


def test_a_truth_that_is_none_is_one_line(tmp_path, capsys):
    truth = tmp_path / "truth.toml"
    truth.write_text('[[effects]]\nname = "gremlins"\nsize = 1.0\n')
    assert run(build_app(), ["loop", "--truth", str(truth), "--out", str(tmp_path / "out")]) == 3
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert "did not start" in said and "effects[1].name" in said
