"""Addresses, and a session with a scripted autopilot in memory."""

import struct
import time
import types

import pytest
from memory_net import Line, Net, meet
from pymavlink.dialects.v20 import ardupilotmega
from pymavlink.dialects.v20 import common as m
from scripted_autopilot import ScriptedAutopilot

from coaxlink.errors import LinkError
from coaxlink.mavlink import connect
from coaxlink.mavlink.clock import VirtualClock
from coaxlink.mavlink.reboot import reboot
from coaxlink.monitor.incoming.heard import Heard


@pytest.fixture
def vehicle():
    with ScriptedAutopilot({}, net=Net()) as scripted:
        yield scripted


def test_identity_armed_and_version(vehicle):
    with meet(vehicle) as session:
        identity = session.identity
        assert (identity.system, identity.component, identity.name) == (1, 1, "PX4 1.16.1")
        assert identity.uid == f"{0xC0A1:016x}"
        assert (identity.board, identity.git_hash) == ("12:34:7", "0102030405060708")
        assert session.source == (245, 191)
        assert session.armed is False
        vehicle.armed = True
        session.wait("HEARTBEAT", 2.0, lambda h: h.base_mode & 128)
        assert session.armed is True


def test_the_companion_beats_once_a_second(vehicle):
    with meet(vehicle, source_system=42, source_component=7, target_system=1) as session:
        session.clock.sleep(3.5)
    beats = [h for h in vehicle.heard if h.get_type() == "HEARTBEAT"]
    assert len(beats) == 4
    assert (beats[0].get_srcSystem(), beats[0].get_srcComponent()) == (42, 7)
    assert beats[0].autopilot == m.MAV_AUTOPILOT_INVALID


def test_nobody_there_and_another_system_are_link_errors():
    net = Net()
    with pytest.raises(LinkError, match=r"no autopilot heard within 0.5 s"):
        connect("udpout:10.0.0.9:1", timeout_s=0.5, transport=Line(net, ("10.0.0.9", 1)), clock=net.clock)
    with ScriptedAutopilot({}, net=net, system=3) as other:
        with meet(other) as session:
            assert session.identity.system == 3
        with pytest.raises(LinkError, match="no system 7 heard"):
            meet(other, timeout_s=0.7, target_system=7)


def test_commands_streams_and_their_answers(vehicle):
    with meet(vehicle) as session:
        assert session.command(400, 1.0) == m.MAV_RESULT_ACCEPTED
        assert session.command(31000) == m.MAV_RESULT_UNSUPPORTED
        assert session.request_stream(30, 50.0)
        assert (511, 30.0, 20000.0) in vehicle.commands
        vehicle.deaf = True
        with pytest.raises(LinkError, match="not acknowledged"):
            session.command(400, 1.0, timeout_s=0.1, tries=2)


def test_subscribers_hear_latest_keeps_and_a_broken_one_is_reported(vehicle):
    with meet(vehicle) as session:
        heard = []
        leave = session.subscribe(lambda message: heard.append(message.get_type()))
        session.wait("HEARTBEAT", 2.0)
        leave()
        count = len(heard)
        session.wait("HEARTBEAT", 2.0)
        assert count >= 1 and len(heard) == count
        assert session.latest("HEARTBEAT").get_srcSystem() == 1
        assert session.latest("ATTITUDE") is None and session.wait("ATTITUDE", 0.1) is None

        def broken(message):
            raise RuntimeError("callback broke")

        session.subscribe(broken)
        with pytest.raises(RuntimeError, match="callback broke"):
            session.wait("ATTITUDE", 3.0)


def test_esc_status_is_understood(vehicle):
    with meet(vehicle) as session, session.listen(("ESC_STATUS",)) as inbox:
        vehicle.send(m.mavlink_map[291](4, 1000, [1, 2, 3, 4], [15.0] * 4, [2.0] * 4))
        assert session.take(inbox, 2.0).rpm == [1, 2, 3, 4]


def test_the_log_has_a_stamp_and_a_frame_each(tmp_path, vehicle):
    path = tmp_path / "a.tlog"
    with meet(vehicle, record=path) as session:
        session.wait("HEARTBEAT", 2.0)
    data, kinds, at = path.read_bytes(), [], 0
    reader = m.MAVLink(None)
    while at < len(data):
        (stamp,) = struct.unpack(">Q", data[at : at + 8])
        assert abs(stamp / 1e6 - time.time()) < 600
        length = data[at + 9] + 12
        (message,) = reader.parse_buffer(data[at + 8 : at + 8 + length])
        kinds.append((message.get_type(), message.get_srcSystem()))
        at += 8 + length
    assert {("HEARTBEAT", 1), ("HEARTBEAT", 245), ("AUTOPILOT_VERSION", 1)} <= set(kinds)


def test_loss_is_measured_from_the_sequence_and_other_dialects_are_not_lost(vehicle):
    with meet(vehicle) as session:
        heard = Heard(session.clock.monotonic)
        heard.follow(1, 1)
        session.subscribe(heard.take, whole_system=True)
        for k in range(100):
            own = ardupilotmega.MAVLink_ahrs_message(0, 0, 0, 0, 0, 0, 0)
            vehicle.send(own if k % 2 else m.MAVLink_attitude_message(k, 0, 0, 0, 0, 0, 0))
        session.clock.sleep(0.1)
        assert session.latest("ATTITUDE").time_boot_ms == 98 and session.loss == 0.0
        assert heard.traffic.received >= 100 and heard.traffic.missed == 0
        vehicle.loss = 0.3
        for _ in range(400):
            vehicle.send(m.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0))
        session.clock.sleep(0.1)
        assert 0.2 < session.loss < 0.35


class _Rebooting:
    """A session whose vehicle never acknowledges; `stamps` are its clock after each try."""

    address, silence_s = "nowhere", 0.0

    def __init__(self, stamps):
        self.stamps, self.tries, self.clock = list(stamps), 0, VirtualClock()

    def subscribe(self, callback):
        self.tell = callback
        callback(types.SimpleNamespace(time_boot_ms=50_000))
        return lambda: None

    def command(self, *params, timeout_s, tries):
        self.tries += 1
        if self.stamps:
            self.tell(types.SimpleNamespace(time_boot_ms=self.stamps.pop(0)))
        raise LinkError(self.address, "not acknowledged")

    def wait(self, *_):
        return "a heartbeat"


def test_a_reboot_whose_word_is_lost_is_known_by_the_clock():
    session = _Rebooting([51_000, 52_000, 1_000])
    reboot(session)
    assert session.tries == 3
    with pytest.raises(LinkError, match="reboot was not acknowledged"):
        reboot(_Rebooting([51_000]))
