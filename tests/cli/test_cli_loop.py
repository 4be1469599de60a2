"""The loop ends in a better flight, where the table can hold the cure."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run
from coaxlink.fly import trajectory

WEAK_ROTOR = '[[effects]]\nname = "degraded_rotor"\nsize = 0.3\nonset_s = 0.0\nrotor = 3\n'


@pytest.mark.slow
def test_a_weak_rotor_is_found_and_flown_around(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(trajectory, "paper_flight", trajectory.mixer_flight)  # half as long
    truth, result = tmp_path / "truth.toml", tmp_path / "loop.json"
    truth.write_text(WEAK_ROTOR)
    arguments = ["loop", "--truth", str(truth), "--seed", "1", "--out", str(tmp_path / "loop")]
    assert run(build_app(), [*arguments, "--json", str(result), "--speed", "20"]) == 0
    loop = json.loads(result.read_text())
    assert [e["name"] for e in loop["effects"]] == ["degraded_rotor"]
    before, after = loop["before"], loop["after"]
    assert before.keys() == after.keys()
    assert after["thrust_error_N"] < 0.5 * before["thrust_error_N"]
    for axis in range(3):  # a weak rotor upsets roll, pitch and yaw
        assert after["torque_error_Nm"][axis] < 0.5 * before["torque_error_Nm"][axis]
    for flight in (before, after):
        low, high = flight["thrust_ci_N"]
        assert low < flight["thrust_error_N"] < high and 0 < flight["floor"]["thrust_N"] < 0.6
    assert loop["way"] == "table"
    assert list(loop["compensated"]) == ["degraded_rotor"]
    assert loop["not_compensated"] == {}
    screen = capsys.readouterr()
    assert "compensated: degraded_rotor: rotor 3" in screen.out
    out = tmp_path / "loop"
    assert loop["log_after"] == str(out / "after.tlog")
    names = {p.name for p in out.iterdir()}
    assert names == {
        "after.tlog", "before.tlog", "backups", "report.html", "rotor.toml", "rotor_refined.toml", "tables",
    }  # fmt: skip
    page = (out / "report.html").read_text()
    assert "rotor 3 counts for" in page
    assert 'src="http' not in page
    assert "<link" not in page


def test_a_truth_that_is_none_is_one_line(tmp_path, capsys):
    truth = tmp_path / "truth.toml"
    truth.write_text('[[effects]]\nname = "gremlins"\nsize = 1.0\n')
    assert run(build_app(), ["loop", "--truth", str(truth), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1 and str(truth) in said[0] and "effects[1].name" in said[0]
    assert not (tmp_path / "out").exists()


def children(pid):
    """Processes whose parent is `pid`."""
    found = subprocess.run(["ps", "-o", "pid=", "--ppid", str(pid)], capture_output=True, text=True)
    return [int(n) for n in found.stdout.split()]


@pytest.mark.slow
def test_a_terminated_loop_leaves_the_folder_and_no_child(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "report.html").write_text("the one before")
    verb = [sys.executable, "-m", "coaxlink", "loop", "--seed", "1", "--out", str(out)]
    process = subprocess.Popen(verb, stderr=subprocess.PIPE, text=True, start_new_session=True)
    end = time.monotonic() + 600.0
    while process.poll() is None and not (out / "before.tlog").exists() and time.monotonic() < end:
        time.sleep(0.1)
    worlds = children(process.pid)
    assert worlds and (out / "tables").exists()
    process.send_signal(signal.SIGTERM)  # as Ctrl-C, which test_cli_campaign sends
    _, said = process.communicate(timeout=600)
    assert process.returncode == 130 and said.strip().endswith("coaxlink: interrupted")
    assert [p.name for p in out.iterdir()] == ["report.html"]
    assert (out / "report.html").read_text() == "the one before"
    for world in worlds:
        with pytest.raises(ProcessLookupError):
            os.kill(world, 0)
