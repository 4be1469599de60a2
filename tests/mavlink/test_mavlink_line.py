"""Who is on the line: two vehicles of one id, forgers, gimbals that answer, a vehicle that moves."""

import socket
import threading
import time
from contextlib import contextmanager

import pytest
from px4_board import params_text, x8
from pymavlink.dialects.v20 import common as m
from scripted_autopilot import ScriptedAutopilot

from coaxlink.errors import LinkError, SafetyRefusal
from coaxlink.mavlink import connect, strangers
from coaxlink.mavlink.confirm import confirm
from coaxlink.mavlink.identity import Identity
from coaxlink.mavlink.parameters import Parameters
from coaxlink.studies.simulator import free_port
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.verify import verify
from coaxlink.uploading.worker import Uploader


def table(folder):
    """A folder as `coaxlink table` writes it."""
    out = folder / "table"
    out.mkdir(exist_ok=True)
    (out / "px4.params").write_text(params_text())
    return out


@contextmanager
def listening(**vehicle):
    """A session on a port of its own, the vehicle that is bound to it, and that port."""
    port = free_port()
    with (
        ScriptedAutopilot(x8(), towards=("127.0.0.1", port), **vehicle) as board,
        connect(f"udpin:127.0.0.1:{port}", timeout_s=5.0) as session,
    ):
        yield session, board, port


@contextmanager
def forger(port, *messages, every_s=0.005, system=1, component=1):
    """Says the same things on and on, and hears nothing; yields its address."""
    stop = threading.Event()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        packer = m.MAVLink(None, system, component)

        def run():
            while not stop.wait(every_s):
                for message in messages:
                    line.sendto(message.pack(packer), ("127.0.0.1", port))
                    packer.seq = (packer.seq + 1) % 256

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield line.getsockname()
        finally:
            stop.set()
            thread.join()


BEAT = m.MAVLink_heartbeat_message(m.MAV_TYPE_OCTOROTOR, m.MAV_AUTOPILOT_PX4, 128, 0, 4, 3)


def until(met, patience_s=60.0):
    end = time.monotonic() + patience_s
    while not met():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_forged_heartbeats_move_nothing_and_are_told():
    with listening() as (session, board, port), forger(port, BEAT) as address:
        until(lambda: session.bound.strangers.datagrams > 20)
        parameters = Parameters(session)
        for value in (6.0, 7.0, 8.0):
            assert parameters.write("CA_ROTOR0_CT", value, 9).value == value
        assert board.params["CA_ROTOR0_CT"][0] == 8.0
        assert session.bound.peer == board.address
        assert session.armed is False  # the forged ones say armed
        (warning,) = session.bound.news()
        assert f"{address[0]}:{address[1]}" in warning and str(board.address[1]) in warning
        confirm(session)


@pytest.mark.parametrize("uid", [0xC0A1, 0xC0A2])
def test_a_second_vehicle_of_the_same_ids_is_refused_with_both_addresses(tmp_path, uid):
    with (
        listening() as (session, board, port),
        ScriptedAutopilot(x8(), uid=uid, towards=("127.0.0.1", port)) as second,
    ):
        worker = Uploader(session, backup_folder=tmp_path)
        outcome = worker.upload(load_plan(table(tmp_path)))
        assert outcome.result == "refused" and outcome.error.exit_code == 4
        for address in (board.address, second.address):
            assert f"{address[0]}:{address[1]}" in outcome.reason
        assert board.sets == [] and second.sets == []
        with pytest.raises(SafetyRefusal, match="two vehicles answer as system 1"):
            verify(session, load_plan(table(tmp_path)))
        assert any("a second vehicle" in line for line in session.bound.news())


def test_a_second_vehicle_that_comes_in_the_middle_leaves_the_first_as_it_was(tmp_path):
    with listening() as (session, board, port):
        before = dict(board.params)
        with ScriptedAutopilot(x8(), uid=0xC0A2) as second:

            def enter():
                second._peer = ("127.0.0.1", port)
                until(lambda: any(s.beside for s in session.bound.strangers))

            board.after_set[3] = lambda: threading.Thread(target=enter).start() or time.sleep(0.5)
            outcome = Uploader(session, backup_folder=tmp_path).upload(load_plan(table(tmp_path)))
            assert outcome.result == "rolled_back" and outcome.error.exit_code == 4
            for name, (value, kind) in before.items():
                assert board.params[name] == (pytest.approx(value, rel=1e-7), kind)
            assert second.sets == []


def test_a_vehicle_that_changed_its_port_is_followed_when_its_board_is_the_same(monkeypatch):
    monkeypatch.setattr(strangers, "LOST_S", 0.6)
    with listening() as (session, board, port):
        board.close()
        until(lambda: session.silence_s > 0.3)
        with ScriptedAutopilot(x8(), towards=("127.0.0.1", port)) as back:
            until(lambda: session.bound.peer == back.address)
            assert Parameters(session).write("CA_ROTOR0_CT", 7.0, 9).value == 7.0
            confirm(session)
            assert any("the session goes on there" in line for line in session.bound.news())


@pytest.mark.parametrize(
    ("first", "then"), [(0xC0A1, 0xC0A2), (0, 0), (0x4954414C44494E4F, 0x4954414C44494E4F)]
)
def test_another_board_or_one_without_a_name_of_its_own_is_not_followed(monkeypatch, first, then):
    monkeypatch.setattr(strangers, "LOST_S", 0.5)
    with listening(uid=first) as (session, board, port):
        board.close()
        with ScriptedAutopilot(x8(), uid=then, towards=("127.0.0.1", port)) as other:
            until(lambda: any(s.answers for s in session.bound.strangers) and session.silence_s > 1.5)
            assert session.bound.peer == board.address and other.sets == []
            with pytest.raises(LinkError):
                Parameters(session, timeout_s=0.1).write("CA_ROTOR0_CT", 7.0, 9)
            assert other.sets == []


def test_a_uid_says_whether_it_is_a_boards_own():
    def unique(uid):
        return Identity(1, 1, 12, 2, uid=uid).unique

    assert unique(f"{0xC0A1:016x}") and unique("0002000000003332373438385100400034001a")
    assert not unique("") and not unique("0" * 16) and not unique("4954414c44494e50")
    assert not unique("03" + "0" * 34)  # uid2 of PX4's SITL with system id 4


def test_a_forger_who_was_there_first_is_not_taken_for_the_vehicle():
    port = free_port()
    with forger(port, BEAT), ScriptedAutopilot(x8(), towards=("127.0.0.1", port)) as board:
        board.deaf = True
        threading.Timer(0.5, lambda: setattr(board, "deaf", False)).start()
        with connect(f"udpin:127.0.0.1:{port}", timeout_s=5.0) as session:
            assert session.bound.peer == board.address and session.identity.uid == f"{0xC0A1:016x}"
            assert session.armed is False and session.latest("HEARTBEAT") is not None
            assert Parameters(session).write("CA_ROTOR0_CT", 7.0, 9).value == 7.0
            confirm(session)


def test_where_nobody_answers_the_first_that_was_heard_is_the_vehicle():
    port = free_port()
    with (
        forger(port, BEAT, every_s=0.05) as address,
        connect(f"udpin:127.0.0.1:{port}", timeout_s=0.5) as session,
    ):
        assert session.bound.peer == address and session.identity.version is None
        assert session.wait("HEARTBEAT", 2.0) is not None


def test_a_gimbal_of_the_same_vehicle_answers_for_nothing(tmp_path):
    noise = [
        m.MAVLink_param_value_message(b"CA_ROTOR0_CT", 99.0, 9, 1, 0),
        m.MAVLink_param_error_message(245, 191, b"CA_ROTOR0_CT", -1, 5),
        m.MAVLink_command_ack_message(400, m.MAV_RESULT_DENIED),
        m.MAVLink_heartbeat_message(m.MAV_TYPE_GIMBAL, m.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3),
    ]
    with ScriptedAutopilot(x8()) as board, connect(board.url) as session:
        gimbal, stop = m.MAVLink(None, 1, 154), threading.Event()
        heard = []
        session.subscribe(lambda message: heard.append(message.get_srcComponent()), whole_system=True)

        def chatter():  # through a router: from the vehicle's own address
            while not stop.wait(0.002):
                for message in noise:
                    board._socket.sendto(message.pack(gimbal), board._peer)

        thread = threading.Thread(target=chatter)
        thread.start()
        try:
            assert session.command(400, 1.0) == m.MAV_RESULT_ACCEPTED
            outcome = Uploader(session, backup_folder=tmp_path).upload(load_plan(table(tmp_path)))
            assert outcome.result == "verified", outcome.reason
        finally:
            stop.set()
            thread.join()
        assert 154 in heard


def test_two_boards_behind_one_address_are_refused(tmp_path):
    with ScriptedAutopilot(x8()) as board, connect(board.url) as session:
        send = board._send_version

        def both():
            send()
            board.uid, mine = 0xBEEF, board.uid
            send()
            board.uid = mine

        board._send_version = both
        with pytest.raises(SafetyRefusal, match=r"two answer as system 1 .* and board 000000000000beef"):
            confirm(session)
        outcome = Uploader(session, backup_folder=tmp_path).upload(load_plan(table(tmp_path)))
        assert outcome.result == "refused" and board.sets == []


def test_half_a_frame_from_elsewhere_swallows_nothing():
    with listening() as (session, board, port):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
            stop = threading.Event()

            def half():
                while not stop.wait(0.001):
                    line.sendto(b"\xfd\xff" + bytes(7), ("127.0.0.1", port))

            thread = threading.Thread(target=half)
            thread.start()
            try:
                heard = []
                session.subscribe(lambda message: heard.append(message.get_type()))
                for n in range(200):
                    board.send(m.MAVLink_attitude_message(n, 0, 0, 0, 0, 0, 0))
                    time.sleep(0.001)
                until(lambda: heard.count("ATTITUDE") == 200)
            finally:
                stop.set()
                thread.join()
        assert session.bound.strangers.datagrams == 0


def test_a_flood_of_addresses_is_borne_in_bounded_memory():
    with listening() as (session, _, port):
        packer = m.MAVLink(None, 1, 1)
        lines = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3 * strangers.MOST)]
        for line in lines:
            line.sendto(BEAT.pack(packer), ("127.0.0.1", port))
        until(lambda: session.bound.strangers.datagrams >= len(lines))
        assert len(list(session.bound.strangers)) == strangers.MOST
        assert 0 < len(session.bound.news()) <= 8
        confirm(session)
        for line in lines:
            line.close()


def test_one_who_never_answers_is_asked_for_hours_at_a_steady_pace():
    others, packer, ids = strangers.Strangers(None), m.MAVLink(None, 1, 1), (1, 1)
    beat, now, requests = bytes(BEAT.pack(packer)), 0.0, []
    while now < 4 * 3600.0:
        now += 0.5
        if others.take(beat, ("10.0.0.1", 1), ids, now):
            requests.append(now)
    assert others.datagrams == 8 * 3600
    assert requests[1] - requests[0] == pytest.approx(1.0, abs=0.3)
    assert requests[-1] - requests[-2] == strangers.ASK_MOST_S
    assert not others.undecided(now)
    corrupted = bytearray(beat)
    corrupted[-1] ^= 1
    assert others.take(bytes(corrupted), ("10.0.0.2", 1), ids, now) is None  # noise makes no stranger
    assert others.get(("10.0.0.2", 1)) is None
