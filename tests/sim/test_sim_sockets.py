"""What goes through real sockets and processes: TCP, a port that is taken, logs."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ground import client, get
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as m
from sim_pilot import Pilot

from sim.errors import SimError, SimulationError
from sim.line.links import open_port, wait
from sim.recorder import CsvRecorder, TlogPort
from sim.testing import standin


@pytest.mark.slow
def test_tcp_serves_two_clients_and_outlives_them() -> None:
    with standin("--speed", "4", kind="tcpin") as port:
        with client(port, "tcp", "common") as a, client(port, "tcp", "common") as b:
            assert get(a, "ATTITUDE") is not None and get(b, "ATTITUDE") is not None
        with client(port, "tcp", "common") as again:
            assert get(again, "ATTITUDE") is not None


@pytest.mark.slow
def test_a_busy_port_is_one_clear_line() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"udpin:127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(SimError, match="cannot be opened") as caught, standin("--listen", address):
            pass
        assert "\n" not in str(caught.value) and "Traceback" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_logs_of_a_clients_flight_agree_and_are_stamped_by_the_vehicles_clock(
    tmp_path: Path, firmware: str
) -> None:
    csv, tlog = tmp_path / "a.csv", tmp_path / "a.tlog"
    pilot = Pilot(firmware, wire="loss=0.1")
    pilot.standin.recorder = CsvRecorder(pilot.autopilot, csv)
    pilot.standin.ports.append(TlogPort(pilot.autopilot, tlog))
    if pilot.copter:
        pilot.autopilot.set_ap_mode(4)
    pilot.autopilot.arm()
    pilot.autopilot.take_off(2.0)
    pilot.run(6.0)
    pilot.standin.recorder.close()
    pilot.standin.ports[-1].close()
    rows = np.genfromtxt(csv, delimiter=",", names=True)
    assert rows["height_m"].max() > 1.5 and np.diff(rows["time_s"]) == pytest.approx(0.008)
    reader = mavutil.mavlink_connection(str(tlog), dialect="ardupilotmega")
    by_type: dict[str, list] = {}
    while (message := reader.recv_match()) is not None:
        by_type.setdefault(message.get_type(), []).append(message)
    reader.close()
    assert {"HEARTBEAT", "ATTITUDE", "LOCAL_POSITION_NED", "SERVO_OUTPUT_RAW", "DISTANCE_SENSOR"} <= set(
        by_type
    )
    positions = by_type["LOCAL_POSITION_NED"]
    gaps = np.diff([p.time_boot_ms for p in positions])
    assert np.median(gaps) == 20 and gaps.max() <= 24  # none lost: the log has no wire
    assert positions[-1]._timestamp == pytest.approx(positions[-1].time_boot_ms / 1000, abs=0.01)
    assert max(-p.z for p in positions) == pytest.approx(rows["height_m"].max() - 0.2, abs=0.15)


def brought(port: Any) -> list[Any]:
    for _ in range(50):
        wait([port], 0.2)
        if found := port.receive():
            return found
    raise AssertionError("nothing came")


def test_each_kind_of_port_brings_what_comes_and_lets_go_of_who_went() -> None:
    beat = m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    frame = beat.pack(m.MAVLink(None, 255, 190))
    udp, tcp = open_port("udpin:127.0.0.1:0"), open_port("tcpin:127.0.0.1:0")
    out = open_port("udpout:" + udp.name.partition(":")[2])
    stream = socket.create_connection(("127.0.0.1", int(tcp.name.rpartition(":")[2])))
    out.peers[0].send(beat)
    stream.sendall(frame)
    for port in (udp, tcp):
        (peer, data), *_ = brought(port)
        assert [found.get_type() for found in peer.parse(data)] == ["HEARTBEAT"]
        peer.send(beat)
    assert stream.recv(300).startswith(b"\xfd")
    assert brought(out)[0][0] is out.peers[0]
    stream.close()
    wait([tcp], 5.0)
    assert tcp.receive() == [] and tcp.peers == []
    out.close()
    udp.peers[0].heard_at -= 60.0  # silent for a minute
    udp._looked_at = 0.0
    assert udp.receive() == [] and udp.peers == []
    for port in (udp, tcp):
        port.close()
    for wrong in ("udpin", "radio:1:2", "udpin:127.0.0.1:99999"):
        with pytest.raises(SimulationError, match="expected"):
            open_port(wrong)
