"""Share the companion's line with one ground station: its frames to the vehicle, the vehicle's to it.

WHERE is the ground station's own port (HOST:PORT, also udpout:HOST:PORT), or a port of ours where it comes to
us (udpin:HOST:PORT; without a host on this machine only). What passes towards the vehicle comes from one
address: the one named, or the first that speaks MAVLink to our port. When that one has been silent for
LEFT_S, another port of the same host may take its place; another host never.

A frame that commands motors (SET_ACTUATOR_CONTROL_TARGET) does not pass towards the vehicle while this
companion mixes. Everything else passes byte for byte, signatures included.
"""

from __future__ import annotations

import contextlib
import ipaddress
import socket
import threading
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import InputError, LinkError
from coaxlink.mavlink import codec
from coaxlink.mavlink.address import Address, parse_address

if TYPE_CHECKING:
    from coaxlink.mavlink.session import Session

WAIT_S = 0.2
LEFT_S = 10.0  # ten heartbeats of a ground station missed
EXPECTED = "HOST:PORT of a ground station, or udpin:HOST:PORT to listen for one, is expected"
LOOPBACK = "127.0.0.1"


def parse_forward(where: str) -> Address:
    """Where a ground station is. Raises InputError."""
    scheme, _, host_port = where.partition(":")
    if scheme == "udpin":
        host_port = host_port.removeprefix("//")
        if not host_port.rpartition(":")[0]:
            host_port = f"{LOOPBACK}:{host_port.removeprefix(':')}"
        url = f"udpin:{host_port}"
    else:
        url = where if scheme == "udpout" else f"udpout:{where}"
    try:
        address = parse_address(url)
    except InputError as error:
        raise InputError("`forward`", where, EXPECTED) from error
    if ":" in address.host and "[" not in where:  # no IPv6 address, but another kind of line
        raise InputError("`forward`", where, EXPECTED)
    return address


class Forwarder:
    """A UDP port towards one ground station at `where`, see the module; a context manager.

    Raises InputError for a bad address, LinkError when the port cannot be had.
    """

    def __init__(self, session: Session, where: str) -> None:
        address = parse_forward(where)
        self._session, self._listens = session, address.kind == "udpin"
        self._socket, self._peer = _open(address)
        self._socket.settimeout(WAIT_S)
        self._heard_s = 0.0
        self._scanner = _complete_frames()
        self._stopping = threading.Event()
        self._leave: Any = None
        self._thread = threading.Thread(target=self._run, name="coaxlink-forward", daemon=True)
        self._out = mavlink.MAVLink(None, *session.source)
        self.held_back = 0  # motor commands that did not pass
        self.strangers = 0  # datagrams of others than the ground station

    @property
    def own_address(self) -> tuple[str, int]:
        """Our own host and port."""
        host, port = self._socket.getsockname()[:2]
        return host, port

    @property
    def exposed(self) -> bool:
        """Whether another machine may be the first to speak."""
        return self._listens and not ipaddress.ip_address(self.own_address[0]).is_loopback

    def __enter__(self) -> Forwarder:
        self._leave = self._session.subscribe(self._from_vehicle, whole_system=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._leave()
        self._thread.join(2 * WAIT_S)
        self._socket.close()

    def send(self, message: Any) -> None:
        """Our own message, to the ground station alone."""
        self._frame(bytes(message.pack(self._out)))
        self._out.seq = (self._out.seq + 1) % 256

    def _from_vehicle(self, message: Any) -> None:
        self._frame(bytes(message.get_msgbuf()))

    def _frame(self, frame: bytes) -> None:
        peer = self._peer
        if peer is not None:
            # a ground station that is not there must not matter
            with contextlib.suppress(OSError):
                self._socket.sendto(frame, peer)

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                data, peer = self._socket.recvfrom(65536)
            except OSError:  # nothing came, or the port is closed on the other side
                continue
            self.pass_on(data, peer, self._session.clock.monotonic())

    def pass_on(self, data: bytes, peer: Any, now: float) -> None:
        """A datagram of `peer` at `now` (s, monotonic): to the vehicle, if it is the ground station's."""
        if peer != self._peer and not self._may_be(peer, now):
            self.strangers += 1
            return
        frames = self._scanner.feed(data)
        if peer != self._peer:
            if not frames:
                self._scanner = _complete_frames()
                self.strangers += 1
                return
            self._peer = peer
        self._heard_s = now
        if any(f.number == codec.SET_ACTUATOR_CONTROL_TARGET.number for f in frames):
            self.held_back += 1
            return
        self._session.send_bytes(data)

    def _may_be(self, peer: Any, now: float) -> bool:
        if not self._listens:
            return False
        return self._peer is None or (peer[0] == self._peer[0] and now - self._heard_s > LEFT_S)


def _complete_frames() -> codec.Scanner:
    seeds = codec.known_seeds()
    return codec.Scanner(set(seeds), seeds)


def _open(address: Address) -> tuple[socket.socket, Any]:
    """The socket, and where the ground station is; None until it has spoken."""
    try:
        family, _, _, _, peer = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)[0]
    except OSError as error:
        raise InputError("`forward`", address.text, "no such host") from error
    line = socket.socket(family, socket.SOCK_DGRAM)
    try:
        if address.kind == "udpin":
            line.bind(peer)
            return line, None
        # only the interface that leads there: for a ground station on this machine that is loopback
        line.connect(peer)
        here = line.getsockname()
        line.close()
        line = socket.socket(family, socket.SOCK_DGRAM)
        line.bind((here[0], 0, *here[2:]))
        return line, peer
    except OSError as error:
        line.close()
        raise LinkError(address.text, f"`forward` cannot be opened ({error.strerror})") from error
