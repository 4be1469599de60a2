"""A stand-in, ticked by hand in memory, and someone who talks to it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as m

from firmware_params.px4 import messages
from sim.in_memory import MemoryPort
from sim.simulation import Simulation, build
from sim.standin import Standin

for made in (messages.MAVLink_esc_info_message, messages.MAVLink_esc_status_message):
    m.mavlink_map.setdefault(made.id, made)
X8 = Path(__file__).parents[2] / "examples" / "x8_demo.toml"
GUIDED, RTL, LAND = 4, 6, 9


class Pilot:
    """`now` follows the vehicle's clock: what wall time decides, the ticks decide here."""

    def __init__(self, firmware: str = "px4", ports: int = 1, frame: Path = X8, **world: Any) -> None:
        self.now, self.ports = 0.0, [MemoryPort() for _ in range(ports)]
        for port in self.ports:
            port.put(0, b"")
        self.standin: Standin = build(
            Simulation(frame, firmware=firmware, **world), self.ports, clock=lambda: self.now
        )
        self.autopilot: Any = self.standin.autopilot
        self.copter = firmware == "ardupilot"
        self.mav, self.parser = m.MAVLink(None, srcSystem=255, srcComponent=190), m.MAVLink(None)
        self.parser.robust_parsing = True
        self._raw, self.received = b"", list[Any]()
        self.ground_station()
        self.run(0.1)

    def say(self, *messages: Any, port: int = 0) -> None:
        for message in messages:
            self.ports[port].put(0, message.pack(self.mav))
            self.mav.seq = (self.mav.seq + 1) % 256

    def ground_station(self) -> None:
        self.say(m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))

    def run(self, seconds: float, each: Callable[[], None] = lambda: None) -> None:
        for _ in range(round(250 * seconds)):
            each()
            self.now += 0.004
            self.standin.tick()
        for port in self.ports:
            self._raw += bytes(port.sent[0])
            port.sent[0] = bytearray()

    def until(self, met: Callable[[], bool], seconds: float = 60.0) -> None:
        end = self.now + seconds
        while not met():
            assert self.now < end
            self.run(0.1)

    def heard(self, kind: str) -> list[Any]:
        """Messages of that kind since it was last asked for."""
        self.received += self.parser.parse_buffer(self._raw) or []
        self._raw = b""
        found = [message for message in self.received if message.get_type() == kind]
        self.received = [message for message in self.received if message.get_type() != kind]
        return found

    def answers(self, *messages: Any, kind: str) -> list[Any]:
        """What comes back of that kind within two ticks."""
        self.heard(kind)
        self.say(*messages)
        self.run(0.008)
        return self.heard(kind)

    def command(self, number: int, *p: float) -> int:
        params = [*p, *[0.0] * (7 - len(p))]
        message = m.MAVLink_command_long_message(1, 1, number, 0, *params)
        return int(self.answers(message, kind="COMMAND_ACK")[-1].result)

    def put(self, name: str, value: float) -> None:
        self.autopilot.store.preset(name, value)

    def set(self, name: str, value: float, kind: int = 9) -> list[Any]:
        return self.answers(m.MAVLink_param_set_message(1, 1, name.encode(), value, kind), kind="PARAM_VALUE")

    def climb(self, height: float = 3.0) -> None:
        if self.copter:
            assert self.command(176, 1, GUIDED) == 0
        assert self.command(400, 1) == 0
        nan = math.nan
        assert self.command(22, 0, 0, 0, nan, nan, nan, height if self.copter else 488.0 + height) == 0
        self.run(7.0)
        assert not self.autopilot.landed
