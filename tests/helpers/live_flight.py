"""A stand-in PX4 1.13 in the test's own hands: ticked by the test, in real time or as fast as it goes.

What the motors were told, whether a companion drove them and where the vehicle was is read off the world
itself, tick by tick. `Faults` lies on the vehicle's line and does what lines do when they fail.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import slow_clock
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.mavlink.address import parse_address
from coaxlink.mavlink.session import Session
from coaxlink.mavlink.transport import Udp
from sim.px4.autopilot import Mode
from sim.world import World, build, open_links

EXAMPLES = Path(__file__).parents[2] / "examples"
TICK_S = 0.004
HEIGHT_M = 4.0
AGAIN = 3  # at last 27 times as slow


def real_time(test: Callable[..., None]) -> Callable[..., None]:
    """A test of milliseconds on a machine that others use too.

    A failure is flown again, `AGAIN` times at most, each time on a clock three times as slow (`slow_clock`):
    a fault of the machine goes with that, one of the code does not. pytest counts the repeats.
    """
    return pytest.mark.flaky(reruns=AGAIN)(test)


class Flight:
    """A vehicle in the air."""

    def __init__(
        self,
        own_curve: float = 1.0,
        airborne: bool = True,
        airframe: str = "x8_demo.toml",
        key_file: Path | None = None,
    ) -> None:
        # the vehicle and its companion share one interpreter here: neither may hold it for long
        sys.setswitchinterval(0.0005)
        self.ports = open_links(["udpin:127.0.0.1:0"] * self.links)
        self.address = "udpout:" + self.ports[0].name.partition(":")[2]
        self.standin = build(
            World(EXAMPLES / airframe, firmware=self.firmware, signing_key=key_file), self.ports
        )
        self.autopilot: Any = self.standin.autopilot
        self.rows: list[tuple[float, bool, list[float], float, float]] = []
        self._next = time.monotonic()
        self._own_curve = own_curve
        self.prepare()
        if airborne:
            self.depart()

    firmware = "px4:1.13"
    links = 1

    def prepare(self) -> None:
        """On the ground, before arming."""
        self.autopilot.store.write("THR_MDL_FAC", 9, self._own_curve)

    def depart(self) -> None:
        """To HEIGHT_M, and hold there."""
        self.autopilot.arm()
        self.autopilot.take_off(HEIGHT_M)
        self.rush(12.0)
        assert self.autopilot.mode == Mode.HOLD
        self.rows.clear()

    def close(self) -> None:
        for port in self.ports:
            port.close()

    def rush(self, seconds: float) -> None:
        """As fast as it goes, nobody listening."""
        for _ in range(round(seconds / TICK_S)):
            self._tick()

    def fly(self, seconds: float, until: Callable[[], bool] = lambda: False) -> float:
        """In step with the clock; returns the seconds flown, fewer if `until` came true."""
        start = self._next = time.monotonic()
        for _ in range(round(seconds / TICK_S)):
            self._tick()
            if until():
                break
            self._next += TICK_S
            ahead = self._next - time.monotonic()
            if ahead > 0:
                time.sleep(ahead * slow_clock.factor)
            elif ahead < -0.1:
                self._next = time.monotonic()
        return time.monotonic() - start

    def back_to_hover(self) -> None:
        self.autopilot.go_to((0.0, 0.0, -HEIGHT_M), 0.0)
        self.rush(5.0)
        self.rows.clear()

    def _tick(self) -> None:
        self.standin.tick()
        a = self.autopilot
        _, x, y, _ = a.plant.quaternion.tolist()
        tilt = math.degrees(math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * (x * x + y * y)))))
        self.rows.append((time.monotonic(), self.driven, a.command.tolist(), a.plant.height, tilt))

    @property
    def driven(self) -> bool:
        return bool(self.autopilot.live)

    def outputs_are_sound(self) -> bool:
        u = np.array([row[2] for row in self.rows])
        return bool(np.isfinite(u).all() and (u >= 0.0).all() and (u <= 1.0).all())

    @property
    def lowest_m(self) -> float:
        return min(row[3] for row in self.rows)

    @property
    def steepest_deg(self) -> float:
        return max(row[4] for row in self.rows)

    def own_since(self, since: float) -> float | None:
        """Seconds from `since` to the first tick flown on the autopilot's own mixer for good."""
        found = None
        for at, live, *_ in self.rows:
            if at >= since:
                found = None if live else (at if found is None else found)
        return None if found is None else found - since


class Faults:
    """What a line does when it fails, put where the vehicle's words leave it and others' reach it.

    The companion keeps a socket of its own, so that its compiled loop meets the same faults.
    """

    def __init__(self) -> None:
        self.dead = False
        self.change: Callable[[Any], Any] | None = None  # of demands; it may lose one by returning None
        self._parser = mavlink.MAVLink(None)
        self._packer = mavlink.MAVLink(None, 1, 1)

    def lie_on(self, peer: Any) -> None:
        """On a peer's way there and back, in the shape of the world's own wires."""
        peer.out, peer.back = _Way(self._there), _Way(self._back)

    def _back(self, data: bytes) -> list[bytes]:
        return [] if self.dead else [data]

    def _there(self, data: bytes) -> list[bytes]:
        if self.dead:
            return []
        if self.change is None:
            return [data]
        (message,) = self._parser.parse_buffer(data)
        if message.get_type() != "ACTUATOR_CONTROL_TARGET":
            return [data]
        changed = self.change(message)
        if changed is None or changed is message:
            return [data] if changed is message else []
        self._packer.seq = message.get_seq()
        return [bytes(changed.pack(self._packer))]


class _Way:
    def __init__(self, carry: Callable[[bytes], list[bytes]]) -> None:
        self.carry = carry

    def due(self) -> list[bytes]:
        return []


class Companion:
    """A session on a faulty line; needs the vehicle ticked while it connects."""

    left: ClassVar[list[Companion]] = []  # not closed: they would fly the next test's vehicle

    def __init__(self, flight: Flight, component: int = 191, signer: Any = None, link: int = 0) -> None:
        self.left.append(self)
        address = "udpout:" + flight.ports[link].name.partition(":")[2]
        self.session = Session(Udp(parse_address(address)), address, 245, component, signer=signer)
        starting = threading.Thread(target=self.session.start, args=(5.0,))
        starting.start()
        flight.fly(5.0, until=lambda: not starting.is_alive())
        starting.join()
        self.line = Faults()
        self.line.lie_on(flight.ports[link].peers[-1])

    def close(self) -> None:
        self.left.remove(self)
        self.session.tap = None
        self.session.close()


def demand(time_usec: int, controls: list[float]) -> Any:
    return mavlink.MAVLink_actuator_control_target_message(time_usec, 0, controls)
