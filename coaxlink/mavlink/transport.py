"""Bytes over UDP, TCP or a serial line: `read` with a timeout, `write` from any thread."""

from __future__ import annotations

import errno
import os
import select
import socket
import struct
import sys
import time
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

from coaxlink.errors import InputError, LinkError
from coaxlink.mavlink.address import Address, both_ways

_CHUNK = 65536
_HEARD = 32  # senders who are answered while none of them is known to be the vehicle
_SEND_S = 0.02  # a full buffer may hold a sender up so long: then the datagram is lost


class Transport(Protocol):
    """What a session needs of a line."""

    def read(self, timeout_s: float) -> tuple[bytes, Any]:
        """Bytes that arrived (empty on timeout) and where they came from."""

    def write(self, data: bytes, peer: Any = None) -> None:
        """Send to `peer`, or to whoever was heard (UDP), without waiting for an answer."""

    def close(self) -> None:
        """Let the line go."""


@runtime_checkable
class Driven(Transport, Protocol):
    """A line in memory, without a thread: it calls `turn(0.0)` when something came, and at a steady pace."""

    def drive(self, turn: Callable[[float], bool]) -> None:
        """Begin."""


def open_transport(address: Address, timeout_s: float) -> Transport:
    """Open a line. Raises LinkError when it cannot be had within `timeout_s`, and on Windows; InputError
    where it is to listen on an address of another machine."""
    if sys.platform == "win32":
        # no locks that end with their process, no socket times of the kernel's; nothing was ever run there
        raise LinkError(address.text, "lines to a vehicle need Linux or macOS; on Windows use WSL")
    try:
        if address.kind in ("udpin", "udpout"):
            return Udp(address)
        if address.kind == "serial":
            return Serial(address)
        return Tcp(address, timeout_s)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            from coaxlink.mavlink.port_holder import holder_of

            port = address.local[1] if address.local else address.port
            who = holder_of(port, "tcp" if address.kind == "tcpin" else "udp")
            raise LinkError(address.text, f"the port is in use by {who}") from error
        if error.errno == errno.EADDRNOTAVAIL and address.kind == "udpin":
            meant = both_ways(address.host, address.port)
            raise InputError(
                address.text, "", f"{address.host} is no address of this machine: {meant} is expected"
            ) from error
        raise LinkError(address.text, f"cannot be opened ({error.strerror or error})") from error


def _timeval(seconds: float) -> bytes:
    return struct.pack("@ll", int(seconds), max(round(seconds % 1.0 * 1e6), 1))


class Udp:
    """Datagrams; `udpin` answers those it hears, `udpout` sends first."""

    def __init__(self, address: Address) -> None:
        family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._peers: set[Any] = set()
        self._peer: Any = None
        try:
            if address.kind == "udpin":
                self._socket.bind((address.host, address.port))
            else:
                if address.local:
                    self._socket.bind(address.local)
                info = socket.getaddrinfo(address.host, address.port, family, socket.SOCK_DGRAM)[0]
                self._peer = info[4]
            # the kernel keeps the time of a wait: one call a datagram, not two, where every microsecond shows
            self._socket.settimeout(None)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _timeval(_SEND_S))
            self._timeout_s = -1.0
        except OSError:
            self._socket.close()
            raise

    def read(self, timeout_s: float) -> tuple[bytes, Any]:
        self.arm(timeout_s)
        try:
            data, peer = self._socket.recvfrom(_CHUNK, 0 if timeout_s > 0 else socket.MSG_DONTWAIT)
        except (BlockingIOError, ConnectionError):  # an ICMP "nobody there" is not the end of a UDP link
            return b"", None
        if len(self._peers) < _HEARD:
            self._peers.add(peer)
        return data, peer

    def arm(self, timeout_s: float) -> None:
        """How long the kernel lets a read wait from now on."""
        if timeout_s != self._timeout_s and timeout_s > 0:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _timeval(timeout_s))
            self._timeout_s = timeout_s

    def write(self, data: bytes, peer: Any = None) -> None:
        targets = [peer] if peer else [self._peer] if self._peer else list(self._peers)
        for target in targets:
            try:
                self._socket.sendto(data, target)
            except (BlockingIOError, ConnectionError, OSError):
                continue  # what a datagram link loses, its protocol asks for again

    def close(self) -> None:
        self._socket.close()


class Tcp:
    """One stream, connected out or accepted in."""

    def __init__(self, address: Address, timeout_s: float) -> None:
        self._address = address
        self._listener: socket.socket | None = None
        self._socket: socket.socket | None = None
        if address.kind == "tcpin":
            self._listener = socket.create_server((address.host, address.port))
            return
        end = time.monotonic() + timeout_s
        while self._socket is None:
            try:
                self._socket = socket.create_connection((address.host, address.port), max(timeout_s, 0.1))
            except ConnectionRefusedError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.1)
        self._tune(self._socket)

    @staticmethod
    def _tune(stream: socket.socket) -> None:
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        stream.settimeout(2.0)

    def read(self, timeout_s: float) -> tuple[bytes, Any]:
        waiting = self._socket or self._listener
        if waiting is None:
            raise LinkError(self._address.text, "the other side closed the connection")
        if not select.select([waiting], [], [], timeout_s)[0]:
            return b"", None
        if self._socket is None:
            assert self._listener is not None
            self._socket, _ = self._listener.accept()
            self._tune(self._socket)
            return b"", None
        try:
            data = self._socket.recv(_CHUNK)
        except ConnectionError:
            data = b""
        if not data:
            self._socket.close()
            self._socket = None
            if self._listener is None:
                raise LinkError(self._address.text, "the other side closed the connection")
        return data, None

    def write(self, data: bytes, peer: Any = None) -> None:
        stream = self._socket
        if stream is None:
            return
        try:
            stream.sendall(data)
        except OSError:
            return  # the reader finds the end of the stream and says so

    def close(self) -> None:
        for part in (self._socket, self._listener):
            if part:
                part.close()


class Serial:
    """A tty in raw mode at a standard rate (POSIX)."""

    def __init__(self, address: Address) -> None:
        import termios
        import tty

        speed = getattr(termios, f"B{address.baud}", None)
        if speed is None:
            raise LinkError(address.text, f"{address.baud} baud is not a rate of this system")
        from coaxlink.mavlink.port_holder import holder_of_line

        if who := holder_of_line(address.device):
            raise LinkError(address.text, f"the line is in use by {who}")
        self._address = address
        self._file = os.open(address.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            tty.setraw(self._file)
            mode = termios.tcgetattr(self._file)
            mode[2] |= termios.CLOCAL | termios.CREAD
            mode[4] = mode[5] = speed
            termios.tcsetattr(self._file, termios.TCSANOW, mode)
        except termios.error as error:
            os.close(self._file)
            raise LinkError(address.text, f"not a serial line ({error.args[-1]})") from error

    def read(self, timeout_s: float) -> tuple[bytes, Any]:
        try:
            if not select.select([self._file], [], [], timeout_s)[0]:
                return b"", None
            return os.read(self._file, _CHUNK), None
        except OSError as error:
            raise LinkError(self._address.text, f"the line is gone ({error.strerror})") from error

    def write(self, data: bytes, peer: Any = None) -> None:
        view = memoryview(data)
        while view:
            try:
                view = view[os.write(self._file, view) :]
            except BlockingIOError:
                if not select.select([], [self._file], [], 1.0)[1]:
                    return
            except OSError:
                return

    def close(self) -> None:
        os.close(self._file)
