"""The whole story on both stand-ins: upload, fly, verify, restore; arming under way; a board that starts."""

from pathlib import Path

import pytest
from memory_net import meet, standin
from pymavlink.dialects.v20 import common as m

from coaxlink.errors import CoaxlinkError
from coaxlink.fly.commands import Commander
from coaxlink.mavlink.ftp import Files
from coaxlink.mavlink.parameters import FLOAT, Parameters
from coaxlink.uploading.backup import read_backup
from coaxlink.uploading.journal import Journal
from coaxlink.uploading.outcome import Talk
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.verify import verify
from coaxlink.uploading.worker import Uploader
from firmware_params.ardupilot import packed

pytestmark = pytest.mark.slow
TABLES = ("px4", "matrix", "loader")
_READING = (1, 3, 4, 5, 14)  # MAVFTP: close, list, open to read, read, checksum


def _firmware(table):
    return "px4" if table == "px4" else "ardupilot"


def _worker(session, tmp_path, reported=None):
    talk = Talk(say=reported.append if reported is not None else lambda text: None)
    return Uploader(session, backup_folder=tmp_path / "b", talk=talk, reboot_s=0.4)


def _fly(session, seconds):
    """Up to 3 m and down again; at many times real time."""
    vehicle, end = Commander(session), session.clock.monotonic() + 600.0
    while True:
        try:
            vehicle.arm()
            break
        except CoaxlinkError:  # an ArduPilot whose scripts have not run yet
            assert session.clock.monotonic() < end
            session.clock.sleep(0.2)
    vehicle.take_off(3.0)
    session.clock.sleep(seconds)
    vehicle.land()
    while session.armed:
        assert session.clock.monotonic() < end
        session.clock.sleep(0.05)
    session.clock.sleep(0.5)


@pytest.mark.parametrize("table", TABLES)
def test_up_flown_verified_undone(tables, tmp_path, table):
    """What the issue's pilot did on a real ArduCopter, four times in vain."""
    ardupilot = table != "px4"
    plan = load_plan(tables[table])
    with (
        standin(_firmware(table)) as board,
        meet(board) as session,
    ):
        parameters = Parameters(session)
        listed = parameters.read_all().values
        hidden = parameters.read_many(plan.params, missing_ok=True)  # SCR_* while scripting is off
        before = {n: v.value for n, v in {**listed, **hidden}.items()}
        done = _worker(session, tmp_path).upload(plan)
        assert done.result == "verified", done.reason
        _fly(session, 3.0)

        result = verify(session, plan)
        assert result.holds, result.mismatches
        assert [row["name"] for row in result.learned] == (["MOT_THST_HOVER"] if ardupilot else [])
        assert result.to_json()["result"] == "verified"
        reported = []
        again = _worker(session, tmp_path, reported).upload(plan)
        assert (again.result, again.reason) == ("verified", "the board holds it already")
        assert not again.changed and [c.name for c in again.learned] == [r["name"] for r in result.learned]
        assert any("learned in flight" in text for text in reported) == ardupilot

        touched = {n for n in before if before[n] != parameters.read(n).value} - set(plan.params)
        assert touched  # counters and the like: a flight happened
        back = _worker(session, tmp_path).restore(read_backup(Path(done.backup)))
        assert back.result == "verified", back.reason
        held = {n: v.value for n, v in parameters.read_many(plan.params, missing_ok=True).items()}
        assert held == {n: before[n] for n in held}
        assert not touched & {c.name for c in back.changed}

        other = "PILOT_SPEED_UP" if ardupilot else "MPC_XY_CRUISE"
        parameters.write(other, 3.0, parameters.read(other).type)
        outcome_ = _worker(session, tmp_path).restore(read_backup(Path(done.backup)), everything=True)
        assert outcome_.result == "verified", outcome_.reason
        assert parameters.read(other).value == before[other]
        assert set(outcome_.left_out) >= (
            {"STAT_FLTTIME", "STAT_BOOTCNT", "BARO1_GND_PRESS"}
            if ardupilot
            else {"COM_FLIGHT_UUID", "LND_FLIGHT_T_LO", "CAL_GYRO0_XOFF", "EKF2_MAG_DECL"}
        )


class _Line:
    """Counts what a session writes; after so many of one `kind` (PARAM_SET, or a MAVFTP opcode) somebody arms
    the vehicle.
    """

    def __init__(self, session, *, after, kind):
        self.session, self.kind, self.left = session, kind, after
        self.writes_armed = 0
        self._send = session.send
        session.send = self.send

    def send(self, message):
        writes = self._is_write(message)
        if writes and self.session.armed:
            self.writes_armed += 1
        self._send(message)
        if writes and self.kind == (message.get_type() if isinstance(self.kind, str) else _opcode(message)):
            self.left -= 1
            if self.left == 0:
                self._arm()

    @staticmethod
    def _is_write(message):
        if message.get_type() == "FILE_TRANSFER_PROTOCOL":
            return message.payload[3] not in _READING
        command = message.get_type() == "COMMAND_LONG" and message.command in (245, 246)
        return message.get_type() == "PARAM_SET" or command

    def _arm(self):
        session, target = self.session, self.session.identity
        end = session.clock.monotonic() + 600.0
        while not session.armed:
            assert session.clock.monotonic() < end
            self._send(
                m.MAVLink_command_long_message(
                    target.system, target.component, 400, 0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                )
            )
            session.clock.sleep(0.1)


def _opcode(message):
    return message.payload[3] if message.get_type() == "FILE_TRANSFER_PROTOCOL" else 0


def _disarm(session):
    session.command(400, 0.0)
    end = session.clock.monotonic() + 600.0
    while session.armed:
        assert session.clock.monotonic() < end
        session.clock.sleep(0.05)


_CHUNK, _RENAME = 7, 13  # MAVFTP
CASES = [("px4", "PARAM_SET", 5), ("matrix", "PARAM_SET", 3), ("matrix", _RENAME, 1)]


def test_half_a_file_beside_the_old_one_is_no_change(tables, tmp_path):
    """A script goes to a side name first: armed then, the board holds what it held, and the journal ends."""
    with standin("ardupilot") as board, meet(board) as session:
        line = _Line(session, after=2, kind=_CHUNK)
        outcome = _worker(session, tmp_path).upload(load_plan(tables["matrix"]))
        assert session.armed and line.left == 0 and line.writes_armed == 0
        assert outcome.result == "refused" and outcome.error.exit_code == 4
        assert "the board holds its old table" in outcome.reason
        assert Journal(session.identity, address=session.address).open_entry() is None
        assert Parameters(session).read("FRAME_CLASS").value == 4


@pytest.mark.parametrize(("table", "kind", "after"), CASES)
@pytest.mark.parametrize("verb", ["upload", "restore"])
def test_nothing_is_written_once_the_vehicle_is_seen_armed(tables, tmp_path, table, kind, after, verb):
    plan = load_plan(tables[table])
    with (
        standin(_firmware(table)) as board,
        meet(board) as session,
    ):
        before = Parameters(session).read_many(plan.params, missing_ok=True)
        Parameters(session).write("DISARM_DELAY" if table != "px4" else "COM_DISARM_PRFLT", 0, *_kind(table))
        line, reported = _Line(session, after=after, kind=kind), []
        outcome = _worker(session, tmp_path, reported).upload(plan)
        assert session.armed and line.left == 0 and line.writes_armed == 0
        assert outcome.result == "failed" and outcome.error.exit_code == 4
        assert "nothing more was written" in outcome.reason and "disarm" in outcome.reason
        found = Parameters(session).read_many(before)
        changed = {n for n, v in found.items() if not v.same(before[n])}
        stands = outcome.standing
        assert set(stands["new"]) & set(before) == changed
        assert (set(stands["new"]) | set(stands["old"]) | set(stands["other"])) == {
            *(c.name for c in outcome.changed),
            *outcome.scripts,
        }
        assert not stands["unknown"] and any(text.startswith("old: ") for text in reported)
        assert (
            line.writes_armed == 0
            and Journal(session.identity, address=session.address).open_entry() is not None
        )
        refused = _worker(session, tmp_path).upload(plan)
        assert refused.result == "refused" and line.writes_armed == 0

        _disarm(session)
        if verb == "upload":
            assert _worker(session, tmp_path).upload(plan).result == "verified"
            assert verify(session, plan).holds
        else:
            back = _worker(session, tmp_path).restore(read_backup(Path(outcome.backup)))
            assert back.result == "verified", back.reason
            held = Parameters(session).read_many(before, missing_ok=True)
            assert all(held[n].same(before[n]) for n in held)
        assert Journal(session.identity, address=session.address).open_entry() is None


def _kind(table):
    return (2,) if table != "px4" else (FLOAT,)


def test_a_board_that_is_starting_is_waited_for(tables, tmp_path):
    """MAVLink answers before scripts run: until then the loader's table is not there, for anybody who asks.

    Power is cut; `verify` and the backup of the next upload both come too early.
    """
    plan, memory = load_plan(tables["loader"]), tmp_path / "memory.json"
    with standin("ardupilot", memory=memory) as board, meet(board) as session:
        assert _worker(session, tmp_path).upload(plan).result == "verified"
    with standin("ardupilot", memory=memory) as board, meet(board) as session:
        assert "CXL_SUM" not in Parameters(session).read_many(["CXL_SUM"], missing_ok=True)  # early enough
        result = verify(session, None)
        assert result.holds, result.mismatches
    with standin("ardupilot", memory=memory) as board, meet(board) as session:
        assert "CXL_SUM" not in packed.unpack(Files(session).read(packed.PATH))
        again = load_plan(tables["matrix"])
        outcome = _worker(session, tmp_path).upload(again)
        assert outcome.result == "verified", outcome.reason
        saved = read_backup(Path(outcome.backup)).params
        assert {n for n in plan.params if n.startswith("CXL_")} <= set(saved)


def test_a_table_that_is_not_there_is_not_waited_for(tables, tmp_path):
    """Without the loader on its card a board has nothing to wait for."""
    with standin("ardupilot") as board, meet(board) as session:
        started = session.clock.monotonic()
        result = verify(session, load_plan(tables["loader"]), script_s=60.0)
        assert not result.holds and session.clock.monotonic() - started < 30.0
        assert {"CXL_SUM", "CXL_T8"} <= {w["name"] for w in result.mismatches}


def test_a_loader_s_table_goes_back_live(tables, tmp_path):
    """Two tables of class 17: the undo of the second is the first, whole, without a restart."""
    with standin("ardupilot") as board, meet(board) as session:
        assert _worker(session, tmp_path).upload(load_plan(tables["loader"])).result == "verified"
        changed = _worker(session, tmp_path).upload(load_plan(tables["loader-standard"]))
        assert changed.result == "verified" and any(c.name == "CXL_SUM" for c in changed.changed)
        reported = []
        back = _worker(session, tmp_path, reported).restore(read_backup(Path(changed.backup)))
        assert back.result == "verified" and "rebooting" not in reported
        assert verify(session, load_plan(tables["loader"])).holds


class _Pulled(Exception):
    pass


@pytest.mark.parametrize("table", TABLES)
def test_a_plug_pulled_in_the_middle_of_the_write(tables, tmp_path, table):
    """Power goes after some writes, later each time; the board starts anew and the same upload ends it."""
    plan, memory = load_plan(tables[table]), tmp_path / "memory.json"

    def options():
        return standin(_firmware(table), memory=memory)

    for writes in (2, 4):
        with (
            pytest.raises(_Pulled),
            options() as board,
            meet(board) as session,
        ):
            send, left = session.send, [writes]

            def until_pulled(message, send=send, left=left):
                if left[0] <= 0 and _Line._is_write(message):
                    raise _Pulled
                left[0] -= message.get_type() == "PARAM_SET"
                send(message)

            session.send = until_pulled
            _worker(session, tmp_path).upload(plan)
        with options() as board, meet(board) as session:
            journal = Journal(session.identity, address=session.address)
            assert journal.open_entry() is not None
            assert not verify(session, plan).holds
            done = _worker(session, tmp_path).upload(plan)
            assert done.result == "verified", done.reason
            assert journal.open_entry() is None and verify(session, plan).holds
            back = _worker(session, tmp_path).restore(read_backup(Path(done.backup)))
            assert back.result == "verified", back.reason  # so that the next round has as much to write
