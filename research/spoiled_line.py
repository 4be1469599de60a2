"""A line that loses, doubles, reorders, delays and corrupts, and a clean one beside it to look on board.

Written for the benchmarks: neither shares code with the product or its simulator.
"""

from __future__ import annotations

import contextlib
import random
import select
import socket
import struct
import time
from typing import Any

from pymavlink.dialects.v20 import common as m


def relay(listen: socket.socket, vehicle: tuple[str, int], share: Any, seed: int) -> None:
    """Carry datagrams both ways: lose a share, double 2 %, delay 2 ms, 5 % up to 60 ms late, corrupt 0.5 %.

    `share` is a multiprocessing.Value; while it is 0 nothing is done to any datagram.
    """
    draw = random.Random(seed)
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    peer, late = None, []
    while True:
        now = time.monotonic()
        for row in [r for r in late if r[0] <= now]:
            late.remove(row)
            with contextlib.suppress(OSError):
                row[1].sendto(row[2], row[3])
        wait = min([r[0] for r in late], default=now + 0.2) - now
        for ready in select.select([listen, out], [], [], max(wait, 0.0))[0]:
            try:
                data, source = ready.recvfrom(65536)
            except OSError:
                continue
            loss = share.value
            if ready is listen:
                peer = source
            there = (out, vehicle) if ready is listen else (listen, peer)
            if there[1] is None or (loss and draw.random() < loss):
                continue
            if loss and draw.random() < 0.005:
                offset = draw.randrange(len(data))
                data = data[:offset] + bytes([data[offset] ^ (1 << draw.randrange(8))]) + data[offset + 1 :]
            copies = 2 if loss and draw.random() < 0.02 else 1
            for _ in range(copies):
                slow = 0.06 * draw.random() if loss and draw.random() < 0.05 else 0.0
                late.append((time.monotonic() + (0.002 + slow if loss else 0.0), there[0], data, there[1]))


class Clean:
    """A reader of the table over a line of its own, written for this benchmark."""

    def __init__(self, vehicle: tuple[str, int]) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(0.3)
        self.vehicle, self.out, self.parser = vehicle, m.MAVLink(None, 250, 1), m.MAVLink(None)
        self.parser.robust_parsing = True
        self.turn = 1000

    def send(self, message: object) -> None:
        self.socket.sendto(message.pack(self.out), self.vehicle)

    def table(self, names: list[str]) -> dict[str, bytes]:
        """The wire bits of each parameter."""
        self._drain()
        found: dict[str, bytes] = {}
        end = time.monotonic() + 30.0
        while len(found) < len(names):
            assert time.monotonic() < end, "the stand-in does not answer on a clean line"
            for name in [n for n in names if n not in found][:20]:
                self.send(m.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
            until = time.monotonic() + 0.3
            while time.monotonic() < until:
                try:
                    data = self.socket.recv(4096)
                except TimeoutError:
                    break
                for message in self.parser.parse_buffer(data) or []:
                    if message.get_type() == "PARAM_VALUE" and message.param_id in names:
                        found[message.param_id] = bytes(message.get_msgbuf()[10:14])
                if len(found) % 20 == 0:
                    break
        return found

    def _drain(self) -> None:
        # news of earlier changes wait in the socket and are not what the board holds now
        while select.select([self.socket], [], [], 0.0)[0]:
            self.socket.recv(4096)

    def board(self, names: list[str], paths: list[str]) -> dict[str, bytes | None]:
        """Parameters and the checksums of files; None for what is not there."""
        self._drain()
        found: dict[str, bytes | None] = {}
        left, until = -1, 0.0
        # on a busy machine a stand-in may be silent for seconds; only then is a name not there
        while left < 0 or time.monotonic() < until + (0.0 if found else 40.0):
            missing = len([key for key in [*names, *paths] if key not in found])
            if missing != left:
                left, until = missing, time.monotonic() + 4.0
            for name in [n for n in names if n not in found]:
                self.send(m.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
            for number, path in enumerate(paths):
                if path not in found:
                    head = struct.pack("<HBBBBBBI", 2 * number + self.turn, 0, 14, len(path), 0, 0, 0, 0)
                    payload = list((head + path.encode()).ljust(251, b"\0"))
                    self.send(m.MAVLink_file_transfer_protocol_message(0, 1, 1, payload))
            self.turn = (self.turn + 2 * len(paths)) % 60000
            self._hear(names, paths, found)
            if all(key in found for key in [*names, *paths]):
                break
        assert any(key in found for key in names), "the stand-in does not answer on a clean line"
        return {key: found.get(key) for key in [*names, *paths]}

    def _hear(self, names: list[str], paths: list[str], found: dict[str, bytes | None]) -> None:
        until = time.monotonic() + 0.15
        first = self.turn - 2 * len(paths)
        while time.monotonic() < until:
            if not select.select([self.socket], [], [], max(0.0, until - time.monotonic()))[0]:
                return
            for message in self.parser.parse_buffer(self.socket.recv(4096)) or []:
                kind = message.get_type()
                if kind == "PARAM_VALUE" and message.param_id in names:
                    found[message.param_id] = bytes(message.get_msgbuf()[10:14])
                elif kind == "PARAM_ERROR" and message.param_id in names:
                    found[message.param_id] = None
                elif kind == "FILE_TRANSFER_PROTOCOL":
                    reply = bytes(message.payload)
                    number, code = struct.unpack_from("<H", reply)[0] - 1 - first, reply[3]
                    if reply[5] == 14 and number % 2 == 0 and 0 <= number < 2 * len(paths):
                        found[paths[number // 2]] = reply[12:16] if code == 128 else None

    def reboot(self) -> None:
        self.send(m.MAVLink_command_long_message(1, 1, 246, 0, 1, 0, 0, 0, 0, 0, 0))
