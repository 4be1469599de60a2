"""Addresses the stand-in opens, and the peers behind them: UDP out, UDP in, TCP in."""

from __future__ import annotations

import select
import socket
import struct
import time
from collections.abc import Sequence

from pymavlink.dialects.v20 import common as mavlink

from sim.errors import PortError, SimulationError
from sim.line.signing import Signing, detach
from sim.line.wire import Wire

SILENT_S = 30.0  # wall time after which a UDP peer that spoke once is forgotten
DATAGRAM = 65536
IP_RECVERR, MSG_ERRQUEUE = 11, 0x2000


class Peer:
    """One who listens: its own sequence numbers, parser and socket."""

    def __init__(self, sock: socket.socket, address: tuple[str, int] | None, system: int) -> None:
        self._socket, self.address = sock, address  # no address: a stream or a connected socket
        self.packer = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
        self.parser = mavlink.MAVLink(None)
        self.parser.robust_parsing = True
        self.heard_at = time.monotonic()
        self.gone, self.faulty = False, True
        self.link = 0  # which of the vehicle's links it is on
        self.out: Wire | None = None  # faults on the way there and back
        self.back: Wire | None = None

    def send(self, message: mavlink.MAVLink_message) -> None:
        """Pack and send; a peer that is gone is marked, not raised."""
        data = message.pack(self.packer)
        self.packer.seq = (self.packer.seq + 1) % 256
        for one in [data] if self.out is None else self.out.carry(data):
            self._put(one)

    def sign(self, signing: Signing | None) -> None:
        """Sign what goes out and take nothing unsigned; or neither, as before."""
        for mav in (self.packer, self.parser):
            if signing is None:
                detach(mav)
            else:
                signing.attach(mav)

    def late(self) -> list[mavlink.MAVLink_message]:
        """Let pass what the wire held back; returns what came in that way."""
        if self.out is not None:
            for data in self.out.due():
                self._put(data)
        return [] if self.back is None else self._read(self.back.due())

    def _put(self, data: bytes) -> None:
        for _ in range(3):
            try:
                if self.address is None:
                    self._socket.sendall(data)
                else:
                    self._socket.sendto(data, self.address)
            except BlockingIOError:
                pass  # its buffer is full: lost, as on any radio
            except ConnectionRefusedError:
                if self.address is not None:
                    continue  # an earlier datagram was, maybe another peer's: `UdpIn` finds out whose
                self.gone = True
            except OSError:
                self.gone = True
            return

    def parse(self, data: bytes) -> list[mavlink.MAVLink_message]:
        """Messages in what it sent."""
        self.heard_at = time.monotonic()
        return self._read([data] if self.back is None else self.back.carry(data))

    def _read(self, chunks: list[bytes]) -> list[mavlink.MAVLink_message]:
        found = [message for data in chunks for message in self.parser.parse_buffer(data) or []]
        return [message for message in found if message.get_type() != "BAD_DATA"]


class Port:
    """An open address; `receive` brings what came, `peers` who listens."""

    def __init__(self, kind: str, host: str, port: int, system: int) -> None:
        self.name = f"{kind}:{host}:{port}"
        self.peers: list[Peer] = []
        self._system = system

    @property
    def sockets(self) -> list[socket.socket]:
        """To wait on."""
        raise NotImplementedError

    def receive(self) -> list[tuple[Peer, bytes]]:
        """Everything that is there now; never waits."""
        raise NotImplementedError

    def close(self) -> None:
        """Let go of the address."""
        for sock in self.sockets:
            sock.close()


class UdpOut(Port):
    """Sends to a fixed address, whether anyone is there or not."""

    def __init__(self, host: str, port: int, system: int) -> None:
        super().__init__("udpout", host, port, system)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self.peers = [Peer(self._socket, (host, port), system)]

    @property
    def sockets(self) -> list[socket.socket]:
        return [self._socket]

    def receive(self) -> list[tuple[Peer, bytes]]:
        return [(self.peers[0], data) for data, _ in _datagrams(self._socket)]


class UdpIn(Port):
    """Waits on a port; whoever speaks becomes a peer."""

    def __init__(self, host: str, port: int, system: int) -> None:
        super().__init__("udpin", host, port, system)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
            self._socket.setsockopt(socket.IPPROTO_IP, IP_RECVERR, 1)
        except OSError as error:
            self._socket.close()
            raise PortError(f"udpin:{host}:{port}", f"cannot be opened ({error.strerror})") from error
        self._socket.setblocking(False)
        self.name = "udpin:{}:{}".format(*self._socket.getsockname())
        self._looked_at = 0.0

    @property
    def sockets(self) -> list[socket.socket]:
        return [self._socket]

    def receive(self) -> list[tuple[Peer, bytes]]:
        found = []
        for data, address in _datagrams(self._socket):
            peer = next((p for p in self.peers if p.address == address), None)
            if peer is None:
                peer = Peer(self._socket, address, self._system)
                self.peers.append(peer)
            found.append((peer, data))
        now = time.monotonic()
        if now - self._looked_at > 0.1 and self.peers:
            self._looked_at = now
            self._forget(now)
        return found

    def _forget(self, now: float) -> None:
        """Drop peers whose port is closed (the kernel tells) or who have been silent too long."""
        refused = set()
        while True:
            try:
                _, ancillary, _, address = self._socket.recvmsg(1, 512, MSG_ERRQUEUE)
            except OSError:
                break
            if ancillary:
                refused.add(address)
        for peer in self.peers:
            # a refusal of what was sent long before it spoke again would not count: it is alive
            dead = peer.address in refused and now - peer.heard_at > 0.2
            peer.gone = peer.gone or dead or now - peer.heard_at > SILENT_S
        self.peers = [peer for peer in self.peers if not peer.gone]


class TcpIn(Port):
    """Accepts whoever connects."""

    def __init__(self, host: str, port: int, system: int) -> None:
        super().__init__("tcpin", host, port, system)
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind((host, port))
            self._listener.listen(4)
        except OSError as error:
            self._listener.close()
            raise PortError(f"tcpin:{host}:{port}", f"cannot be opened ({error.strerror})") from error
        self._listener.setblocking(False)
        self.name = "tcpin:{}:{}".format(*self._listener.getsockname())
        self._streams: dict[Peer, socket.socket] = {}

    @property
    def sockets(self) -> list[socket.socket]:
        return [self._listener, *self._streams.values()]

    def receive(self) -> list[tuple[Peer, bytes]]:
        self._accept()
        found = []
        for peer, stream in list(self._streams.items()):
            data = b""
            try:
                data = stream.recv(DATAGRAM)
                peer.gone = peer.gone or not data
            except BlockingIOError:
                pass
            except OSError:
                peer.gone = True
            if data:
                found.append((peer, data))
            if peer.gone:
                stream.close()
                del self._streams[peer]
                self.peers.remove(peer)
        return found

    def _accept(self) -> None:
        while True:
            try:
                stream, _ = self._listener.accept()
            except BlockingIOError:
                return
            stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            # a peer that stops reading must not stop the world for long
            stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("ll", 1, 0))
            stream.setblocking(False)
            peer = Peer(stream, None, self._system)
            self._streams[peer] = stream
            self.peers.append(peer)


def open_port(address: str, system: int = 1) -> Port:
    """udpout:HOST:PORT, udpin:HOST:PORT or tcpin:HOST:PORT. Raises WorldError or PortError."""
    kind, _, rest = address.partition(":")
    host, _, port = rest.removeprefix("//").rpartition(":")
    kinds = {"udpout": UdpOut, "udpin": UdpIn, "tcpin": TcpIn}
    if kind not in kinds or not host or not port.isdecimal() or int(port) > 65535:
        raise SimulationError(address, "", "udpin:HOST:PORT or tcpin:HOST:PORT is expected")
    try:
        return kinds[kind](host, int(port), system)
    except OSError as error:
        raise PortError(address, f"cannot be opened ({error})") from error


def wait(ports: Sequence[Port], seconds: float) -> None:
    """Until something comes, or the time is up."""
    sockets = [sock for port in ports for sock in port.sockets]
    select.select(sockets, [], [], max(seconds, 0.0))


def _datagrams(sock: socket.socket) -> list[tuple[bytes, tuple[str, int]]]:
    found = []
    while True:
        try:
            found.append(sock.recvfrom(DATAGRAM))
        except ConnectionRefusedError:
            continue  # of something sent earlier; reading it clears it
        except OSError:
            return found
