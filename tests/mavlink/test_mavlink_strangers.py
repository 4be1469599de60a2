"""Who is on the line: two vehicles of one id, forgers, gimbals that answer, a vehicle that moves."""

from contextlib import contextmanager

import pytest
from case_table import case_table
from memory_net import Line, Net, meet
from px4_board import params_text, x8
from pymavlink.dialects.v20 import common as m
from scripted_autopilot import ScriptedAutopilot

from coaxlink.errors import LinkError, SafetyRefusal
from coaxlink.mavlink import connect, strangers
from coaxlink.mavlink.confirm import confirm
from coaxlink.mavlink.identity import Identity
from coaxlink.mavlink.parameters import Parameters
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.verify import verify
from coaxlink.uploading.worker import Uploader

BEAT = m.MAVLink_heartbeat_message(m.MAV_TYPE_OCTOROTOR, m.MAV_AUTOPILOT_PX4, 128, 0, 4, 3)


@pytest.fixture
def plan(tmp_path):
    (tmp_path / "px4.params").write_text(params_text())
    return load_plan(tmp_path / "px4.params")


def session_at(net, address, **options):
    line = Line(net, address=address)
    return connect(f"udpin:{address[0]}:{address[1]}", transport=line, clock=net.clock, **options)


@contextmanager
def listening(**vehicle):
    """A session that listens at an address, and the vehicle that is bound to it."""
    net = Net()
    address = net.address()
    with (
        ScriptedAutopilot(x8(), net=net, towards=address, **vehicle) as board,
        session_at(net, address, timeout_s=5.0) as session,
    ):
        board.line = address
        yield session, board


def second(board, **options):
    return ScriptedAutopilot(x8(), net=board.net, towards=board.line, **options)


def forge(net, target, *messages, every_s=0.005, source=None):
    """Say the same things on and on from an address that hears nothing; that address."""
    source, packer = source or net.address(), m.MAVLink(None, 1, 1)

    def say():
        for message in messages:
            net.send(message.pack(packer), source, target)
            packer.seq = (packer.seq + 1) % 256
        net.clock.later(every_s, say)

    say()
    return source


def until(session, met, patience_s=60.0):
    end = session.clock.monotonic() + patience_s
    while not met():
        assert session.clock.monotonic() < end
        session.clock.sleep(0.02)


def test_forged_heartbeats_move_nothing_and_are_reported():
    with listening() as (session, board):
        address = forge(board.net, board.line, BEAT)
        until(session, lambda: session.bound.strangers.datagrams > 20)
        parameters = Parameters(session)
        for value in (6.0, 7.0, 8.0):
            assert parameters.write("CA_ROTOR0_CT", value, 9).value == value
        assert board.params["CA_ROTOR0_CT"][0] == 8.0 and session.bound.peer == board.address
        assert session.armed is False  # the forged ones say armed
        (warning,) = session.bound.news()
        assert f"{address[0]}:{address[1]}" in warning and str(board.address[1]) in warning
        confirm(session)


@pytest.mark.parametrize("uid", [0xC0A1, 0xC0A2])
def test_a_second_vehicle_of_the_same_ids_is_refused_with_both_addresses(tmp_path, plan, uid):
    with listening() as (session, board), second(board, uid=uid) as other:
        outcome = Uploader(session, backup_folder=tmp_path).upload(plan)
        assert outcome.result == "refused" and outcome.error.exit_code == 4
        for address in (board.address, other.address):
            assert f"{address[0]}:{address[1]}" in outcome.reason
        assert board.sets == [] and other.sets == []
        with pytest.raises(SafetyRefusal, match="two vehicles answer as system 1"):
            verify(session, plan)
        assert any("a second vehicle" in line for line in session.bound.news())


def test_a_second_vehicle_that_comes_in_the_middle_leaves_the_first_as_it_was(tmp_path, plan):
    with listening() as (session, board), ScriptedAutopilot(x8(), net=board.net, uid=0xC0A2) as other:
        before = dict(board.params)

        def enter():
            other._peer = board.line
            until(session, lambda: any(s.beside for s in session.bound.strangers))

        board.after_set[3] = enter
        outcome = Uploader(session, backup_folder=tmp_path).upload(plan)
        assert outcome.result == "rolled_back" and outcome.error.exit_code == 4
        for name, (value, kind) in before.items():
            assert board.params[name] == (pytest.approx(value, rel=1e-7), kind)
        assert other.sets == []


def test_a_vehicle_that_changed_its_port_is_followed_when_its_board_is_the_same():
    with listening() as (session, board):
        board.close()
        session.clock.sleep(3.0)
        with second(board) as back:
            until(session, lambda: session.bound.peer == back.address)
            assert Parameters(session).write("CA_ROTOR0_CT", 7.0, 9).value == 7.0
            confirm(session)
            assert any("the session goes on there" in line for line in session.bound.news())


def test_a_board_that_restarts_twice_quickly_is_one_that_came_back():
    with listening() as (session, board):
        board.close()
        with second(board):
            session.clock.sleep(2.0)
        with second(board) as back:
            until(session, lambda: session.bound.peer == back.address)
            confirm(session)


def test_another_board_or_one_without_a_name_of_its_own_is_not_followed():
    with case_table() as case:
        for first, then in ((0xC0A1, 0xC0A2), (0, 0), (0x4954414C44494E4F, 0x4954414C44494E4F)):
            with case(f"{first}, {then}"), listening(uid=first) as (session, board):
                board.close()
                with second(board, uid=then) as other:
                    until(session, lambda: any(s.answers for s in session.bound.strangers))
                    session.clock.sleep(2 * strangers.LOST_S)
                    assert session.bound.peer == board.address
                    with pytest.raises(LinkError):
                        Parameters(session).write("CA_ROTOR0_CT", 7.0, 9)
                    assert other.sets == []


def test_a_uid_says_whether_it_is_a_boards_own():
    def unique(uid):
        return Identity(1, 1, 12, 2, uid=uid).unique

    assert unique(f"{0xC0A1:016x}") and unique("0002000000003332373438385100400034001a")
    assert not unique("") and not unique("0" * 16) and not unique("4954414c44494e50")
    assert not unique("03" + "0" * 34)  # uid2 of PX4's SITL with system id 4


def test_a_forger_who_was_there_first_is_not_taken_for_the_vehicle():
    net = Net()
    address = net.address()
    forge(net, address, BEAT)
    with ScriptedAutopilot(x8(), net=net, towards=address) as board:
        board.deaf = True
        net.clock.later(0.5, lambda: setattr(board, "deaf", False))
        with session_at(net, address) as session:
            assert session.bound.peer == board.address and session.identity.uid == f"{0xC0A1:016x}"
            assert session.armed is False and session.latest("HEARTBEAT") is not None
            assert Parameters(session).write("CA_ROTOR0_CT", 7.0, 9).value == 7.0
            confirm(session)


def test_where_nobody_answers_the_first_that_was_heard_is_the_vehicle():
    net = Net()
    address = net.address()
    source = forge(net, address, BEAT, every_s=0.05)
    with session_at(net, address, timeout_s=0.5) as session:
        assert session.bound.peer == source and session.identity.version is None
        assert session.wait("HEARTBEAT", 2.0) is not None


def test_a_gimbal_of_the_same_vehicle_answers_for_nothing(tmp_path, plan):
    noise = [
        m.MAVLink_param_value_message(b"CA_ROTOR0_CT", 99.0, 9, 1, 0),
        m.MAVLink_param_error_message(245, 191, b"CA_ROTOR0_CT", -1, 5),
        m.MAVLink_command_ack_message(400, m.MAV_RESULT_DENIED),
        m.MAVLink_heartbeat_message(m.MAV_TYPE_GIMBAL, m.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3),
    ]
    with ScriptedAutopilot(x8(), net=Net()) as board, meet(board) as session:
        gimbal, heard = m.MAVLink(None, 1, 154), []
        session.subscribe(lambda message: heard.append(message.get_srcComponent()), whole_system=True)

        def chatter():  # through a router: from the vehicle's own address
            for message in noise:
                board.put(message.pack(gimbal))
            board.net.clock.later(0.002, chatter)

        chatter()
        assert session.command(400, 1.0) == m.MAV_RESULT_ACCEPTED
        outcome = Uploader(session, backup_folder=tmp_path).upload(plan)
        assert outcome.result == "verified", outcome.reason
        assert 154 in heard


def test_two_boards_behind_one_address_are_refused(tmp_path, plan):
    with ScriptedAutopilot(x8(), net=Net()) as board, meet(board) as session:
        send = board._send_version

        def both():
            send()
            board.uid, mine = 0xBEEF, board.uid
            send()
            board.uid = mine

        board._send_version = both
        with pytest.raises(SafetyRefusal, match=r"two answer as system 1 .* and board 000000000000beef"):
            confirm(session)
        outcome = Uploader(session, backup_folder=tmp_path).upload(plan)
        assert outcome.result == "refused" and board.sets == []


def test_half_a_frame_from_elsewhere_swallows_nothing():
    with listening() as (session, board):
        source, heard = board.net.address(), []
        session.subscribe(lambda message: heard.append(message.get_type()))
        for n in range(200):
            board.net.send(b"\xfd\xff" + bytes(7), source, board.line)
            board.send(m.MAVLink_attitude_message(n, 0, 0, 0, 0, 0, 0))
            session.clock.sleep(0.001)
        until(session, lambda: heard.count("ATTITUDE") == 200)
        assert session.bound.strangers.datagrams == 0


def test_a_flood_of_addresses_is_borne_in_bounded_memory():
    with listening() as (session, board):
        packer, count = m.MAVLink(None, 1, 1), 3 * strangers.MOST_ADDRESSES
        for _ in range(count):
            board.net.send(BEAT.pack(packer), board.net.address(), board.line)
        until(session, lambda: session.bound.strangers.datagrams >= count)
        assert len(list(session.bound.strangers)) == strangers.MOST_ADDRESSES
        assert 0 < len(session.bound.news()) <= 8
        confirm(session)


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
