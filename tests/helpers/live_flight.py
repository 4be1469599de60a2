"""A stand-in in the air and the companions on its lines, in memory on one virtual clock: no thread, no sleep.

What the motors were told, whether a companion drove them and where the vehicle was is read off the world
itself, tick by tick (`Flight.rows`). `Companion.line` does what lines do when they fail.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from memory_net import Line, Net
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.airframe import load_airframe
from coaxlink.live.mixer import LiveMixer
from coaxlink.mavlink.session import Session
from coaxlink.rotor.model import load_rotor_model
from coaxlink.vehicle import Vehicle
from sim.in_memory import MemoryPort
from sim.px4.autopilot import Mode
from sim.simulation import Simulation, build

EXAMPLES = Path(__file__).parents[2] / "examples"
TICK_S = 0.004
HEIGHT_M = 4.0
X8 = load_airframe(EXAMPLES / "x8_demo.toml")
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")


class Row(NamedTuple):
    """One tick of the world."""

    time_s: float
    driven: bool  # by a companion
    commands: list[float]
    height_m: float
    tilt_deg: float


class Flight:
    """A vehicle in the air, that lives while somebody waits on its clock."""

    firmware, links = "px4:1.13", 1

    def __init__(
        self,
        *,
        airborne: bool = True,
        airframe: str | Path = "x8_demo.toml",
        key_file: Path | None = None,
        **world: Any,
    ) -> None:
        """`airframe` is a file of `examples`, or any other by its whole path; `world` as `World` has it."""
        self.net = Net()
        self.net.delay_s = 0.0005
        self.clock = self.net.clock
        self.ports = [MemoryPort() for _ in range(self.links)]
        self.addresses = [self.net.address() for _ in self.ports]
        whole = Simulation(EXAMPLES / airframe, firmware=self.firmware, signing_key=key_file, **world)
        self.standin = build(whole, self.ports, clock=self.clock.monotonic)
        self.autopilot: Any = self.standin.autopilot
        self.rows: list[Row] = []
        self.companions: dict[Any, Any] = {}  # by their addresses, each with its `line`
        self.peers: list[list[tuple[Any, Companion | None]]] = [[] for _ in self.ports]
        for link, address in enumerate(self.addresses):
            self.net.bind(address, lambda data, source, link=link: self._hear(link, data, source))
        self.prepare()
        self._tick()
        if airborne:
            self.depart()

    def prepare(self) -> None:
        """On the ground, before arming."""
        self.autopilot.store.write("THR_MDL_FAC", 9, 1.0)

    def depart(self) -> None:
        """To HEIGHT_M, and hold there."""
        self.autopilot.arm()
        self.autopilot.take_off(HEIGHT_M)
        self.clock.sleep(12.0)
        assert self.autopilot.mode == Mode.HOLD
        self.rows.clear()

    def url(self, link: int = 0) -> str:
        host, port = self.addresses[link]
        return f"udpout:{host}:{port}"

    def fly(self, seconds: float, until: Callable[[], bool] = lambda: False) -> float:
        """Let time pass, less if `until` comes true; the seconds that passed."""
        start = self.clock.monotonic()
        while self.clock.monotonic() < start + seconds - 1e-9 and not until():
            self.clock.sleep(min(TICK_S, start + seconds - self.clock.monotonic()))
        return self.clock.monotonic() - start

    # -- the world -----------------------------------------------------------------------------------------

    def _hear(self, link: int, data: bytes, source: Any) -> None:
        known = [address for address, _ in self.peers[link]]
        if source not in known:
            self.peers[link].append((source, self.companions.get(source)))
            known.append(source)
        number, port = known.index(source), self.ports[link]
        companion = self.peers[link][number][1]
        if companion is None:
            port.put(number, data)
        elif not companion.line.loses(data):
            self.clock.later(companion.line.late_s, lambda: port.put(number, data))

    def forget(self, companion: Companion) -> None:
        """Nobody is there any more."""
        for link, port in enumerate(self.ports):
            numbers = [(n,) for n, (_, who) in enumerate(self.peers[link]) if who is companion]
            port.peers = [peer for peer in port.peers if peer.address not in numbers]

    def _tick(self) -> None:
        self.standin.tick()
        for link, port in enumerate(self.ports):
            for number, (address, companion) in enumerate(self.peers[link]):
                data, port.sent[number] = bytes(port.sent[number]), bytearray()
                for one in companion.line.there(data) if companion else [data]:
                    if one:
                        self.net.send(one, self.addresses[link], address)
        a = self.autopilot
        _, x, y, _ = a.plant.quaternion.tolist()
        tilt = math.degrees(math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * (x * x + y * y)))))
        self.rows.append(Row(self.clock.now, self.driven, a.command.tolist(), a.plant.height, tilt))
        self.clock.later(TICK_S, self._tick)

    @property
    def driven(self) -> bool:
        return bool(self.autopilot.live)

    # -- what became of it -----------------------------------------------------------------------------------

    def outputs_are_sound(self) -> bool:
        u = np.array([row.commands for row in self.rows])
        return bool(np.isfinite(u).all() and (u >= 0.0).all() and (u <= 1.0).all())

    def own_since(self, since: float) -> float | None:
        """Seconds from `since` to the first tick flown on the autopilot's own mixer for good."""
        found = None
        for row in self.rows:
            if row.time_s >= since:
                found = None if row.driven else (row.time_s if found is None else found)
        return None if found is None else found - since

    def stays_up(self, seconds: float = 3.0) -> None:
        """The vehicle neither hits the ground nor tips over, and every output was sound."""
        self.clock.sleep(seconds)
        assert self.outputs_are_sound()
        assert min(row.height_m for row in self.rows) > 1.0
        assert max(row.tilt_deg for row in self.rows) < 25.0
        assert not self.autopilot.landed
        assert abs(self.autopilot.plant.velocity[2]) < 0.5


class Faults:
    """What a line does when it fails."""

    def __init__(self) -> None:
        self.dead, self.late_s = False, 0.0  # late: what the companion says
        self.clock_us = 0  # by which the vehicle's clock jumped
        self.change: Callable[[Any], Any] | None = None  # of demands; None instead of one loses it
        self.steal: Callable[[bytes], bool] = lambda data: False  # of what the companion says
        self._parser, self._packer = mavlink.MAVLink(None), mavlink.MAVLink(None, 1, 1)

    def loses(self, data: bytes) -> bool:
        """On the way to the vehicle."""
        return self.dead or self.steal(data)

    def there(self, data: bytes) -> list[bytes]:
        if self.dead or (self.change is None and not self.clock_us):
            return [] if self.dead else [data]
        out = []
        for message in self._parser.parse_buffer(data) or []:
            reported, kind = message, message.get_type()
            if kind == "ACTUATOR_CONTROL_TARGET":
                reported = demand(max(message.time_usec + self.clock_us, 0), list(message.controls))
                reported = self.change(reported) if self.change else reported
            elif kind == "TIMESYNC" and message.tc1:
                reported = mavlink.MAVLink_timesync_message(message.tc1 + 1000 * self.clock_us, message.ts1)
            if reported is message:
                out.append(bytes(message.get_msgbuf()))
            elif reported is not None:
                self._packer.seq = message.get_seq()
                out.append(bytes(reported.pack(self._packer)))
        return [b"".join(out)]


class LiveLine(Line):
    """Looks about as often as a live loop ticks."""

    def _look_about(self) -> None:
        if self._turn is not None and self._turn(0.0):
            self.net.clock.later(0.005, self._look_about)


class Companion:
    """A session on a line of a vehicle, and a live mixer on it."""

    def __init__(self, flight: Flight, component: int = 191, *, link: int = 0, signer: Any = None) -> None:
        self.flight, self.line = flight, Faults()
        line = LiveLine(flight.net, flight.addresses[link])
        flight.companions[line.address] = self
        self.address = line.address
        self.session = Session(line, flight.url(link), 245, component, signer=signer, clock=flight.clock)
        self.session.start(5.0)

    def mix(self, law: Any = "exact", vehicle: Vehicle | None = None, **options: Any) -> LiveMixer:
        """A live mixer that has begun."""
        mixer = LiveMixer(self.session, vehicle or Vehicle(X8, CRM), law, own_curve=1.0, **options)
        mixer.start()
        return mixer

    def until_live(self, mixer: LiveMixer) -> None:
        self.flight.fly(3.0, until=lambda: mixer.state == "live")
        assert mixer.state == "live"
        self.flight.fly(0.3)
        self.flight.rows.clear()

    def close(self) -> None:
        self.session.tap = None
        self.session.close()
        self.flight.forget(self)


def demand(time_usec: int, controls: list[float]) -> Any:
    return mavlink.MAVLink_actuator_control_target_message(time_usec, 0, controls)
