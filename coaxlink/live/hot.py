"""The hot path of live mixing seen from Python: arrays handed to the compiled loop, accounts taken from it.

The loop (`hot_serve`) receives, answers and receives again without the interpreter, for at most BUDGET_S; the
interpreter's turn comes after the answers are out. See `hot_kernel` for what it answers and what it leaves.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.live import hot_kernel as k
from coaxlink.live.hot_build import arguments
from coaxlink.live.hot_serve import CHUNK, PEER_SIZE, SLOT
from coaxlink.mixer.exact import ExactLaw

# the interpreter's turn costs the answer after it its place on a busy processor: rare, then. With effects to
# follow it comes oftener
BUDGET_S, EFFECTS_BUDGET_S = 0.2, 0.02
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Batch:
    """What one turn of the loop did. Views of its arrays: read them before the next turn."""

    rows: Floats  # (n, ROW) answers, see hot_kernel
    stamps: NDArray[np.int64]  # (n,) us
    raw: NDArray[np.uint8]  # (n, 2 SLOT) demand and answer of each, as they were on the wire
    superseded: int
    dropped: int
    foreign: int  # datagrams with the vehicle's system id from elsewhere, dropped
    left: list[tuple[bytes, Any]]  # (datagram without the demands dealt with, sender)

    def frames(self) -> list[tuple[bytes, bytes]]:
        """Demand and answer of each."""
        whole, size = self.raw.tobytes(), 2 * SLOT
        found = []
        for at in range(0, len(whole), size):
            long, answer = whole[at + SLOT - 1], at + SLOT
            found.append((whole[at : at + long], whole[answer : answer + whole[at + size - 1]]))
        return found

    def last_demand(self) -> bytes:
        """Payload of the newest demand."""
        whole = self.raw[-1, :SLOT].tobytes()
        return whole[10 : whole[SLOT - 1] - 2]

    def answers(self, most: int) -> list[bytes]:
        """Payload of the newest answers."""
        whole = self.raw[-most:, SLOT:].tobytes()
        return [whole[at + 10 : at + whole[at + SLOT - 1] - 2] for at in range(0, len(whole), SLOT)]


class HotLoop:
    """One vehicle's loop on one UDP socket. `motors` and `told` are shared with the loop in Python."""

    def __init__(self, function: Any, law: ExactLaw, scale: Floats, count: int, sequence: Any) -> None:
        """`scale` (4, 4) N and N m by control; `sequence` (1,) uint8, the session's own counter."""
        p = law.problem
        self._function = function
        self.ints = np.zeros(k.INTS, np.int64)
        self.floats = np.zeros(k.FLOATS)
        self.motors, self.told = np.zeros(k.MOTORS), np.zeros(k.MOTORS)
        self.ring, self.stamps = np.zeros((k.RING, k.ROW)), np.zeros(k.RING, np.int64)
        self.frames = np.zeros((k.RING, 2 * SLOT), np.uint8)
        self._data = np.zeros(2 * CHUNK, np.uint8)
        body = np.zeros(48, np.uint8)  # stamp, then the floats of a demand or an answer
        self._lengths = np.zeros(k.MOST_LEFT, np.int32)
        self._peers = np.zeros(k.MOST_LEFT * PEER_SIZE, np.uint8)
        self._peer = np.zeros(PEER_SIZE, np.uint8)
        clock, out = np.zeros(2, np.int64), np.zeros(SLOT, np.uint8)
        slots = np.zeros(k.MOTORS, np.int64)
        slots[: len(p.slots)] = p.slots
        where: list[NDArray[Any]] = [self._data, self._lengths, self._peers, clock, out, self._peer]
        self._arrays = [
            self.ints, self.floats, self.motors, self.ring, self.stamps, self.frames, self._data, body,
            body[8:40].view(np.float32), out, np.zeros(4), self.told, np.zeros(k.MOTORS),
            p.order.astype(np.int64), slots, self._lengths, clock, sequence, self._peers, self._peer,
            *law.arrays(),
        ]  # fmt: skip
        self._where = where
        self._arguments = arguments(self._arrays, [a.ctypes.data for a in where])
        self.ints[k.COUNT] = count
        self.floats[k.SCALE : k.SCALE + 16] = np.asarray(scale, float).ravel()
        self.floats[k.INVERSE : k.INVERSE + 4] = 1.0 / p.scale
        self.floats[k.FACTOR] = 1.0
        self._to: Any = None

    def aim(self, target: tuple[int, int], own: tuple[int, int], quiet_s: float, pause_s: float) -> None:
        """Whose demands are answered, who we are, after what silence no more, and when to look at it (s)."""
        i = self.ints
        i[k.SYSTEM], i[k.COMPONENT], i[k.OWN_SYSTEM], i[k.OWN_COMPONENT] = *target, *own
        i[k.QUIET_NS], i[k.PAUSE_NS] = round(quiet_s * 1e9), round(pause_s * 1e9)

    def lead(self, lag_s: float, quick_s: float) -> None:
        """Lead the motors' lag (s) down to `quick_s`."""
        self.floats[k.LAG_S], self.floats[k.QUICK_S] = lag_s, quick_s

    def compensate(self, extra: Sequence[float] | Floats, factor: float) -> None:
        """What effects add to the wrench (4,), and speed per command."""
        self.floats[k.EXTRA : k.EXTRA + 4] = extra
        self.floats[k.FACTOR] = factor

    def interrupt(self) -> None:
        """From another thread: let the interpreter have its turn after the next answer."""
        self.ints[k.UNTIL_NS] = 0

    def run(self, number: int, to: Any, last_us: int, last_s: float, budget_s: float = BUDGET_S) -> Batch:
        """One turn on the socket of that number, answering to `to`, from the last demand (us, and when)."""
        i = self.ints
        if to != self._to:
            packed = packed_address(to)
            self._peer[: len(packed)] = np.frombuffer(packed, np.uint8)
            i[k.PEER], self._to = len(packed), to
        i[k.FD], i[k.LAST_US] = number, last_us
        i[k.DEADLINE_NS] = round(last_s * 1e9) + int(i[k.QUIET_NS])
        i[k.UNTIL_NS] = time.monotonic_ns() + round(budget_s * 1e9)
        n = self._function(*self._arguments)
        if n < 0:
            raise RuntimeError("the compiled loop failed")
        return Batch(
            self.ring[:n], self.stamps[:n], self.frames[:n], int(i[k.SUPERSEDED]), int(i[k.DROPPED]),
            int(i[k.FOREIGN]),
            self._left() if i[k.LEFT] else [],
        )  # fmt: skip

    def _left(self) -> list[tuple[bytes, Any]]:
        found: list[tuple[bytes, Any]] = []
        triples = self.ints[k.TRIPLES : k.TRIPLES + 3 * int(self.ints[k.LEFT])].reshape(-1, 3).tolist()
        for start, stop, whose in triples:
            place = whose % k.WHOLE // 256
            address = self._peers[place * PEER_SIZE : (place + 1) * PEER_SIZE].tobytes()
            found.append((self._data[start:stop].tobytes(), unpacked_address(address)))
        return found


def packed_address(to: Any) -> bytes:
    """Linux's sockaddr of a Python UDP address."""
    if len(to) == 2:
        return (
            struct.pack("=H", socket.AF_INET) + struct.pack("!H", to[1]) + socket.inet_aton(to[0]) + bytes(8)
        )
    host, port, flow, scope = to
    head = struct.pack("=H", socket.AF_INET6) + struct.pack("!HI", port, flow)
    return head + socket.inet_pton(socket.AF_INET6, host) + struct.pack("=I", scope)


def unpacked_address(packed: bytes) -> Any:
    """The Python UDP address of Linux's sockaddr."""
    (family,) = struct.unpack_from("=H", packed)
    (port,) = struct.unpack_from("!H", packed, 2)
    if family == socket.AF_INET:
        return socket.inet_ntoa(packed[4:8]), port
    (flow,) = struct.unpack_from("!I", packed, 4)
    (scope,) = struct.unpack_from("=I", packed, 24)
    return socket.inet_ntop(socket.AF_INET6, packed[8:24]), port, flow, scope
