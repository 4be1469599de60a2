"""The loop ends in a better flight, where the table can hold the cure."""

import os
import signal
import subprocess
import sys
import time

import pytest

from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run

WEAK_ROTOR = '[[effects]]\nname = "degraded_rotor"\nsize = 0.3\nonset_s = 0.0\nrotor = 3\n'


def test_a_truth_that_is_none_is_one_line(tmp_path, capsys):
    truth = tmp_path / "truth.toml"
    truth.write_text('[[effects]]\nname = "gremlins"\nsize = 1.0\n')
    assert run(build_app(), ["loop", "--truth", str(truth), "--out", str(tmp_path / "out")]) == 2
    reported = capsys.readouterr().err.strip().splitlines()
    assert len(reported) == 1 and str(truth) in reported[0] and "effects[1].name" in reported[0]
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
    _, reported = process.communicate(timeout=600)
    assert process.returncode == 130 and reported.strip().endswith("coaxlink: interrupted")
    assert [p.name for p in out.iterdir()] == ["report.html"]
    assert (out / "report.html").read_text() == "the one before"
    for world in worlds:
        with pytest.raises(ProcessLookupError):
            os.kill(world, 0)
