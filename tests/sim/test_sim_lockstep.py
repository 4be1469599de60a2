"""In lock-step the world stands still until whoever flies it has answered."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as m

from sim.px4.autopilot import Goal, Mode
from sim.world import World, build, open_links

X8 = Path(__file__).parents[2] / "examples" / "x8_demo.toml"
SLOW_S = 0.02  # five ticks of a world in real time, and many more of one without a pace


class Pilot:
    """Reads all that the vehicle says; answers each position as `answer` does, after SLOW_S."""

    def __init__(self, port: int) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.socket.settimeout(0.1)
        self.parser, self.packer = m.MAVLink(None), m.MAVLink(None, 245, 191)
        self.parser.robust_parsing = True
        self.heard: list[int] = []  # stamps of positions, ms
        self.answer = self.follow
        self.done = False
        self.say(m.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))

    def say(self, message: Any) -> None:
        self.socket.send(message.pack(self.packer))

    def follow(self, stamp_ms: int) -> None:
        still = (0.0, 0.0, -3.0, *[0.0] * 8)
        self.say(m.MAVLink_set_position_target_local_ned_message(stamp_ms, 1, 1, 1, 0b100111111000, *still))

    def ask(self, stamp_ms: int) -> None:
        self.say(m.MAVLink_command_long_message(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0))

    def listen(self) -> None:
        while not self.done:
            try:
                data = self.socket.recv(2048)
            except TimeoutError:
                continue
            for message in self.parser.parse_buffer(data) or []:
                if message.get_type() == "LOCAL_POSITION_NED":
                    time.sleep(SLOW_S)
                    self.heard.append(message.time_boot_ms)
                    self.answer(message.time_boot_ms)


@pytest.fixture
def flight() -> Iterator[tuple[Any, Pilot]]:
    ports = open_links(["udpin:127.0.0.1:0"])
    standin = build(World(X8, lockstep=True), ports, 0.0)
    a = standin.autopilot
    a.arm()
    a.take_off(3.0)
    for _ in range(1500):
        standin.tick()
    pilot = Pilot(int(ports[0].name.rpartition(":")[2]))
    a.offboard(Goal((0.0, 0.0, -3.0), (0.0, 0.0, 0.0)))
    a.set_mode(Mode.OFFBOARD)
    thread = threading.Thread(target=pilot.listen)
    thread.start()
    yield standin, pilot
    pilot.done = True
    thread.join()
    pilot.socket.close()
    for port in ports:
        port.close()


def test_every_position_is_answered_before_time_goes_on(flight: tuple[Any, Pilot]) -> None:
    standin, pilot = flight
    lags = []
    for _ in range(250):
        before = len(pilot.heard)
        standin.tick()
        if len(pilot.heard) > before:  # the tick that told it is the tick in which it was answered
            lags.append(round(1e3 * standin.autopilot.reading.time_s) - pilot.heard[-1])
    assert len(pilot.heard) >= 28  # 30 a second, asked or not
    assert len(set(lags)) == 1, lags
    assert standin.autopilot.mode == Mode.OFFBOARD


def test_a_command_ends_the_wait_and_so_does_the_end_of_the_world(flight: tuple[Any, Pilot]) -> None:
    standin, pilot = flight
    pilot.answer = pilot.ask
    started = time.monotonic()
    for _ in range(25):
        standin.tick()
    assert pilot.heard and time.monotonic() - started < 5.0
    pilot.answer = lambda _: None
    standin.stop = lambda: True
    started = time.monotonic()
    for _ in range(25):
        standin.tick()
    assert time.monotonic() - started < 5.0
