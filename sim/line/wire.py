"""Faults on the wire, by option and seed: loss, copies, disorder, delay, corruption, a link that dies.

They befall whole datagrams (messages, on a stream), both ways; times are wall time since the peer came.
"""

from __future__ import annotations

import heapq
import random
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from sim.errors import SimulationError

Clock = Callable[[], float]  # seconds that only grow


@dataclass(frozen=True)
class WireFaults:
    """Chances a datagram, seconds of delay, spans in which nothing passes."""

    loss: float = 0.0
    copies: float = 0.0
    disorder: float = 0.0  # chance to arrive up to 50 ms late, behind its followers
    corruption: float = 0.0  # chance of one flipped bit
    delay_s: float = 0.0
    dead_s: tuple[tuple[float, float], ...] = ()
    reboot_after_sets: int = 0  # the autopilot reboots when it has taken so many PARAM_SETs; 0: never


def parse_faults(text: str) -> WireFaults:
    """Read `loss=0.02,copies=0.01,disorder=0.05,corruption=0.001,delay=0.02,dead=3:5,reboot=40`.

    Raises WorldError.
    """
    values: dict[str, float] = {}
    dead: list[tuple[float, float]] = []
    names = ("loss", "copies", "disorder", "corruption", "delay", "reboot")
    for item in filter(None, text.split(",")):
        key, _, value = item.partition("=")
        try:
            if key == "dead":
                first, last = (float(part) for part in value.split(":"))
                dead.append((first, last))
            elif key in names:
                values[key] = float(value)
            else:
                raise ValueError
        except ValueError:
            known = ", ".join(f"{name}=NUMBER" for name in names)
            raise SimulationError("--wire", item, f"{known} or dead=FROM:TO is expected") from None
    get = {name: values.get(name, 0.0) for name in names}
    if any(not 0.0 <= get[name] <= 1.0 for name in names[:4]) or get["delay"] < 0:
        raise SimulationError("--wire", text, "chances from 0 to 1 and a positive delay are expected")
    return WireFaults(
        get["loss"],
        get["copies"],
        get["disorder"],
        get["corruption"],
        get["delay"],
        tuple(dead),
        int(get["reboot"]),
    )


@dataclass
class Wire:
    """One direction of one link."""

    faults: WireFaults
    seed: int
    clock: Clock = time.monotonic
    _late: list[tuple[float, int, bytes]] = field(default_factory=list)
    _count: int = 0

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)
        self._start = self.clock()

    def carry(self, data: bytes) -> list[bytes]:
        """What arrives at once of a datagram sent now; the rest comes out of `due`."""
        f, draw = self.faults, self._random.random
        now = self.clock() - self._start
        # every datagram draws the same numbers, so that one fault does not shift all others
        lost, copied, late, corrupted = (
            draw() < f.loss,
            draw() < f.copies,
            draw() < f.disorder,
            draw() < f.corruption,
        )
        bit, lag = self._random.randrange(8 * max(len(data), 1)), 0.05 * draw()
        if lost or any(a <= now < b for a, b in f.dead_s):
            return []
        if corrupted and data:
            changed = bytearray(data)
            changed[bit // 8] ^= 1 << bit % 8
            data = bytes(changed)
        wait = f.delay_s + (lag if late else 0.0)
        arrivals = [data] * (1 + copied)
        if wait <= 0:
            return arrivals
        for one in arrivals:
            self._count += 1
            heapq.heappush(self._late, (now + wait, self._count, one))
        return []

    def due(self) -> list[bytes]:
        """Late datagrams whose time has come."""
        now, out = self.clock() - self._start, []
        while self._late and self._late[0][0] <= now:
            out.append(heapq.heappop(self._late)[2])
        return out
