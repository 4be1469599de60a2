"""Share the companion's line with a ground station: its frames to the vehicle, the vehicle's to it.

A frame that commands motors (SET_ACTUATOR_CONTROL_TARGET) does not pass towards the vehicle while this
companion mixes. Everything else passes byte for byte, signatures included.
"""

from __future__ import annotations

import contextlib
import socket
import threading
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import InputError
from coaxlink.link import codec

if TYPE_CHECKING:
    from coaxlink.link.session import Session

WAIT_S = 0.2


class Forwarder:
    """A UDP port towards one ground station at `where` (HOST:PORT); a context manager.

    Raises InputError for a bad address.
    """

    def __init__(self, session: Session, where: str) -> None:
        host, _, port = where.rpartition(":")
        if not host or not port.isdecimal() or not 1 <= int(port) <= 65535:
            raise InputError("--forward", where, "HOST:PORT of a ground station is expected")
        self._session, self._peer = session, (host, int(port))
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(WAIT_S)
        self._scanner = codec.Scanner({codec.SET_ACTUATOR_CONTROL_TARGET.number}, codec.known_seeds())
        self._stopping = threading.Event()
        self._leave: Any = None
        self._thread = threading.Thread(target=self._run, name="coaxlink-forward", daemon=True)
        self._out = mavlink.MAVLink(None, *session.source)
        self.held_back = 0  # motor commands that did not pass

    def __enter__(self) -> Forwarder:
        leave = self._session.subscribe(self._from_vehicle), self._session.watch(self._frame)
        self._leave = lambda: [out() for out in leave]
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._leave()
        self._thread.join(2 * WAIT_S)
        self._socket.close()

    def send(self, message: Any) -> None:
        """Our own message, to the ground station alone."""
        with contextlib.suppress(OSError):
            self._socket.sendto(bytes(message.pack(self._out)), self._peer)
        self._out.seq = (self._out.seq + 1) % 256

    def _from_vehicle(self, message: Any) -> None:
        self._frame(bytes(message.get_msgbuf()))

    def _frame(self, frame: bytes) -> None:
        # a ground station that is not there must not matter
        with contextlib.suppress(OSError):
            self._socket.sendto(frame, self._peer)

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                data = self._socket.recv(65536)
            except OSError:  # nothing came, or the port is closed on the other side
                continue
            if self._scanner.feed(data):
                self.held_back += 1
                continue
            self._session.send_bytes(data)
