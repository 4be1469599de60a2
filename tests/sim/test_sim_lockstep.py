"""In lock-step the world stands still until whoever flies it has answered."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as m
from sim_pilot import X8

from sim.in_memory import MemoryPort
from sim.px4.autopilot import Goal, Mode
from sim.simulation import Simulation, build


class Answering(MemoryPort):
    """One who answers each position that the vehicle tells, before time goes on."""

    def __init__(self) -> None:
        super().__init__()
        self.parser, self.packer = m.MAVLink(None), m.MAVLink(None, 245, 191)
        self.heard: list[int] = []  # stamps of positions, ms
        self.answer: Callable[[int], Any] = lambda stamp_ms: None
        self.put(0, m.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(self.packer))

    def sendto(self, data: bytes, address: tuple[int]) -> None:
        for message in self.parser.parse_buffer(data) or []:
            if message.get_type() == "LOCAL_POSITION_NED":
                self.heard.append(message.time_boot_ms)
                if (answer := self.answer(message.time_boot_ms)) is not None:
                    self.put(0, answer.pack(self.packer))


@pytest.fixture
def flight() -> tuple[Any, Answering]:
    port = Answering()
    standin = build(Simulation(X8, lockstep=True), [port], 0.0)
    a = standin.autopilot
    a.arm()
    a.take_off(3.0)
    for _ in range(1500):
        standin.tick()
    a.offboard(Goal((0.0, 0.0, -3.0), (0.0, 0.0, 0.0)))
    a.set_mode(Mode.OFFBOARD)
    port.heard.clear()
    return standin, port


def test_every_position_is_answered_before_time_goes_on(flight: tuple[Any, Answering]) -> None:
    standin, pilot = flight
    still = (0.0, 0.0, -3.0, *[0.0] * 8)
    pilot.answer = lambda ms: m.MAVLink_set_position_target_local_ned_message(ms, 1, 1, 1, 0xDF8, *still)
    for _ in range(250):
        before = len(pilot.heard)
        standin.tick()
        if len(pilot.heard) > before:  # the tick that told it is the tick in which it was answered
            assert standin._heard["goal"] == 1000 * pilot.heard[-1]
    assert len(pilot.heard) >= 28  # 30 a second, asked or not
    assert standin.autopilot.mode == Mode.OFFBOARD


def test_a_command_ends_the_wait_and_so_does_the_end_of_the_world(flight: tuple[Any, Answering]) -> None:
    standin, pilot = flight
    pilot.answer = lambda ms: m.MAVLink_command_long_message(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0)
    for _ in range(25):
        standin.tick()
    assert pilot.heard
    determined = len(pilot.heard)
    pilot.answer = lambda ms: None
    standin.stop = lambda: True
    for _ in range(25):
        standin.tick()
    assert len(pilot.heard) > determined
