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
    for axis in range(3):  # a weak rotor upsets roll, pitch and yaw
        assert after["torque_error_Nm"][axis] < 0.5 * before["torque_error_Nm"][axis]
    for flight in (before, after):
        low, high = flight["thrust_ci_N"]
        assert low < flight["thrust_error_N"] < high
        assert all(
            a < e < b for (a, b), e in zip(flight["torque_ci_Nm"], flight["torque_error_Nm"], strict=True)
        )
        assert 0 < flight["floor"]["thrust_N"] < 0.6
    assert loop["way"] == "table"
    assert list(loop["compensated"]) == ["degraded_rotor"]
    assert loop["not_compensated"] == {}
    screen = capsys.readouterr()
    assert "compensated: degraded_rotor: rotor 3" in screen.out
    out = tmp_path / "loop"
    assert loop["log_after"] == str(out / "after.tlog")
    kept = {p.name for p in out.iterdir()}
    assert kept == {
        "after.tlog", "before.tlog", "backups", "report.html", "rotor.toml", "rotor_refined.toml", "tables",
    }  # fmt: skip
    page = (out / "report.html").read_text()
    assert "rotor 3 counts for" in page
    assert 'src="http' not in page
    assert "<link" not in page


def test_a_truth_that_is_none_is_one_line(tmp_path, capsys):
    truth = tmp_path / "truth.toml"
    truth.write_text('[[effects]]\nname = "gremlins"\nsize = 1.0\n')
    assert run(build_app(), ["loop", "--truth", str(truth), "--out", str(tmp_path / "out")]) == 3
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert "did not start" in said and "effects[1].name" in said
