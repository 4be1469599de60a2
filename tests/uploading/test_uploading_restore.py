"""What a restore puts back, what it leaves, and what it says of a board that refuses; PX4, scripted."""

import struct
from pathlib import Path

import pytest
from memory_net import Net, meet
from px4_board import params_text, x8
from scripted_autopilot import FLOAT, INT32, ScriptedAutopilot

from coaxlink.errors import InputError
from coaxlink.uploading.backup import read_backup
from coaxlink.uploading.journal import Journal
from coaxlink.uploading.outcome import Talk
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.verify import verify
from coaxlink.uploading.worker import Uploader

OTHERS = {
    "CAL_GYRO0_XOFF": (0.001, FLOAT),
    "COM_FLIGHT_UUID": (41, INT32),
    "LND_FLIGHT_T_LO": (1000, INT32),
    "MC_ROLLRATE_K": (1.0, FLOAT),
    "MPC_XY_CRUISE": (5.0, FLOAT),
    "SDLOG_PROFILE": (1, INT32),
}


@pytest.fixture
def board():
    with ScriptedAutopilot(x8() | OTHERS, net=Net()) as vehicle:
        vehicle.param_errors = True
        yield vehicle


def _worker(session, tmp_path, talk=None):
    return Uploader(session, backup_folder=tmp_path / "b", talk=talk, patience_s=1.0)


def _upload(board, tmp_path, **options):
    folder = tmp_path / "t"
    folder.mkdir(exist_ok=True)
    (folder / "x8.params").write_text(params_text(**options))
    with meet(board) as session:
        outcome = _worker(session, tmp_path).upload(load_plan(folder))
    assert outcome.result == "verified", outcome.reason
    return Path(outcome.backup)


def _restore(board, path, tmp_path, **options):
    reported = []
    with meet(board) as session:
        return _worker(session, tmp_path, Talk(say=reported.append)).restore(
            read_backup(path), **options
        ), reported


def _held(board, *names):
    bits = {n: struct.pack("<f", v) for n, (v, _) in board.params.items()}
    return {n: bits[n] for n in names or bits}


def _set(board, name, value):
    board.params[name] = (value, board.params[name][1])


def test_an_undo_is_of_the_upload_and_leaves_what_came_since(board, tmp_path):
    before = _held(board)
    path = _upload(board, tmp_path)
    for name, value in (("MPC_XY_CRUISE", 7.0), ("COM_FLIGHT_UUID", 42), ("CAL_GYRO0_XOFF", 0.002)):
        _set(board, name, value)
    board.sets = []
    outcome, reported = _restore(board, path, tmp_path)
    assert outcome.result == "verified" and outcome.error is None
    table = set(before) - set(OTHERS) - {"SYS_AUTOSTART", "MC_AIRMODE"}
    assert set(board.sets) == {c.name for c in outcome.changed} <= table
    assert _held(board, *table) == {n: before[n] for n in table}
    assert board.params["MPC_XY_CRUISE"][0] == 7.0 and board.params["COM_FLIGHT_UUID"][0] == 42
    assert any("3 other parameters differ" in text for text in reported)


def test_what_a_later_upload_wrote_besides_goes_back_with_it(board, tmp_path):
    """Three tables, the second with a gain of its own: the undo of the first undoes that gain too."""
    first = _upload(board, tmp_path)
    _upload(board, tmp_path, ct_upper=40.0, MC_ROLLRATE_K=1.5)
    _upload(board, tmp_path, ct_upper=42.0)
    assert _restore(board, first, tmp_path)[0].result == "verified"
    assert board.params["MC_ROLLRATE_K"][0] == 1.0 and board.params["CA_ROTOR0_CT"][0] == 6.5


def test_a_backup_that_notes_nothing_puts_back_what_a_table_can_hold(board, tmp_path, monkeypatch):
    monkeypatch.setattr("coaxlink.uploading.backup.Note.lines", lambda note: [])  # as older ones were written
    path = _upload(board, tmp_path)
    monkeypatch.undo()
    assert "Table:" not in path.read_text()
    monkeypatch.setenv("COAXLINK_STATE", str(tmp_path / "another computer"))
    _set(board, "MPC_XY_CRUISE", 7.0)
    outcome, reported = _restore(board, path, tmp_path)
    assert outcome.result == "verified" and board.params["MPC_XY_CRUISE"][0] == 7.0
    assert board.params["CA_ROTOR7_CT"][0] == 6.5
    assert any("does not say what was uploaded" in text for text in reported)


def test_the_note_cannot_be_changed_in_silence(board, tmp_path):
    path = _upload(board, tmp_path)
    text = path.read_text()
    path.write_text(text.replace("# Table: CA_AIRFRAME ", "# Table: "))
    with pytest.raises(InputError, match="changed since it was written"):
        read_backup(path)
    path.write_text("\n".join(line for line in text.splitlines() if "# Table:" not in line) + "\n")
    with pytest.raises(InputError, match="changed since it was written"):
        read_backup(path)


def test_all_puts_the_rest_back_but_what_the_board_owns(board, tmp_path):
    path = _upload(board, tmp_path)
    for name, value in (
        ("MPC_XY_CRUISE", 7.0),
        ("COM_FLIGHT_UUID", 42),
        ("LND_FLIGHT_T_LO", 9000),
        ("CAL_GYRO0_XOFF", 0.002),
    ):
        _set(board, name, value)
    outcome, reported = _restore(board, path, tmp_path, everything=True)
    assert outcome.result == "verified" and board.params["MPC_XY_CRUISE"][0] == 5.0
    assert dict(outcome.left_out) == {
        "CAL_GYRO0_XOFF": "learned",
        "COM_FLIGHT_UUID": "counter",
        "LND_FLIGHT_T_LO": "counter",
    }
    assert board.params["COM_FLIGHT_UUID"][0] == 42 and "COM_FLIGHT_UUID" not in board.sets
    assert {row["name"] for row in outcome.to_json()["left_out"]} == set(outcome.left_out)
    assert any("COM_FLIGHT_UUID (counter)" in text for text in reported)
    with meet(board) as session:
        assert set(Journal(session.identity, address=session.address).last().values) < set(
            x8()
        )  # `verify` is of the table


@pytest.mark.parametrize("how", ["refuses", "keeps"])
def test_all_goes_on_past_what_the_board_refuses_of_the_rest(board, tmp_path, how):
    """By PARAM_ERROR, or as ArduPilot 4.6 does: by saying the value it has."""
    path = _upload(board, tmp_path)
    _set(board, "MPC_XY_CRUISE", 7.0)
    _set(board, "SDLOG_PROFILE", 5)
    setattr(board, how, {"MPC_XY_CRUISE"} if how == "refuses" else {"MPC_XY_CRUISE": 7.0})
    outcome, reported = _restore(board, path, tmp_path, everything=True)
    assert outcome.result == "incomplete" and outcome.error.exit_code == 1
    assert "MPC_XY_CRUISE" in str(outcome.error) and list(outcome.passed_over) == ["MPC_XY_CRUISE"]
    assert outcome.to_json()["passed_over"][0]["why"] == ("read only" if how == "refuses" else "keeps 7")
    assert board.params["SDLOG_PROFILE"][0] == 1 and board.params["CA_ROTOR3_CT"][0] == 6.5
    assert any("passed over" in text for text in reported)
    with meet(board) as session:
        assert Journal(session.identity, address=session.address).open_entry() is None


def test_what_the_board_refuses_of_the_table_undoes_it_all(board, tmp_path):
    path = _upload(board, tmp_path)
    _set(board, "SDLOG_PROFILE", 5)
    table = _held(board)
    board.keeps = {"CA_ROTOR5_CT": board.params["CA_ROTOR5_CT"][0]}
    outcome, _ = _restore(board, path, tmp_path, everything=True)
    assert outcome.result == "rolled_back" and "CA_ROTOR5_CT" in outcome.reason
    assert _held(board) == table


def test_an_interrupted_restore_of_all_is_finished_past_a_refusal(board, tmp_path):
    """The journal remembers which names the board may refuse."""
    path = _upload(board, tmp_path)
    table = _held(board)
    _set(board, "MPC_XY_CRUISE", 7.0)
    board.refuses, board.arm_after = {"MPC_XY_CRUISE"}, 1
    outcome, _ = _restore(board, path, tmp_path, everything=True)
    assert outcome.result == "failed" and outcome.standing["new"]
    board.armed = False
    with meet(board) as session:
        again = _worker(session, tmp_path).upload(load_plan(tmp_path / "t"))
    assert again.result == "verified", again.reason
    assert _held(board) == table | _held(board, "MPC_XY_CRUISE")


def test_verify_does_not_take_a_table_s_value_for_learned_on_px4(board, tmp_path):
    """PX4's estimator keeps its hover thrust to itself: another MPC_THR_HOVER is somebody's doing."""
    _upload(board, tmp_path)
    _set(board, "MPC_THR_HOVER", 0.42)
    with meet(board) as session:
        result = verify(session, None)
    assert not result.holds and [w["name"] for w in result.mismatches] == ["MPC_THR_HOVER"]
    assert result.learned == ()
