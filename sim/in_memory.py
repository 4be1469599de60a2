"""A stand-in autopilot without sockets, threads or sleep: bytes in, bytes out, on the caller's clock.

    board = InMemory(World(Path("examples/x8_demo.toml")))  # or firmware="ardupilot", wire="loss=0.1"
    answers = board.exchange(b"", 0.0)                      # the first call sets its clock
    answers = board.exchange(heartbeat + request, 0.02)     # MAVLink frames, as a link carries them
    answers = board.exchange(b"", 1.5, client=1)            # a second ground station

It is the stand-in of `coaxlink sim`, its clock (link pace, reboot, faults on the wire) and its transport
exchanged: what a session would read from a socket until `now_s` is what `exchange` returns.
"""

from __future__ import annotations

import socket
from collections import deque

from sim.line.links import Peer, Port
from sim.px4.autopilot import RATE_HZ
from sim.simulation import Simulation, build

TICK_S = 1.0 / RATE_HZ


class MemoryPort(Port):
    """Clients of this process, by number; what is sent to each waits in `sent`."""

    def __init__(self) -> None:
        super().__init__("memory", "", 0, 1)
        self.sent: dict[int, bytearray] = {}
        self._came: deque[tuple[Peer, bytes]] = deque()
        self._clients: dict[int, Peer] = {}

    @property
    def sockets(self) -> list[socket.socket]:
        return []

    def put(self, client: int, data: bytes) -> None:
        """What a client sends; its first call makes it a peer, whether there is anything in it or not."""
        if client not in self._clients:
            self.sent[client] = bytearray()
            self._clients[client] = Peer(self, (client,), 1)  # type: ignore[arg-type]
            self.peers.append(self._clients[client])
        if data:
            self._came.append((self._clients[client], data))

    def sendto(self, data: bytes, address: tuple[int]) -> None:
        """As a socket's."""
        self.sent[address[0]] += data

    def receive(self) -> list[tuple[Peer, bytes]]:
        came = list(self._came)
        self._came.clear()
        return came


class InMemory:
    """One stand-in of `world`, listening to the clients that call `exchange`.

    `standin` and `autopilot` are there to look at what is true: `autopilot.store[name]`, `autopilot.armed`,
    `autopilot.plant.height`, `autopilot.files.files`. Raises WorldError. Not for `world.lockstep`: it would
    wait for answers that cannot come between two calls.
    """

    def __init__(self, sim_of: Simulation) -> None:
        self._port = MemoryPort()
        self._start_s: float | None = None
        self._ticks = 0
        self.standin = build(sim_of, [self._port], clock=self.now)
        self.autopilot = self.standin.autopilot

    def now(self) -> float:
        """Seconds of the caller's clock up to which it has lived."""
        return (self._start_s or 0.0) + self._ticks * TICK_S

    def exchange(self, data: bytes, now_s: float, client: int = 0) -> bytes:
        """Hand over `data`, let time pass until `now_s`, and take all that was sent to this client by then.

        `data` is heard before time passes: what it asks for is answered in the same call, also with an
        unchanged `now_s`. The vehicle moves in steps of 4 ms, some 0.05 ms of a processor each: an idle
        minute takes under a second. A time before the last one lets no time pass.
        """
        if self._start_s is None:
            self._start_s = now_s
        self._port.put(client, data)
        self.standin.hear()
        while self.now() + TICK_S <= now_s + 1e-9:
            self._ticks += 1
            self.standin.tick()
        answer, self._port.sent[client] = bytes(self._port.sent[client]), bytearray()
        return answer
