"""Scripted counterparts of the real autopilots, following their interfaces step by step, fly the plant."""

import json
import math
import os
import select
import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as m

from sim.bridge.ardupilot_json import ArduPilotBridge
from sim.bridge.px4_hil import Px4Bridge
from sim.errors import PortError, SimulationError
from sim.physics.power_module import PowerModule
from sim.physics.sensors import SensorReading
from sim.px4.cascade import Cascade, Four, Goal, Three
from sim.px4.mixer import Px4Mixer
from sim.px4.store import Px4Store
from sim.px4.tuning import tune
from sim.simulation import Simulation, build_bridge
from sim.testing import standin

EXAMPLES = Path(__file__).parents[2] / "examples"
SECONDS = int(os.environ.get("BRIDGE_SECONDS", "20"))  # 600 for the ten minutes
WORLD = Simulation(EXAMPLES / "x8_demo.toml")


class Pilot:
    """Control laws for a counterpart: hover at 3 m, then a circle around 4.5 m."""

    def __init__(self, bridge: Px4Bridge | ArduPilotBridge, rate_hz: float) -> None:
        store = Px4Store((1, 16, 1), bridge.plant.vehicle)
        self._mixer = Px4Mixer(store, 8)
        tuned = tune(self._mixer, bridge.plant)
        store.preset("MPC_THR_HOVER", tuned.hover)
        for axis, gains in zip(("ROLL", "PITCH", "YAW"), tuned.gains, strict=True):
            for letter, gain in zip("PID", gains, strict=True):
                store.preset(f"MC_{axis}RATE_{letter}", gain)
        self._cascade = Cascade(store, 1.0 / rate_hz)

    def goal(self, t: float) -> Goal:
        up = -min(0.75 * t, 3.0) if t < 8.0 else -4.5
        if t < 8.0:
            return Goal((0.0, 0.0, up))
        a = 2 * math.pi * (t - 8.0) / 8.0
        r, w = 2.0 * min((t - 8.0) / 4.0, 1.0), 2 * math.pi / 8.0
        velocity = (-r * w * math.sin(a), r * w * math.cos(a), 0.0)
        return Goal((r * math.cos(a), r * math.sin(a), up), velocity)

    def fly(self, t: float, position: Three, velocity: Three, attitude: Four, rates: Three) -> np.ndarray:
        values = np.array([0.0, 0.0, 0.0, *rates, *attitude, *position, *velocity, 0.0, 0.0])
        d = self._cascade.track(self.goal(t), SensorReading(t, values, 0.0))
        return self._mixer.command(d.roll, d.pitch, d.yaw, d.thrust)


@contextmanager
def running(bridge: Px4Bridge | ArduPilotBridge) -> Iterator[int]:
    stop = threading.Event()
    thread = threading.Thread(target=bridge.run, args=(stop.is_set,))
    thread.start()
    try:
        yield int(bridge.name.rpartition(":")[2])
    finally:
        stop.set()
        thread.join(10.0)
        bridge.close()
        assert not thread.is_alive()


class Px4Counterpart:
    """What PX4 does at its end of the TCP link: parse, and answer every HIL_SENSOR with controls."""

    def __init__(self, port: int, system: int = 1) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), 5.0)
        self.socket.settimeout(5.0)
        self.out, self.into = m.MAVLink(None, srcSystem=system, srcComponent=1), m.MAVLink(None)
        self.fields: list[int] = []
        self.gps = 0
        self.accel: list[float] = []
        self._queue: list = []

    def sensor(self) -> tuple:
        """The next HIL_SENSOR and the state that came with it."""
        while True:
            while self._queue:
                message = self._queue.pop(0)
                kind = message.get_type()
                if kind == "HIL_SENSOR":
                    self.last = message
                    self.fields.append(message.fields_updated)
                    self.accel.append(message.zacc)
                elif kind == "HIL_GPS":
                    self.gps += 1
                elif kind == "HIL_STATE_QUATERNION":
                    return self.last, message
            self._queue += self.into.parse_buffer(self.socket.recv(65536)) or []

    def silent(self, seconds: float) -> bool:
        """Whether nothing more comes for so long."""
        return not self._queue and not select.select([self.socket], [], [], seconds)[0]

    def controls(self, time_usec: int, u: np.ndarray) -> None:
        values = [*np.round(u, 3).tolist(), *[0.0] * (16 - len(u))]
        self.socket.sendall(m.MAVLink_hil_actuator_controls_message(time_usec, values, 128, 1).pack(self.out))


@pytest.mark.slow
def test_px4_lockstep_hover_and_circle_without_a_missed_step() -> None:
    bridge = build_bridge(WORLD, "px4", "tcpin:127.0.0.1:0")
    pilot = Pilot(bridge, 250.0)
    with running(bridge) as port:
        px4 = Px4Counterpart(port)
        for _ in range(17):  # it listens a while before its first controls
            first, _ = px4.sensor()
        start, stamps, far = first.time_usec, [], 0.0
        while (px4.last.time_usec - start) < SECONDS * 1e6:
            p = bridge.plant  # in lockstep it stands still while we think
            t = (px4.last.time_usec - start) / 1e6
            u = pilot.fly(
                t,
                tuple(p.position.tolist()),
                tuple(p.velocity.tolist()),
                tuple(p.quaternion.tolist()),
                tuple(p.rates.tolist()),
            )
            if t > 16.0:
                far = max(far, math.dist(p.position, pilot.goal(t).position))
            px4.controls(px4.last.time_usec, u)
            sensor, state = px4.sensor()
            stamps.append(sensor.time_usec)
            assert state.time_usec == sensor.time_usec
        px4.socket.close()
    assert set(np.diff(stamps)) == {4000} and abs(bridge.steps - 17 - len(stamps)) < 6
    assert far < 1.2 and -bridge.plant.position[2] == pytest.approx(4.5, abs=0.3)
    slow = sum(f == 0x7 | 0x38 | 0x1C0 | 0x1A00 for f in px4.fields)
    assert slow == pytest.approx(len(px4.fields) / 5, abs=2) and set(px4.fields) == {0x3F, 0x1BFF}
    assert px4.gps == pytest.approx(len(px4.fields) / 25, abs=2)
    assert (np.diff(px4.accel) == 0.0).mean() < 1e-3  # noise: a dead sensor repeats itself


def test_px4_answers_to_the_free_run_do_not_stay_ahead() -> None:
    bridge = build_bridge(WORLD, "px4", "tcpin:127.0.0.1:0")
    with running(bridge) as port:
        px4 = Px4Counterpart(port)
        stamps = [px4.sensor()[0].time_usec for _ in range(17)]
        for stamp in stamps[-4:]:  # it starts up late, and answers all that it has, one by one
            px4.controls(stamp, np.zeros(8))
            time.sleep(0.01)
        for n in range(80):  # in order, whatever came in the meantime
            px4.sensor()
            if n > 50:
                assert px4.silent(0.002), "a reading that no controls asked for"
            px4.controls(px4.last.time_usec, np.zeros(8))
        px4.socket.close()
    assert 1 <= bridge.stale < 40


def packet(count: int, u: np.ndarray, rate: int = 400) -> bytes:
    pulses = [*(1000 + 1000 * u).astype(int).tolist(), *[0] * (16 - len(u))]
    return struct.pack("<HHI16H", 18458, rate, count, *pulses)


def as_its_parser_reads(line: str, section: str, key: str, count: int) -> list[float]:
    """ArduPilot's own way: the section's word, then the key's, then the bracket two characters behind it."""
    p = line.index(section) + len(section) + 1
    p = line.index(key, p) + len(key) + 2
    assert line[p] == "[", line[p - 20 : p + 20]
    numbers = [float(part) for part in line[p + 1 : line.index("]", p)].split(",")]
    assert len(numbers) == count
    return numbers


@pytest.mark.slow
def test_ardupilot_frames_hover_and_circle_without_a_lost_one() -> None:
    bridge = build_bridge(WORLD, "ardupilot", "udpin:127.0.0.1:0")
    pilot = Pilot(bridge, 400.0)
    with running(bridge) as port, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ap:
        ap.connect(("127.0.0.1", port))
        ap.settimeout(5.0)
        u, state, far = np.zeros(8), {}, 0.0
        for count in range(1, 400 * SECONDS):
            ap.send(packet(count, u))
            if count % 500 == 0:
                ap.send(packet(count, u))  # impatient: it asks again, and must get the same answer
                assert ap.recv(4096) == ap.recv(4096)
                continue
            reply = ap.recv(4096)
            assert reply.startswith(b"\n{") and reply.endswith(b"}\n")
            assert reply.find(b"velocity") == reply.rfind(b"velocity")
            state = json.loads(reply)
            if count % 400 == 1:
                assert as_its_parser_reads(reply.decode(), "imu", "gyro", 3) == state["imu"]["gyro"]
                assert (
                    as_its_parser_reads(reply.decode(), "imu", "accel_body", 3) == state["imu"]["accel_body"]
                )
                assert as_its_parser_reads(reply.decode(), "", "quaternion", 4) == state["quaternion"]
            t = state["timestamp"]
            position, velocity = tuple(state["position"]), tuple(state["velocity"])
            u = pilot.fly(t, position, velocity, tuple(state["quaternion"]), tuple(state["imu"]["gyro"]))
            if t > 16.0:
                far = max(far, math.dist(position, pilot.goal(t).position))
    assert state["timestamp"] == pytest.approx(SECONDS, abs=0.01) and bridge.lost == 0
    assert bridge.steps == 400 * SECONDS - 1 and bridge.repeats == (400 * SECONDS - 1) // 500 and far < 1.2
    assert state["position"][2] == pytest.approx(-4.5, abs=0.3)


def test_ardupilot_starts_over_and_sends_rubbish() -> None:
    bridge = build_bridge(WORLD, "ardupilot", "udpin:127.0.0.1:0")
    try:
        for count in range(1, 1200):
            bridge.answer(packet(count, np.full(8, 0.8)))
        assert bridge.plant.height > 3.0
        state = json.loads(bridge.answer(packet(0, np.zeros(8))))
        assert abs(state["position"][2]) < 0.05 and state["timestamp"] == pytest.approx(1 / 400)
        long = struct.pack("<HHI32H", 29569, 1200, 1, *[1000] * 32)
        assert json.loads(bridge.answer(long))["imu"]["accel_body"][2] == pytest.approx(-9.8, abs=0.5)
        for rubbish in (
            b"",
            b"hello",
            packet(5, np.zeros(8))[:-1],
            struct.pack("<HHI16H", 1, 400, 9, *[0] * 16),
        ):
            assert bridge.answer(rubbish) == b""
    finally:
        bridge.close()


@pytest.mark.slow
def test_the_verb_opens_bridges_and_says_no_in_one_line() -> None:
    with standin("--bridge", "px4", kind="tcpin") as port:
        px4 = Px4Counterpart(port)
        assert px4.sensor()[0].fields_updated & 0x3F == 0x3F
        px4.socket.close()
    with pytest.raises(SimulationError, match="px4 or ardupilot"):
        build_bridge(WORLD, "betaflight")
    with pytest.raises(SimulationError, match="tcpin"):
        build_bridge(WORLD, "px4", "udpin:127.0.0.1:0")
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(PortError, match="cannot be opened"):
            build_bridge(WORLD, "px4", f"tcpin:127.0.0.1:{taken.getsockname()[1]}")


def test_the_pack_is_told_to_the_instance_that_listens_beside() -> None:
    """As a smart battery of PX4's own system, the sum of its cells and the amps as the power module reads."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        instance, bridge = _free_instance(line)
        line.settimeout(5.0)
        bridge.plant.sensing.power_module = PowerModule(scale=2.0)
        with running(bridge) as port:
            assert port == 4560 + instance
            px4 = Px4Counterpart(port, instance + 1)
            for _ in range(17):
                stamp, _ = px4.sensor()
            heard = []
            for _ in range(500):
                px4.controls(stamp.time_usec, np.full(8, 0.5))
                stamp, _ = px4.sensor()
            line.settimeout(0.2)
            with suppress(TimeoutError):
                while True:
                    heard += m.MAVLink(None).parse_buffer(line.recv(4096))
            px4.socket.close()
    told = heard[-1]
    assert {(a.get_srcSystem(), a.get_srcComponent(), a.get_type()) for a in heard} == {
        (instance + 1, 180, "BATTERY_STATUS")
    }
    assert len(heard) >= 20  # ten a second
    volts = sum(v for v in told.voltages if v < 0xFFFF) / 1000.0
    assert volts == pytest.approx(bridge.plant.voltage, abs=0.5)
    assert told.current_battery / 100.0 == pytest.approx(2.0 * bridge.plant.current, rel=0.1)
    assert 90 <= told.battery_remaining <= 95 and told.current_consumed >= 0


def _free_instance(line: socket.socket) -> tuple[int, Px4Bridge]:
    for instance in range(60, 100):
        with suppress(PortError):
            bridge = build_bridge(WORLD, "px4", f"tcpin:127.0.0.1:{4560 + instance}", battery=True)
            try:
                line.bind(("127.0.0.1", 14280 + instance))
            except OSError:
                bridge.close()
                continue
            assert isinstance(bridge, Px4Bridge)
            return instance, bridge
    raise AssertionError("no instance of PX4 is free on this machine")


def test_ardupilot_reads_the_amps_of_the_power_module() -> None:
    bridge = build_bridge(WORLD, "ardupilot", "udpin:127.0.0.1:0")
    bridge.plant.sensing.power_module = PowerModule(offset_A=7.0)
    try:
        for count in range(1, 500):
            answer = bridge.answer(struct.pack("<HHI16H", 18458, 400, count, *[1500] * 16))
        told = json.loads(answer)["battery"]
    finally:
        bridge.close()
    assert told["current"] == pytest.approx(bridge.plant.current + 7.0, rel=0.02)
    assert told["voltage"] == pytest.approx(bridge.plant.voltage)
