"""Lines in memory on a virtual clock: datagrams between addresses, with the faults of a radio, and no thread.

A session's end is a `Line`; at the other end is a `ScriptedAutopilot`, or one of the stand-ins of `sim` (see
`standin`). All that happens, happens while somebody waits on the clock, in order of time.
"""

import random
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

from coaxlink.mavlink import connect
from coaxlink.mavlink.address import parse_address
from coaxlink.mavlink.clock import VirtualClock

DELAY_S = 0.001
LATE_S = 0.06  # what is out of order, at most
STEP_S = 0.01  # a stand-in lives in such steps
TURN_S = 0.05  # so often a session looks about, whatever comes
HOST = "10.0.0.1"
EXAMPLES = Path(__file__).parents[2] / "examples"
X8 = EXAMPLES / "x8_paper.toml"


class Net:
    """Carries datagrams between addresses (host, port)."""

    def __init__(self, clock=None, *, seed=0):
        self.clock = clock or VirtualClock()
        self.loss = self.corruption = self.copies = self.disorder = 0.0  # chances a datagram
        self.delay_s = DELAY_S
        self._random = random.Random(seed)
        self._ears = {}
        self._ports = iter(range(20000, 65536))

    def address(self):
        """One that nobody has."""
        return (HOST, next(self._ports))

    def bind(self, address, hear):
        """`hear(data, source)` gets what is sent there."""
        self._ears[address] = hear

    def leave(self, address):
        self._ears.pop(address, None)

    def send(self, data, source, target):
        data = bytes(data)
        if self._random.random() < self.loss:
            return
        if self._random.random() < self.corruption:
            at, bit = self._random.randrange(len(data)), 1 << self._random.randrange(8)
            data = data[:at] + bytes([data[at] ^ bit]) + data[at + 1 :]

        def arrive():
            if target in self._ears:
                self._ears[target](data, source)

        for _ in range(1 + (self._random.random() < self.copies)):
            late_s = LATE_S * self._random.random() if self._random.random() < self.disorder else 0.0
            self.clock.later(self.delay_s + late_s, arrive)


class Line:
    """A session's end: a `Driven` transport. Without `peer` it listens, and answers those it heard."""

    def __init__(self, net, peer=None, address=None):
        self.net, self.peer = net, peer
        self.address = address or net.address()
        self._heard, self._waiting, self._turn = [], [], None
        net.bind(self.address, self._hear)

    def _hear(self, data, source):
        self._waiting.append((data, source))
        if source not in self._heard:
            self._heard.append(source)
        while self._waiting and self._turn is not None and self._turn(0.0):
            pass

    def drive(self, turn):
        self._turn = turn
        self._look_about()

    def _look_about(self):
        if self._turn is not None and self._turn(0.0):
            self.net.clock.later(TURN_S, self._look_about)

    def read(self, timeout_s):
        return self._waiting.pop(0) if self._waiting else (b"", None)

    def write(self, data, peer=None):
        for target in [peer] if peer else [self.peer] if self.peer else list(self._heard):
            self.net.send(data, self.address, target)

    def close(self):
        self._turn = None
        self.net.leave(self.address)


def meet(board, **options):
    """A session with a vehicle that is somewhere on a net."""
    line = Line(board.net, board.address)
    return connect(board.url, transport=line, clock=board.net.clock, **options)


class Standin:
    """A stand-in of `sim` on a net."""

    def __init__(self, net, firmware="px4", *, address=None, **world):
        from sim.in_memory import InMemory
        from sim.simulation import Simulation

        self.net, self.address = net, address or net.address()
        self.url = f"udpout:{self.address[0]}:{self.address[1]}"
        self._board = InMemory(Simulation(X8, firmware=firmware, **world))
        self.autopilot, self._clients = self._board.autopilot, []
        self._on = True
        net.bind(self.address, self._hear)
        self._live()

    def _hear(self, data, source):
        if source not in self._clients:
            self._clients.append(source)
        self._answer(source, data)

    def _answer(self, source, data=b""):
        reported = self._board.exchange(data, self.net.clock.monotonic(), self._clients.index(source))
        for frame in frames(reported):
            self.net.send(frame, self.address, source)

    def _live(self):
        if self._on:
            for source in self._clients:
                self._answer(source)
            if not self._clients:
                self._board.exchange(b"", self.net.clock.monotonic())
            self.net.clock.later(STEP_S, self._live)

    def close(self):
        """As when the plug is pulled."""
        self._on, self._frozen = False, None
        self.net.leave(self.address)

    def reboot(self):
        """As a command from elsewhere would."""
        self._board.standin.autopilot.boot()
        self._board.standin._restart()

    def freeze(self, seconds):
        """Deaf and mute for a while; one whose plug is pulled meanwhile stays so."""
        self.close()
        frozen = self._frozen = object()

        def thaw():
            if self._frozen is not frozen:
                return
            self._on = True
            self.net.bind(self.address, self._hear)
            self._live()

        self.net.clock.later(seconds, thaw)


def frames(data):
    """The MAVLink frames in a stream, each as a datagram has it; what is damaged goes on together."""
    at = 0
    while at < len(data):
        if at + 12 > len(data) or data[at] not in (0xFD, 0xFE):
            yield data[at:]
            return
        size = 8 + data[at + 1] if data[at] == 0xFE else 12 + data[at + 1] + 13 * (data[at + 2] & 1)
        yield data[at : at + size]
        at += size


@contextmanager
def plugged(net):
    """Whoever opens an address of this net, a verb of the command line say, gets a line on it."""

    def opened(url, **options):
        found = parse_address(url)
        if found.host != HOST:
            return connect(url, **options)
        at = (found.host, found.port)
        line = Line(net, address=at) if found.kind == "udpin" else Line(net, at)
        return connect(url, transport=line, clock=net.clock, **options)

    with mock.patch("coaxlink.mavlink.connect", opened):
        yield net


@contextmanager
def standin(firmware="px4", **world):
    """A stand-in in memory, alone on its net."""
    board = Standin(Net(), firmware, **world)
    try:
        yield board
    finally:
        board.close()
