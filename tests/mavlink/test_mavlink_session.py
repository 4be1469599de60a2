"""A session against a scripted autopilot over loopback UDP, TCP and a pseudo-terminal."""

import os
import pty
import socket
import struct
import threading
import time
import types

import pytest
from pymavlink.dialects.v20 import ardupilotmega
from pymavlink.dialects.v20 import common as m
from scripted_autopilot import ScriptedAutopilot

from coaxlink.errors import InputError, LinkError
from coaxlink.mavlink import connect
from coaxlink.mavlink.address import parse_address
from coaxlink.mavlink.reboot import reboot
from coaxlink.studies.simulator import free_port


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("udpin:0.0.0.0:14550", ("udpin", "0.0.0.0", 14550)),
        ("udp:127.0.0.1:14550", ("udpin", "127.0.0.1", 14550)),
        ("udp://:14540", ("udpin", "0.0.0.0", 14540)),
        ("udpin://127.0.0.1:14540", ("udpin", "127.0.0.1", 14540)),
        ("udpout:127.0.0.1:14540", ("udpout", "127.0.0.1", 14540)),
        ("udpout://[::1]:14540", ("udpout", "::1", 14540)),
        ("tcp:127.0.0.1:5760", ("tcp", "127.0.0.1", 5760)),
        ("tcpout://localhost:5760", ("tcp", "localhost", 5760)),
        ("tcpin:127.0.0.1:5760", ("tcpin", "127.0.0.1", 5760)),
    ],
)
def test_network_addresses(text, expected):
    address = parse_address(text)
    assert (address.kind, address.host, address.port) == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("/dev/ttyACM0,57600", ("/dev/ttyACM0", 57600)),
        ("serial:///dev/ttyUSB0:921600", ("/dev/ttyUSB0", 921600)),
        ("serial:/dev/ttyUSB0:115200", ("/dev/ttyUSB0", 115200)),
        ("/dev/ttyACM0", ("/dev/ttyACM0", 57600)),
    ],
)
def test_serial_addresses(text, expected):
    address = parse_address(text)
    assert (address.kind, address.device, address.baud) == ("serial", *expected)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "nonsense",
        "udp:host",
        "udpout::14550",
        "udpin:0.0.0.0:0",
        "tcp:a:99999",
        "/dev/x,fast",
        "http://a:80",
    ],
)
def test_a_bad_address_is_one_clear_line(text):
    with pytest.raises(InputError, match="expected") as caught:
        parse_address(text)
    assert "\n" not in str(caught.value)


def test_identity_armed_and_version():
    with ScriptedAutopilot({}, version=(1, 16, 1)) as vehicle, connect(vehicle.url) as session:
        identity = session.identity
        assert (identity.system, identity.component, identity.is_px4) == (1, 1, True)
        assert identity.version == (1, 16, 1) and identity.name == "PX4 1.16.1"
        assert (identity.uid, identity.board, identity.git_hash) == (
            f"{0xC0A1:016x}",
            "12:34:7",
            "0102030405060708",
        )
        assert session.source == (245, 191)
        assert session.armed is False
        vehicle.armed = True
        session.wait("HEARTBEAT", 2.0, lambda h: h.base_mode & 128)
        assert session.armed is True


def test_the_companion_beats():
    with ScriptedAutopilot({}) as vehicle, connect(vehicle.url, source_system=42, source_component=7):
        time.sleep(1.3)
        beats = [h for h in vehicle.heard if h.get_type() == "HEARTBEAT"]
        assert len(beats) >= 2
        assert (beats[0].get_srcSystem(), beats[0].get_srcComponent()) == (42, 7)
        assert beats[0].autopilot == m.MAV_AUTOPILOT_INVALID


def test_a_dead_port_is_a_link_error():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        url = f"udpout:127.0.0.1:{silent.getsockname()[1]}"
        started = time.monotonic()
        with pytest.raises(LinkError, match=r"no autopilot heard within 0.5 s"):
            connect(url, timeout_s=0.5)
        assert time.monotonic() - started < 3


def test_a_refused_tcp_port_and_a_taken_udp_port():
    port = free_port()
    with pytest.raises(LinkError, match="refused"):
        connect(f"tcp:127.0.0.1:{port}", timeout_s=0.3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(LinkError, match=r"cannot be opened|in use"):
            connect(f"udpin:127.0.0.1:{taken.getsockname()[1]}", timeout_s=0.3)
    with pytest.raises(LinkError, match="cannot be opened"):
        connect("/dev/no-such-line,57600", timeout_s=0.3)


def test_commands_streams_and_their_answers():
    with ScriptedAutopilot({}) as vehicle, connect(vehicle.url) as session:
        assert session.command(400, 1.0) == m.MAV_RESULT_ACCEPTED
        assert session.command(31000) == m.MAV_RESULT_UNSUPPORTED
        assert session.request_stream(30, 50.0)
        assert (511, 30.0, 20000.0) in vehicle.commands
        vehicle.deaf = True
        with pytest.raises(LinkError, match="not acknowledged"):
            session.command(400, 1.0, timeout_s=0.1, tries=2)


def test_subscribers_hear_latest_keeps_and_a_broken_one_is_reported():
    with ScriptedAutopilot({}) as vehicle, connect(vehicle.url) as session:
        heard = []
        leave = session.subscribe(lambda message: heard.append(message.get_type()))
        session.wait("HEARTBEAT", 2.0)
        leave()
        count = len(heard)
        session.wait("HEARTBEAT", 2.0)
        assert count >= 1 and len(heard) == count
        assert session.latest("HEARTBEAT").get_srcSystem() == 1
        assert session.latest("ATTITUDE") is None
        assert session.wait("ATTITUDE", 0.1) is None

        def broken(message):
            raise RuntimeError("callback broke")

        session.subscribe(broken)
        with pytest.raises(RuntimeError, match="callback broke"):
            session.wait("ATTITUDE", 3.0)


def test_esc_status_is_understood():
    with ScriptedAutopilot({}) as vehicle, connect(vehicle.url) as session:
        status = m.mavlink_map[291](4, 1000, [1, 2, 3, 4], [15.0] * 4, [2.0] * 4)
        with session.listen(("ESC_STATUS",)) as inbox:
            vehicle.send(status)
            assert session.take(inbox, 2.0).rpm == [1, 2, 3, 4]


def test_another_vehicle_on_the_line_is_not_heard():
    with ScriptedAutopilot({}, system=3) as other, connect(other.url, timeout_s=3.0) as session:
        assert session.identity.system == 3
    with ScriptedAutopilot({}, system=3) as other, pytest.raises(LinkError, match="no system 7 heard"):
        connect(other.url, timeout_s=0.7, target_system=7)


def test_the_log_has_a_stamp_and_a_frame_each(tmp_path):
    path = tmp_path / "a.tlog"
    with ScriptedAutopilot({}) as vehicle, connect(vehicle.url, record=path) as session:
        session.wait("HEARTBEAT", 2.0)
    data, kinds, at = path.read_bytes(), [], 0
    reader = m.MAVLink(None)
    while at < len(data):
        (stamp,) = struct.unpack(">Q", data[at : at + 8])
        assert abs(stamp / 1e6 - time.time()) < 60
        length = data[at + 9] + 12
        (message,) = reader.parse_buffer(data[at + 8 : at + 8 + length])
        kinds.append((message.get_type(), message.get_srcSystem()))
        at += 8 + length
    assert ("HEARTBEAT", 1) in kinds and ("HEARTBEAT", 245) in kinds and ("AUTOPILOT_VERSION", 1) in kinds


def _beat_into(write, stop):
    out = m.MAVLink(None, 1, 1)
    while not stop.is_set():
        write(m.MAVLink_heartbeat_message(14, 12, 0, 0, 4, 3).pack(out))
        time.sleep(0.05)


def test_tcp_end_is_noticed():
    with socket.create_server(("127.0.0.1", 0)) as server:
        stop = threading.Event()

        def serve():
            stream, _ = server.accept()
            _beat_into(stream.sendall, stop)
            stream.close()

        thread = threading.Thread(target=serve)
        thread.start()
        with connect(f"tcp:127.0.0.1:{server.getsockname()[1]}") as session:
            assert session.identity.version is None  # it answers no request
            stop.set()
            thread.join()
            with pytest.raises(LinkError, match="closed the connection"):
                session.wait("ATTITUDE", 3.0)


def test_a_serial_line():
    ours, theirs = pty.openpty()
    stop = threading.Event()
    thread = threading.Thread(target=_beat_into, args=(lambda data: os.write(ours, data), stop))
    thread.start()
    try:
        with connect(f"{os.ttyname(theirs)},57600", timeout_s=5.0) as session:
            assert session.identity.is_px4
    finally:
        stop.set()
        thread.join()
        os.close(ours)
        os.close(theirs)


def test_loss_is_measured_from_the_sequence():
    with ScriptedAutopilot({}, seed=4) as vehicle, connect(vehicle.url) as session:
        assert session.loss == 0.0
        vehicle.loss = 0.3
        for _ in range(400):
            vehicle.send(m.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0))
        time.sleep(0.5)
        assert 0.2 < session.loss < 0.4


def test_messages_of_another_dialect_are_not_counted_as_lost():
    with ScriptedAutopilot({}, seed=4) as vehicle, connect(vehicle.url) as session:
        for k in range(100):
            own = ardupilotmega.MAVLink_ahrs_message(0, 0, 0, 0, 0, 0, 0)
            vehicle.send(own if k % 2 else m.MAVLink_attitude_message(k, 0, 0, 0, 0, 0, 0))
        end = time.monotonic() + 600.0
        while (last := session.latest("ATTITUDE")) is None or last.time_boot_ms != 98:
            assert time.monotonic() < end
            time.sleep(0.02)
        assert session.loss < 0.05


class _Rebooting:
    """A session whose vehicle never acknowledges; `stamps` are its clock after each try."""

    address, silence_s = "nowhere", 0.0

    def __init__(self, stamps):
        self.stamps, self.tries = list(stamps), 0

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
