"""Uploads against a scripted autopilot: what is on board afterwards is what counts."""

import struct
from pathlib import Path

import pytest
from memory_net import Net, meet
from px4_board import params_text, x8
from pymavlink.dialects.v20 import common as m
from scripted_autopilot import ScriptedAutopilot

from coaxlink.errors import InputError
from coaxlink.uploading.backup import read_backup
from coaxlink.uploading.journal import Journal
from coaxlink.uploading.outcome import Talk
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.worker import Uploader


class _Identity:
    uid, system = f"{0xC0A1:016x}", 1


def _upload(vehicle, plan, tmp_path, talk=None, patience_s=2.0, session=None, **options):
    with session or meet(vehicle) as session:
        worker = Uploader(session, backup_folder=tmp_path / "backups", talk=talk, patience_s=patience_s)
        return worker.upload(plan, **options)


def _restore(vehicle, path, tmp_path):
    with meet(vehicle) as session:
        return Uploader(session, backup_folder=tmp_path / "b").restore(read_backup(Path(path)))


def _f32(value):
    return struct.unpack("<f", struct.pack("<f", value))[0]


def _same(params, other):
    return {n: _f32(v) for n, (v, _) in params.items()} == {n: _f32(v) for n, (v, _) in other.items()}


def test_a_table_arrives_whole_and_everything_else_stays(board, plan_of, tmp_path):
    before = dict(board.params)
    outcome = _upload(board, plan_of(), tmp_path)
    assert outcome.result == "verified" and outcome.reason == ""
    rotors = {f"ROTOR{n}" for n in range(8)}
    expected = before | {
        n: (v, t) for n, (v, t) in x8(46.98, 69.89, 0.04, 1.0).items() if n.split("_")[1] in rotors
    }
    expected |= {"THR_MDL_FAC": (1.0, 9), "MPC_THR_HOVER": (0.4, 9)}
    assert _same(board.params, expected)
    changed = {c["name"]: (c["old"], c["new"]) for c in outcome.to_json()["changed"]}
    assert changed["CA_ROTOR0_CT"] == (6.5, _f32(46.98)) and "CA_ROTOR0_PX" not in changed
    assert len(changed) == 8 * 2 + 2
    assert not Journal(_Identity).path.exists()


def test_the_backup_is_complete_and_goes_back_to_its_own_board(board, plan_of, tmp_path):
    before = dict(board.params)
    outcome = _upload(board, plan_of(), tmp_path)
    (path,) = (tmp_path / "backups").iterdir()
    saved = read_backup(path)
    assert outcome.backup == str(path) and set(saved.params) == set(before)
    assert (saved.board, saved.firmware) == (f"{0xC0A1:016x}", "PX4 1.16.1")
    with ScriptedAutopilot(x8(), net=Net(), uid=0xBEEF) as other:
        refused = _restore(other, path, tmp_path)
        assert refused.result == "refused" and "is of board" in refused.reason and other.sets == []
    assert not _same(board.params, before)
    again = _restore(board, path, tmp_path)
    assert again.result == "verified" and len(again.changed) == 18
    assert _same(board.params, before)
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-3]))
    with pytest.raises(InputError, match="it was cut"):
        read_backup(path)


def test_a_second_upload_a_dry_run_and_a_no_write_nothing(board, plan_of, tmp_path):
    differences = []
    outcome = _upload(board, plan_of(), tmp_path, Talk(difference=differences.extend), dry_run=True)
    assert outcome.result == "dry_run" and len(differences) == 18 and not (tmp_path / "backups").exists()
    outcome = _upload(board, plan_of(), tmp_path, Talk(confirm=lambda: False))
    assert outcome.result == "refused" and "not confirmed" in outcome.reason
    assert board.sets == []
    _upload(board, plan_of(), tmp_path)
    count = len(board.sets)
    outcome = _upload(board, plan_of(), tmp_path)
    assert outcome.result == "verified" and outcome.changed == () and len(board.sets) == count


def test_new_geometry_can_be_meant(board, plan_of, tmp_path):
    moved = plan_of(CA_ROTOR0_PX=-0.19)
    assert _upload(board, moved, tmp_path).result == "refused"
    assert _upload(board, moved, tmp_path, new_geometry=True).result == "verified"


def test_v1_13_takes_a_table_with_its_allocation_switched_on(board, plan_of, tmp_path):
    board.version = (1, 13, 3)
    board.params["SYS_CTRL_ALLOC"] = (0, 6)
    assert _upload(board, plan_of(), tmp_path).result == "refused"
    board.params["SYS_CTRL_ALLOC"] = (1, 6)
    assert _upload(board, plan_of(), tmp_path).result == "verified"


class _Once(set):
    def __contains__(self, name):
        found = set.__contains__(self, name)
        self.discard(name)
        return found


@pytest.mark.parametrize("fault", ["refuses", "keeps"])
def test_a_value_the_board_will_not_take_rolls_everything_back(board, plan_of, tmp_path, fault):
    before = dict(board.params)
    if fault == "refuses":  # the way back must not be refused as well
        board.refuses = _Once({"CA_ROTOR7_KM"})
    else:
        board.keeps = {"CA_ROTOR7_KM": before["CA_ROTOR7_KM"][0]}
    outcome = _upload(board, plan_of(), tmp_path)
    assert outcome.result == "rolled_back" and "CA_ROTOR7_KM" in outcome.reason
    assert outcome.error.exit_code == 1
    assert _same(board.params, before)
    assert Journal(_Identity).open_entry() is None


def test_a_lost_link_says_what_to_do_and_the_next_upload_knows_the_way_back(board, plan_of, tmp_path):
    before = dict(board.params)
    board.mute_after = 7
    outcome = _upload(board, plan_of(), tmp_path)
    assert outcome.result == "failed" and "`restore` " in outcome.reason and outcome.backup in outcome.reason
    assert outcome.error.exit_code == 3
    assert not _same(board.params, before)  # the mixture that the journal is for
    entry = Journal(_Identity).open_entry()
    assert entry.backup == outcome.backup and entry.old.values["CA_ROTOR0_CT"].value == 6.5

    board.deaf, board.mute_after = False, None
    board.keeps = {"MPC_THR_HOVER": 0.5}  # this one fails too, and must go back to the table before both
    assert _upload(board, plan_of(), tmp_path).result == "rolled_back"
    assert _same(board.params, before)
    assert Journal(_Identity).open_entry() is None


def test_the_backup_of_an_interrupted_upload_is_the_last_whole_table(board, plan_of, tmp_path):
    """Half a table on board, a journal of it: what is saved then, and goes back, is the table before both."""
    before = dict(board.params)
    board.mute_after = 7
    assert _upload(board, plan_of(), tmp_path / "first").result == "failed"
    board.deaf, board.mute_after = False, None
    assert not _same(board.params, before)
    assert _upload(board, plan_of(), tmp_path).result == "verified"
    (saved,) = (tmp_path / "backups").iterdir()
    assert _restore(board, saved, tmp_path).result == "verified" and _same(board.params, before)


def test_the_old_table_comes_back_when_the_link_does(board, plan_of, tmp_path):
    before = dict(board.params)
    board.mute_after = 7

    def say(text):
        if "putting the old table back" in text:
            board.mute_after, board.deaf = None, False

    outcome = _upload(board, plan_of(), tmp_path, Talk(say=say), patience_s=30.0)
    assert outcome.result == "rolled_back" and isinstance(outcome.error, Exception)
    assert _same(board.params, before)


def test_another_writer_is_noticed(board, plan_of, tmp_path):
    """Another station sets one of the table's values behind our back: written again."""
    board.after_set[18] = lambda: board.params.update(CA_ROTOR2_CT=(11.0, 9))
    outcome = _upload(board, plan_of(), tmp_path)
    assert len(board.sets) > 18 and outcome.result == "verified"
    assert _f32(board.params["CA_ROTOR2_CT"][0]) == _f32(46.98)


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


def test_two_uploads_to_one_board_do_not_mix(board, plan_of, tmp_path):
    with Journal(_Identity).alone():
        outcome = _upload(board, plan_of(), tmp_path)
    assert outcome.result == "refused" and "another upload to board" in outcome.reason
    assert board.sets == [] and outcome.error.exit_code == 4
    assert _upload(board, plan_of(), tmp_path).result == "verified"


def test_without_a_journal_nothing_is_written(board, plan_of, tmp_path, monkeypatch):
    def full(self, entry):
        raise InputError(self.path, "", "cannot be written (No space left on device)")

    monkeypatch.setattr(Journal, "begin", full)
    outcome = _upload(board, plan_of(), tmp_path)
    assert outcome.result == "failed" and "No space left" in outcome.reason and board.sets == []


def test_a_nan_on_board_is_backed_up_and_never_sent(board, plan_of, tmp_path):
    board.params["SENS_NONE"] = (float("nan"), 9)
    outcome = _upload(board, plan_of(), tmp_path)
    assert outcome.result == "verified"
    assert _restore(board, outcome.backup, tmp_path).result == "verified" and "SENS_NONE" not in board.sets


def test_a_parameter_that_the_list_leaves_out_is_asked_for_by_name(board, plan_of, tmp_path):
    """ArduPilot hides SCR_* while scripting is off; PX4 what it does not use."""
    hidden, handle = "CA_ROTOR7_CT", board._handle

    def hide(message):
        known = board.params.pop(hidden) if message.get_type() == "PARAM_REQUEST_LIST" else None
        handle(message)
        if known is not None:
            board.params[hidden] = known

    board._handle = hide
    outcome = _upload(board, plan_of(), tmp_path)
    assert outcome.result == "verified", outcome.reason
    assert _f32(board.params[hidden][0]) == _f32(69.89)


def test_a_board_that_is_not_known_by_its_id_is_asked_again(board, plan_of, tmp_path):
    """The first requests for it were lost: a journal under another name would never be found again."""
    answer, requests = board._send_version, []

    def late():
        requests.append(1)
        if len(requests) > 7:
            answer()

    board._send_version = late
    assert _upload(board, plan_of(), tmp_path).result == "verified" and len(requests) > 7
    assert Journal(_Identity).last() is not None


def test_power_lost_before_the_board_saved_is_seen(board, plan_of, tmp_path):
    """It comes back with what it had, and then accepts to save that: what was read before is worthless."""
    old, handle, cuts = dict(board.params), board._handle, []

    def lose_power(message):
        saves = message.get_type() == "COMMAND_LONG" and message.command == m.MAV_CMD_PREFLIGHT_STORAGE
        if saves and not cuts:
            cuts.append(len(board.sets))
            board.params = dict(old)
        handle(message)

    board._handle = lose_power
    outcome = _upload(board, plan_of(), tmp_path)
    assert cuts == [18] and outcome.result == "verified"
    assert board.params["CA_ROTOR0_CT"][0] == pytest.approx(46.98) and len(board.sets) == 36


def test_a_board_that_is_busy_saving_is_asked_again_and_one_that_cannot_is_waited_for(
    board, plan_of, tmp_path
):
    answers = [m.MAV_RESULT_ACCEPTED, m.MAV_RESULT_TEMPORARILY_REJECTED, m.MAV_RESULT_ACCEPTED]
    board.storage = lambda: answers.pop(0)
    assert _upload(board, plan_of(), tmp_path).result == "verified" and answers == []
    board.storage, reported = lambda: m.MAV_RESULT_UNSUPPORTED, []
    outcome = _upload(board, plan_of(MPC_THR_HOVER=0.41), tmp_path, Talk(say=reported.append))
    assert outcome.result == "verified" and any("does not save on request" in text for text in reported)


class _Killed(BaseException):
    """As SIGKILL: nothing is sent after it."""


def killed(board, after):
    """A session whose process dies once `after` values are on board."""
    session = meet(board)
    send = session.send

    def until_then(message):
        if len(board.sets) >= after:
            raise _Killed
        send(message)

    session.send = until_then
    return session


@pytest.mark.slow
def test_killed_after_each_write_the_next_call_makes_it_whole(board, plan_of, tmp_path):
    """Once n of 18 values are on board, for every n; then the same table, another, or the backup."""
    other = plan_of(ct_upper=50.0, ct_lower=60.0)
    plan, before = plan_of(), dict(board.params)
    for n in range(1, 19):
        board.params, board.sets = dict(before), []
        with pytest.raises(_Killed):
            _upload(board, plan, tmp_path, session=killed(board, n))
        entry = Journal(_Identity).open_entry()
        assert entry is not None and entry.old.values["CA_ROTOR0_CT"].value == 6.5
        if n % 3 == 0:
            assert _restore(board, entry.backup, tmp_path).result == "verified"
            assert _same(board.params, before), n
        else:
            wanted = plan if n % 3 == 1 else other
            assert _upload(board, wanted, tmp_path).result == "verified"
            held = {name: _f32(board.params[name][0]) for name in wanted.params}
            assert held == {name: _f32(v) for name, v in wanted.params.items()}, n
            rest = {name: v for name, v in board.params.items() if name not in wanted.params}
            assert _same(rest, {name: v for name, v in before.items() if name not in wanted.params})
        assert Journal(_Identity).open_entry() is None


def test_what_forbids_nothing_is_still_said(board, plan_of, tmp_path):
    """A motor that no output drives, a firmware newer than was ever looked at."""
    board.params |= {f"PWM_MAIN_FUNC{n}": (100 + n if n != 7 else 0, 6) for n in range(1, 9)}
    board.version, reported = (1, 18, 0), []
    assert _upload(board, plan_of(), tmp_path, Talk(say=reported.append)).result == "verified"
    assert any("PX4 1.18.0 drops of a table is only known up to 1.17" in text for text in reported)
    assert any("no output of this board drives rotor 7 (" in text for text in reported)
    board.params["PWM_MAIN_FUNC7"], board.version, reported = (107, 6), (1, 17, 2), []
    assert _upload(board, plan_of(), tmp_path, Talk(say=reported.append)).result == "verified"
    assert not any("drives rotor" in text or "only known" in text for text in reported)


def test_a_bad_line_costs_time_not_the_table(board, plan_of, tmp_path):
    session = meet(board)
    board.loss = 0.2
    outcome = _upload(board, plan_of(), tmp_path, session=session)
    assert outcome.result == "verified" and outcome.retries > 0
    assert _f32(board.params["CA_ROTOR7_CT"][0]) == _f32(69.89)
