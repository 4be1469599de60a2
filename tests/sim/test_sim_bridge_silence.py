"""Autopilots that fall silent behind the bridges: as the real PX4 does while it exports its parameters, while
it arms, and at any time with nothing to pace it; and such as are stopped, killed and started again."""

import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as m
from test_sim_bridge import Px4Counterpart, packet, running

from sim.bridge import px4_hil
from sim.bridge.hil_messages import HilMessages
from sim.bridge.px4_hil import Px4Bridge
from sim.simulation import Simulation, build_bridge

WORLD = Simulation(Path(__file__).parents[2] / "examples" / "x8_demo.toml")


@contextmanager
def silent_bridge(patience_s: float = 0.05, speed: float = 0.0) -> Iterator[tuple[Px4Bridge, int, list[str]]]:
    reported: list[str] = []
    bridge = build_bridge(WORLD, "px4", "tcpin:127.0.0.1:0", speed, reported.append)
    bridge.patience_s = patience_s
    with running(bridge) as port:
        yield bridge, port, reported


def in_lockstep(port: int, u: float = 0.0) -> Px4Counterpart:
    """A PX4 that has answered what it was sent, and is waited for."""
    px4 = Px4Counterpart(port)
    for _ in range(30):
        px4.sensor()
        px4.controls(px4.last.time_usec, np.full(8, u))
    return px4


def warnings_(reported: list[str]) -> list[str]:
    return [line for line in reported if "HIL_ACTUATOR_CONTROLS" in line]


def test_a_frame_withheld_while_arming_holds_nothing_up_and_is_told_once_a_link() -> None:
    assert px4_hil.PATIENCE_S == 0.2
    with silent_bridge() as (bridge, port, reported):
        for links in (1, 2):
            px4 = in_lockstep(port)
            for _ in range(3):
                before = bridge.timeouts
                px4.sensor()  # not answered
                assert px4.sensor()[0].time_usec and bridge.timeouts > before
                px4.controls(px4.last.time_usec, np.zeros(8))
            assert len(warnings_(reported)) == links and "0.05 s" in warnings_(reported)[-1]
            px4.socket.close()
    assert re.search(rf"2 links, {bridge.timeouts} by the lock-step time-out of 0.05 s", reported[-1]), (
        reported
    )


def test_a_silent_export_runs_on_with_the_last_controls_and_leaves_no_lag() -> None:
    with silent_bridge() as (bridge, port, _):
        px4 = in_lockstep(port, 0.3)
        first, _ = px4.sensor()
        for _ in range(20):  # its parameters go to the card
            last, _ = px4.sensor()
        assert last.time_usec - first.time_usec == 20 * 4000 and bridge.timeouts >= 20
        assert bridge.plant.speeds.min() > 0.0  # a motor that was driven is driven on
        bridge.patience_s = 30.0
        for n in range(40):
            px4.controls(px4.last.time_usec, np.full(8, 0.3))
            px4.sensor()
            assert n < 20 or px4.silent(0.002), "a reading that no controls asked for"
        px4.socket.close()


@pytest.mark.parametrize("speed", [0.0, 20.0])
def test_every_reading_comes_whatever_share_of_the_answers_is_missing(speed: float) -> None:
    with silent_bridge(0.01, speed) as (bridge, port, _):
        px4, random = in_lockstep(port), np.random.default_rng(19)
        stamps = []
        for _ in range(300):
            stamps.append(px4.sensor()[0].time_usec)
            if random.random() > 0.2:
                px4.controls(px4.last.time_usec, np.zeros(8))
        px4.socket.close()
    assert set(np.diff(stamps)) == {4000} and bridge.timeouts >= 30


@pytest.mark.slow
def test_one_that_is_stopped_and_reads_nothing_gives_way_to_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(px4_hil, "GIVE_WAY_S", 0.3)
    with silent_bridge(0.001) as (bridge, port, _):
        stopped = Px4Counterpart.__new__(Px4Counterpart)
        stopped.socket = socket.socket()
        stopped.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stopped.socket.connect(("127.0.0.1", port))
        end, steps = time.monotonic() + 600.0, -1
        while bridge.steps != steps:  # until its buffers are full
            assert time.monotonic() < end
            steps = bridge.steps
            time.sleep(0.3)
        in_lockstep(port).socket.close()
        assert bridge.links == 2
        stopped.socket.close()

    # `running` asserts that its thread has ended


def test_ardupilot_is_told_once_why_it_gets_no_answer() -> None:
    reported: list[str] = []
    bridge = build_bridge(WORLD, "ardupilot", "udpin:127.0.0.1:0", say=reported.append)
    with running(bridge) as port, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ap:
        ap.connect(("127.0.0.1", port))
        ap.settimeout(10.0)
        ap.send(packet(1, np.zeros(8), rate=5))
        ap.send(b"hello")
        ap.send(packet(2, np.zeros(8)))
        assert ap.recv(4096).startswith(b"\n{")
        assert len(reported) == 1 and "5 Hz" in reported[0]
    assert reported[1] == "1 frames, 0 asked for again, 0 lost, 2 packets not answered"


@pytest.mark.slow
def test_the_verb_says_on_stderr_when_lockstep_was_left_and_how_often() -> None:
    command = [sys.executable, "-m", "coaxlink", "sim", "--bridge", "px4", "--speed", "0"]
    command += ["--listen", "tcpin:127.0.0.1:0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        px4 = in_lockstep(int(process.stdout.readline().rpartition(":")[2]))
        for _ in range(3):
            px4.sensor()
        px4.socket.close()
        process.send_signal(signal.SIGTERM)
        _, talk = process.communicate(timeout=600)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0
    assert talk.count("bridge px4: lock-step: no HIL_ACTUATOR_CONTROLS 0.2 s after") == 1
    found = re.search(r"bridge px4: (\d+) steps on 1 link, (\d+) by the lock-step time-out", talk)
    assert found and int(found[2]) >= 2


def test_an_impact_beyond_what_a_message_carries_is_at_its_end() -> None:
    bridge = build_bridge(WORLD, "px4", "tcpin:127.0.0.1:0", 0.0, lambda _: None)
    bridge.close()
    bridge.plant.state[3:6], bridge.plant.out[:3] = (400.0, 0.0, 0.0), (0.0, 0.0, -500.0)
    _, data = HilMessages(bridge.plant, 0).pack(m.MAVLink(None))
    state = {a.get_type(): a for a in m.MAVLink(None).parse_buffer(data)}["HIL_STATE_QUATERNION"]
    assert (state.vx, state.zacc) == (32767, -32768)
