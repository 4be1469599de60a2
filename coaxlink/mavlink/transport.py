"""Bytes over UDP, TCP or a serial line: `read` with a timeout, `write` from any thread."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import select
import socket
import threading
import time
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

from coaxlink.errors import InputError, LinkError
from coaxlink.mavlink.address import Address, both_ways

_CHUNK = 65536
_HEARD = 32  # senders who are answered while none of them is known to be the vehicle
_SEND_S = 0.02  # a full buffer may hold a sender up so long: then the datagram is lost
_WRITE_S = 1.0  # the same of a serial line


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
    """Open a line. Raises LinkError when it cannot be had within `timeout_s`; InputError where it is to
    listen on an address of another machine."""
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
                self._socket.bind(address.local or ("", 0))  # Windows reads from no socket without a port
                info = socket.getaddrinfo(address.host, address.port, family, socket.SOCK_DGRAM)[0]
                self._peer = info[4]
            self._socket.setblocking(False)
        except OSError:
            self._socket.close()
            raise

    def read(self, timeout_s: float) -> tuple[bytes, Any]:
        if timeout_s > 0 and not select.select([self._socket], [], [], timeout_s)[0]:
            return b"", None
        try:
            data, peer = self._socket.recvfrom(_CHUNK)
        except (BlockingIOError, ConnectionError):  # an ICMP "nobody there" is not the end of a UDP link
            return b"", None
        if len(self._peers) < _HEARD:
            self._peers.add(peer)
        return data, peer

    def write(self, data: bytes, peer: Any = None) -> None:
        targets = [peer] if peer else [self._peer] if self._peer else list(self._peers)
        for target in targets:
            with contextlib.suppress(OSError):  # what a datagram link loses, its protocol asks for again
                try:
                    self._socket.sendto(data, target)
                except BlockingIOError:
                    if select.select([], [self._socket], [], _SEND_S)[1]:
                        self._socket.sendto(data, target)

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
    """A serial line, nobody else's: pyserial knows the rates and names of each system."""

    def __init__(self, address: Address) -> None:
        import serial

        from coaxlink.mavlink.port_holder import holder_of_line

        self._address = address
        self._sending = threading.Lock()  # on Windows a port has one write under way
        if who := holder_of_line(address.device):
            raise LinkError(address.text, f"the line is in use by {who}")
        try:
            self._line = serial.Serial(address.device, address.baud, write_timeout=_WRITE_S, exclusive=True)
        except (serial.SerialException, ValueError) as error:
            raise LinkError(address.text, _why_not(error)) from error

    def read(self, timeout_s: float) -> tuple[bytes, Any]:
        try:
            waiting = self._line.in_waiting
            if waiting or timeout_s <= 0:
                return self._line.read(waiting), None
            if self._line.timeout != timeout_s:
                self._line.timeout = timeout_s
            first = self._line.read(1)
            return first + self._line.read(self._line.in_waiting) if first else b"", None
        except (OSError, TypeError) as error:  # SerialException is one; TypeError: closed by another thread
            reported = getattr(error, "strerror", None) or error
            raise LinkError(self._address.text, f"the line is gone ({reported})") from error

    def write(self, data: bytes, peer: Any = None) -> None:
        with self._sending, contextlib.suppress(OSError):  # the reader finds the end of the line and says so
            self._line.write(data)

    def close(self) -> None:
        self._line.close()


def _why_not(error: Exception) -> str:
    """Why a serial line does not open, in a few words: pyserial's hold the system's in brackets."""
    number, reported = getattr(error, "errno", None), str(error)
    taken = ("exclusively lock", "PermissionError")  # the last: Windows
    if number == errno.EBUSY or any(words in reported for words in taken):
        return "the line is in use by another program, or not yours to open"
    if number:
        return f"cannot be opened ({os.strerror(number)})"
    if "configure port" in reported:
        return "not a serial line, or not at this rate"
    meant = re.search(r"Error\(\d+, '([^']+)'", reported)  # Windows
    return f"cannot be opened ({meant[1] if meant else reported})"
