"""Uploads against a scripted autopilot: what is on board afterwards is what counts."""

import os
import signal
import struct
from pathlib import Path

import pytest
from px4_board import params_text, x8
from pymavlink.dialects.v20 import common as m
from scripted_autopilot import ScriptedAutopilot

from coaxlink.errors import InputError, LinkError
from coaxlink.mavlink import connect
from coaxlink.mavlink.parameters import Parameters
from coaxlink.uploading.backup import read_backup
from coaxlink.uploading.journal import Journal
from coaxlink.uploading.outcome import Talk
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.worker import Uploader


@pytest.fixture
def board():
    with ScriptedAutopilot(x8()) as vehicle:
        yield vehicle


@pytest.fixture
def impatient(monkeypatch):
    """A vehicle that beats every 50 ms is missed sooner."""
    monkeypatch.setattr("coaxlink.mavlink.parameters.LOST_S", 0.6)
    monkeypatch.setattr("coaxlink.mavlink.parameters._BEAT_S", 0.1)


def _plan(tmp_path, **options):
    folder = tmp_path / "table"
    folder.mkdir(exist_ok=True)
    (folder / "x8.params").write_text(params_text(**options))
    return load_plan(folder)


def _upload(vehicle, plan, tmp_path, talk=None, patience_s=2.0, **options):
    with connect(vehicle.url) as session:
        worker = Uploader(
            session,
            backup_folder=tmp_path / "backups",
            talk=talk,
            patience_s=patience_s,
            parameters=Parameters(session, timeout_s=0.1),
        )
        return worker.upload(plan, **options)


def _f32(value):
    return struct.unpack("<f", struct.pack("<f", value))[0]


def _same(params, other):
    return {n: _f32(v) for n, (v, _) in params.items()} == {n: _f32(v) for n, (v, _) in other.items()}


def test_a_table_arrives_whole_and_everything_else_stays(board, tmp_path):
    before = dict(board.params)
    outcome = _upload(board, _plan(tmp_path), tmp_path)
    assert outcome.result == "verified" and outcome.reason == ""
    expected = before | {
        n: (v, t) for n, (v, t) in x8(46.98, 69.89, 0.04, 1.0).items() if n.split("_")[1] in _rotors(8)
    }
    expected |= {"THR_MDL_FAC": (1.0, 9), "MPC_THR_HOVER": (0.4, 9)}
    assert _same(board.params, expected)
    changed = {c["name"]: (c["old"], c["new"]) for c in outcome.to_json()["changed"]}
    assert changed["CA_ROTOR0_CT"] == (6.5, _f32(46.98)) and "CA_ROTOR0_PX" not in changed
    assert len(changed) == 8 * 2 + 2
    assert not Journal(_Identity).path.exists()


class _Identity:
    uid, system = f"{0xC0A1:016x}", 1


def _rotors(count):
    return {f"ROTOR{n}" for n in range(count)}


def test_the_backup_is_complete_and_goes_back(board, tmp_path):
    before = dict(board.params)
    outcome = _upload(board, _plan(tmp_path), tmp_path)
    saved = read_backup(next((tmp_path / "backups").iterdir()))
    assert outcome.backup == str(saved.path)
    assert set(saved.params) == set(before)
    assert (saved.board, saved.firmware) == (f"{0xC0A1:016x}", "PX4 1.16.1")
    assert not _same(board.params, before)
    with connect(board.url) as session:
        again = Uploader(session, backup_folder=tmp_path / "backups").restore(saved)
    assert again.result == "verified" and len(again.changed) == 18
    assert _same(board.params, before)


def test_a_backup_of_another_board_and_a_cut_one_are_refused(board, tmp_path):
    _upload(board, _plan(tmp_path), tmp_path)
    path = next((tmp_path / "backups").iterdir())
    with ScriptedAutopilot(x8(), uid=0xBEEF) as other, connect(other.url) as session:
        outcome = Uploader(session, backup_folder=tmp_path / "b").restore(read_backup(path))
        assert outcome.result == "refused" and "is of board" in outcome.reason and other.sets == []
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-3]))
    with pytest.raises(InputError, match="it was cut"):
        read_backup(path)


def test_a_second_upload_finds_nothing_to_do(board, tmp_path):
    _upload(board, _plan(tmp_path), tmp_path)
    count = len(board.sets)
    outcome = _upload(board, _plan(tmp_path), tmp_path)
    assert outcome.result == "verified" and outcome.changed == () and len(board.sets) == count


def test_a_dry_run_and_a_no_write_nothing(board, tmp_path):
    differences = []
    outcome = _upload(board, _plan(tmp_path), tmp_path, Talk(difference=differences.extend), dry_run=True)
    assert outcome.result == "dry_run" and len(differences) == 18 and not (tmp_path / "backups").exists()
    outcome = _upload(board, _plan(tmp_path), tmp_path, Talk(confirm=lambda: False))
    assert outcome.result == "refused" and "not confirmed" in outcome.reason
    assert board.sets == []


def test_new_geometry_can_be_meant(board, tmp_path):
    outcome = _upload(board, _plan(tmp_path, CA_ROTOR0_PX=-0.19), tmp_path, new_geometry=True)
    assert outcome.result == "verified"


def test_v1_13_takes_a_table_with_its_allocation_switched_on(board, tmp_path):
    board.version = (1, 13, 3)
    board.params["SYS_CTRL_ALLOC"] = (1, 6)
    assert _upload(board, _plan(tmp_path), tmp_path).result == "verified"


@pytest.mark.parametrize("fault", ["refuses", "keeps"])
def test_a_value_the_board_will_not_take_rolls_everything_back(board, tmp_path, fault):
    before = dict(board.params)
    board.refuses = {"CA_ROTOR7_KM"} if fault == "refuses" else set()
    board.keeps = {"CA_ROTOR7_KM": before["CA_ROTOR7_KM"][0]} if fault == "keeps" else {}
    if fault == "refuses":  # the way back must not be refused as well
        board.refuses = _Once({"CA_ROTOR7_KM"})
    outcome = _upload(board, _plan(tmp_path), tmp_path)
    assert outcome.result == "rolled_back" and "CA_ROTOR7_KM" in outcome.reason
    assert outcome.error.exit_code == 1
    assert _same(board.params, before)
    assert Journal(_Identity).open_entry() is None


class _Once(set):
    def __contains__(self, name):
        if set.__contains__(self, name):
            self.discard(name)
            return True
        return False


def test_a_lost_link_says_what_to_do_and_the_next_upload_knows_the_way_back(board, tmp_path, impatient):
    before = dict(board.params)
    board.mute_after = 7
    with connect(board.url) as session:
        worker = Uploader(
            session,
            backup_folder=tmp_path / "backups",
            patience_s=0.0,
            parameters=Parameters(session, timeout_s=0.02),
        )
        outcome = worker.upload(_plan(tmp_path))
    assert outcome.result == "failed" and "`restore` " in outcome.reason and outcome.backup in outcome.reason
    assert outcome.error.exit_code == 3
    assert not _same(board.params, before)  # the mixture that the journal is for
    entry = Journal(_Identity).open_entry()
    assert entry.backup == outcome.backup and entry.old.values["CA_ROTOR0_CT"].value == 6.5

    board.deaf, board.mute_after = False, None
    board.keeps = {"MPC_THR_HOVER": 0.5}  # this one fails too, and must go back to the table before both
    outcome = _upload(board, _plan(tmp_path), tmp_path)
    assert outcome.result == "rolled_back"
    assert _same(board.params, before)
    assert Journal(_Identity).open_entry() is None


def test_the_old_table_comes_back_when_the_link_does(board, tmp_path, impatient):
    before = dict(board.params)
    board.mute_after = 7
    said = []

    def say(text):
        said.append(text)
        if "putting the old table back" in text:
            board.mute_after, board.deaf = None, False

    with connect(board.url) as session:
        worker = Uploader(
            session,
            backup_folder=tmp_path,
            talk=Talk(say=say),
            parameters=Parameters(session, timeout_s=0.02),
        )
        outcome = worker.upload(_plan(tmp_path))
    assert outcome.result == "rolled_back" and isinstance(outcome.error, Exception)
    assert _same(board.params, before)


def test_another_writer_is_noticed(board, tmp_path):
    """Another station sets one of the table's values behind our back: written again, or rolled back."""
    original = board._set
    meddled = []

    def meddle(message):
        original(message)
        if len(board.sets) == 18:
            meddled.append(message.param_id)
            board.params["CA_ROTOR2_CT"] = (11.0, 9)

    board._set = meddle
    outcome = _upload(board, _plan(tmp_path), tmp_path)
    assert meddled and outcome.result == "verified"
    assert _f32(board.params["CA_ROTOR2_CT"][0]) == _f32(46.98)


def test_a_bad_line_costs_time_not_the_table(board, tmp_path):
    with connect(board.url) as session:
        board.loss = 0.2
        outcome = Uploader(session, backup_folder=tmp_path).upload(_plan(tmp_path))
    assert outcome.result == "verified" and outcome.retries > 0
    assert _f32(board.params["CA_ROTOR7_CT"][0]) == _f32(69.89)


def test_a_folder_without_one_table_is_named(tmp_path):
    with pytest.raises(InputError, match=r"no .params or .param file in it"):
        load_plan(tmp_path)
    for name in "ab":
        (tmp_path / f"{name}.params").write_text(params_text())
    with pytest.raises(InputError, match=r"2 tables"):
        load_plan(tmp_path)
    assert load_plan(tmp_path / "a.params").rotor_count == 8
    with pytest.raises(InputError, match="cannot be read"):
        load_plan(tmp_path / "none.params")
    assert LinkError("a", "b").exit_code == 3


def test_two_uploads_to_one_board_do_not_mix(board, tmp_path):
    with Journal(_Identity).alone():
        outcome = _upload(board, _plan(tmp_path), tmp_path)
    assert outcome.result == "refused" and "another upload to board" in outcome.reason
    assert board.sets == [] and outcome.error.exit_code == 4
    assert _upload(board, _plan(tmp_path), tmp_path).result == "verified"


def test_without_a_journal_nothing_is_written(board, tmp_path, monkeypatch):
    def full(self, entry):
        raise InputError(self.path, "", "cannot be written (No space left on device)")

    monkeypatch.setattr(Journal, "begin", full)
    outcome = _upload(board, _plan(tmp_path), tmp_path)
    assert outcome.result == "failed" and "No space left" in outcome.reason and board.sets == []


def test_a_nan_on_board_is_backed_up_and_never_sent(board, tmp_path):
    board.params["SENS_NONE"] = (float("nan"), 9)
    outcome = _upload(board, _plan(tmp_path), tmp_path)
    assert outcome.result == "verified"
    with connect(board.url) as session:
        back = Uploader(session, backup_folder=tmp_path / "b").restore(read_backup(tmp_path / outcome.backup))
    assert back.result == "verified" and "SENS_NONE" not in board.sets


def test_the_backup_of_an_interrupted_upload_is_the_last_whole_table(board, tmp_path, impatient):
    """Half a table on board, a journal of it: what is saved then, and goes back, is the table before both."""
    before = dict(board.params)
    board.mute_after = 7
    with connect(board.url) as session:
        quick = Parameters(session, timeout_s=0.02)
        worker = Uploader(session, backup_folder=tmp_path / "a", patience_s=0.0, parameters=quick)
        assert worker.upload(_plan(tmp_path)).result == "failed"
    board.deaf, board.mute_after = False, None
    assert not _same(board.params, before)
    assert _upload(board, _plan(tmp_path), tmp_path).result == "verified"
    (saved,) = (tmp_path / "backups").iterdir()
    with connect(board.url) as session:
        back = Uploader(session, backup_folder=tmp_path / "b").restore(read_backup(saved))
    assert back.result == "verified" and _same(board.params, before)


def test_a_parameter_that_the_list_leaves_out_is_asked_for_by_name(board, tmp_path):
    """ArduPilot hides SCR_* while scripting is off; PX4 what it does not use."""
    hidden, handle = "CA_ROTOR7_CT", board._handle

    def hide(message):
        known = board.params.pop(hidden) if message.get_type() == "PARAM_REQUEST_LIST" else None
        handle(message)
        if known is not None:
            board.params[hidden] = known

    board._handle = hide
    outcome = _upload(board, _plan(tmp_path), tmp_path)
    assert outcome.result == "verified", outcome.reason
    assert _f32(board.params[hidden][0]) == _f32(69.89)


def test_a_board_that_is_not_known_by_its_id_is_asked_again(board, tmp_path):
    """The first requests for it were lost: a journal under another name would never be found again."""
    answer, requests = board._send_version, []

    def late():
        requests.append(1)
        if len(requests) > 7:
            answer()

    board._send_version = late
    outcome = _upload(board, _plan(tmp_path), tmp_path)
    assert outcome.result == "verified" and len(requests) > 7
    assert Journal(_Identity).last() is not None


def test_power_lost_before_the_board_saved_is_seen(board, tmp_path):
    """It comes back with what it had, and then accepts to save that: what was read before is worthless."""
    old = dict(board.params)
    handle, cuts = board._handle, []

    def lose_power(message):
        if (
            message.get_type() == "COMMAND_LONG"
            and message.command == m.MAV_CMD_PREFLIGHT_STORAGE
            and not cuts
        ):
            cuts.append(len(board.sets))
            board.params = dict(old)
        handle(message)

    board._handle = lose_power
    outcome = _upload(board, _plan(tmp_path), tmp_path)
    assert cuts == [18] and outcome.result == "verified"
    assert board.params["CA_ROTOR0_CT"][0] == pytest.approx(46.98) and len(board.sets) == 36


def test_a_board_that_is_busy_saving_is_asked_again_and_one_that_cannot_is_waited_for(
    board, tmp_path, monkeypatch
):
    monkeypatch.setattr("coaxlink.uploading.board_px4._AUTOSAVE_S", 0.3)
    answers = [m.MAV_RESULT_ACCEPTED, m.MAV_RESULT_TEMPORARILY_REJECTED, m.MAV_RESULT_ACCEPTED]
    board.storage = lambda: answers.pop(0)
    assert _upload(board, _plan(tmp_path), tmp_path).result == "verified" and answers == []
    board.storage, said = lambda: m.MAV_RESULT_UNSUPPORTED, []
    outcome = _upload(board, _plan(tmp_path, MPC_THR_HOVER=0.41), tmp_path, Talk(say=said.append))
    assert outcome.result == "verified" and any("does not save on request" in text for text in said)


def _upload_in_a_child(board, plan, tmp_path):
    """Fork: the child uploads and ends without a word; its process id."""
    pid = os.fork()
    if not pid:
        try:
            _upload(board, plan, tmp_path)
        finally:
            os._exit(0)
    return pid


@pytest.mark.parametrize("first", [1, 2, 3])
def test_killed_after_each_write_the_next_call_makes_it_whole(board, tmp_path, first):
    """SIGKILL once n of 18 values are on board, for every n; then the same table, another, or the backup."""
    plan, other = _plan(tmp_path), tmp_path / "other"
    other.mkdir()
    (other / "x8.params").write_text(params_text(ct_upper=50.0, ct_lower=60.0))
    before = dict(board.params)
    for n in range(first, 19, 3):
        board.params, board.sets, board.after_set = dict(before), [], {}
        pid = _upload_in_a_child(board, plan, tmp_path)
        board.after_set = {n: lambda pid=pid: os.kill(pid, signal.SIGKILL)}
        assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == -signal.SIGKILL
        entry = Journal(_Identity).open_entry()
        assert entry is not None and entry.old.values["CA_ROTOR0_CT"].value == 6.5
        way = n % 3
        if way == 0:
            with connect(board.url) as session:
                back = Uploader(session, backup_folder=tmp_path / "b").restore(
                    read_backup(Path(entry.backup))
                )
            assert back.result == "verified" and _same(board.params, before)
        else:
            wanted = plan if way == 1 else load_plan(other)
            assert _upload(board, wanted, tmp_path).result == "verified"
            held = {name: _f32(board.params[name][0]) for name in wanted.params}
            assert held == {name: _f32(v) for name, v in wanted.params.items()}
            rest = {name: v for name, v in board.params.items() if name not in wanted.params}
            assert _same(rest, {name: v for name, v in before.items() if name not in wanted.params})
        assert Journal(_Identity).open_entry() is None


def test_what_forbids_nothing_is_still_said(board, tmp_path):
    """A motor that no output drives, a firmware newer than was ever looked at."""
    board.params |= {f"PWM_MAIN_FUNC{n}": (100 + n if n != 7 else 0, 6) for n in range(1, 9)}
    board.version, said = (1, 18, 0), []
    assert _upload(board, _plan(tmp_path), tmp_path, Talk(say=said.append)).result == "verified"
    assert any("PX4 1.18.0 drops of a table is only known up to 1.17" in text for text in said)
    assert any("no output of this board drives rotor 7 (" in text for text in said)
    board.params["PWM_MAIN_FUNC7"], board.version, said = (107, 6), (1, 17, 2), []
    assert _upload(board, _plan(tmp_path), tmp_path, Talk(say=said.append)).result == "verified"
    assert not any("drives motor" in text or "only known" in text for text in said)
