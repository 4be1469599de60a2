"""`coaxlink upload`, `restore` and `verify` as a user runs them, against a scripted autopilot."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from px4_board import x8
from scripted_autopilot import ScriptedAutopilot
from verb import run as _run

pytestmark = pytest.mark.usefixtures("here")


@pytest.fixture
def real_board():
    """On a port, for verbs in a process of their own."""
    with ScriptedAutopilot(x8()) as vehicle:
        yield vehicle


def test_upload_then_restore(board, capsys):
    before = dict(board.params)
    code, out, _ = _run(capsys, "upload", "t", "--connect", board.url, "--yes", "--json", "u.json")
    assert code == 0 and "CA_ROTOR0_CT" in out and "verified: 18 parameters" in out
    result = json.loads(Path("u.json").read_text())
    assert result["result"] == "verified" and len(result["changed"]) == 18 and result["mismatches"] == []
    assert set(result) >= {"result", "changed", "files", "backup", "mismatches", "retries"}
    assert Path(result["backup"]).is_file() and result["files"] == ["t/x8.params"]
    code, out, err = _run(capsys, "restore", result["backup"], "--connect", board.url, "--yes")
    assert code == 0 and "verified" in out and "PX4 1.16.1" in err
    assert board.params == {n: (pytest.approx(v), kind) for n, (v, kind) in before.items()}


def test_dry_run_shows_and_writes_nothing(board, capsys):
    code, out, _ = _run(capsys, "upload", "t", "--connect", board.url, "--dry-run", "--json", "u.json")
    assert code == 0 and "CA_ROTOR0_CT" in out and "18 parameters would change" in out
    assert board.sets == [] and json.loads(Path("u.json").read_text())["result"] == "dry_run"


@pytest.mark.slow
def test_nobody_to_ask_means_no(real_board):
    board = real_board
    command = [sys.executable, "-m", "coaxlink", "upload", "t", "--connect", board.url]
    ended = subprocess.run(
        command, input="", capture_output=True, text=True, env=os.environ.copy(), timeout=600
    )
    assert ended.returncode == 4 and "not confirmed" in ended.stderr and board.sets == []
    ended = subprocess.run(
        command, input="y\n", capture_output=True, text=True, env=os.environ.copy(), timeout=600
    )
    assert ended.returncode == 0 and len(board.sets) == 18


def test_verify_knows_the_last_upload_and_a_change_since(board, capsys):
    assert _run(capsys, "upload", "t", "--connect", board.url, "--yes")[0] == 0
    assert _run(capsys, "verify", "t", "--connect", board.url)[0] == 0
    code, out, _ = _run(capsys, "verify", "--connect", board.url)
    assert code == 0 and "verified: 69 values" in out
    board.params["CA_ROTOR2_CT"] = (47.0, 9)
    board.hash = 0x9999
    code, out, err = _run(capsys, "verify", "--connect", board.url, "--json", "v.json")
    assert code == 1 and "CA_ROTOR2_CT: 46.9799995 expected, 47 on board" in out and "1 of 69" in err
    shown = json.loads(Path("v.json").read_text())
    assert shown["result"] == "failed" and shown["other_parameters_changed"]
    assert shown["mismatches"] == [{"name": "CA_ROTOR2_CT", "wanted": pytest.approx(46.98), "found": 47.0}]


@pytest.mark.slow
def test_a_killed_upload_is_seen_by_verify_and_ended_by_the_next(real_board, capsys, tmp_path):
    """kill -9 while writing: the journal stays, verify says no, restore brings the old table back."""
    board = real_board
    before = dict(board.params)
    board.after_set = {9: board.close_ears}
    command = [sys.executable, "-m", "coaxlink", "upload", "t", "--connect", board.url, "--yes"]
    process = subprocess.Popen(
        command, env=os.environ.copy(), stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    )
    assert board.ears_closed.wait(30)
    process.kill()
    process.wait()
    board.deaf = False
    assert any(board.params[n] != v for n, v in before.items())
    code, _, err = _run(capsys, "verify", "t", "--connect", board.url)
    assert code == 1 and "did not end" in err
    (backup,) = (tmp_path / "backups").iterdir()
    code, _, err = _run(capsys, "restore", backup, "--connect", board.url, "--yes")
    assert code == 0 and "did not end" in err
    assert board.params == {n: (pytest.approx(v), kind) for n, (v, kind) in before.items()}
    code, _, err = _run(capsys, "upload", "t", "--connect", board.url, "--yes")
    assert code == 0 and "did not end" not in err
    assert _run(capsys, "verify", "t", "--connect", board.url)[0] == 0


@pytest.mark.slow
@pytest.mark.parametrize("lower, asked", [(0.3, True), (1.0, False)])
def test_a_yaw_gain_that_changes_by_more_than_a_fifth_is_asked_about(tmp_path, capsys, lower, asked):
    """The paper's standard table on a board whose KM makes yaw another: 1.48 times the moment."""
    x8_file = str(Path(__file__).parents[2] / "examples" / "x8_paper.toml")
    made = ("--firmware", "px4", "--law", "standard", "--out", "made")
    assert _run(capsys, "table", x8_file, *made)[0] == 0
    rows = [r.split("\t") for r in Path("made/paper-x8.params").read_text().splitlines() if r[0] != "#"]
    written = {name: float(value) for _, _, name, value, _ in rows}
    held = {n: ((int if kind == 6 else float)(written.get(n, v)), kind) for n, (v, kind) in x8().items()}
    for n in range(4, 8):  # the lower rotors' torque as another law had it
        km, kind = held[f"CA_ROTOR{n}_KM"]
        held[f"CA_ROTOR{n}_KM"] = (km * lower, kind)
    with ScriptedAutopilot(held) as board:
        _, _, err = _run(capsys, "upload", "made", "--connect", board.url, "--dry-run")
    assert ("a demand of yaw will give" in err) is asked
