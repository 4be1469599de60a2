"""Logs of flights that clients fly: CSV as the contract has it, and tlog as a ground station would keep it.

Both are stamped by the vehicle's clock, whatever its speed; both hold what its sensors read, not the truth.
"""

from __future__ import annotations

import socket
import struct
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as m

from sim.errors import SimulationError
from sim.flight_log import columns
from sim.flights import LOG_EVERY, row, write_flight
from sim.line.links import Peer, Port
from sim.px4.guidance import RATE_HZ
from sim.px4.telemetry import stamp_us

# what a tlog asks for, Hz of the vehicle's time
RATES = {1: 2, 24: 2, 30: 50, 32: 50, 33: 5, 36: 50, 83: 10, 132: 20, 147: 5, 245: 2}
PX4_RATES = {31: 50, 105: 50, 291: 20}
ARDUPILOT_RATES = {26: 50, 27: 50, 11030: 20}


class CsvRecorder:
    """Rows of one autopilot while it is armed."""

    def __init__(self, autopilot: Any, path: Path) -> None:
        self._autopilot, self._path = autopilot, path
        self._rows: list[list[float]] = []

    def step(self) -> None:
        """After each step of the autopilot."""
        a = self._autopilot
        if a.armed and (a.plant.steps * RATE_HZ // 1000) % LOG_EVERY == 0:
            self._rows.append(row(a))

    def close(self) -> None:
        """Write what there is; nothing, if it was never armed. Raises WorldError."""
        if self._rows:
            names = columns(self._autopilot.rotors)
            write_flight(self._path, dict(zip(names, np.array(self._rows).T, strict=True)))


class TlogPort(Port):
    """A listener that writes everything down: 8 bytes of stamp (us, big endian), then the frame."""

    def __init__(self, autopilot: Any, path: Path) -> None:
        super().__init__("tlog", path.name, 0, 1)
        self._autopilot = autopilot
        try:
            self._file = path.open("wb")
        except OSError as error:
            raise SimulationError(path, "", f"cannot be written ({error.strerror})") from error
        self.peers = [Peer(self, ("", 0), 1)]  # type: ignore[arg-type]
        self.peers[0].faulty = False  # the wire's faults are not the log's
        self._requested_boot = -1

    @property
    def sockets(self) -> list[socket.socket]:
        return []

    def sendto(self, data: bytes, address: object) -> None:
        """As a socket's."""
        self._file.write(struct.pack(">Q", stamp_us(self._autopilot)) + data)

    def receive(self) -> list[tuple[Peer, bytes]]:
        if self._requested_boot == self._autopilot.boots:
            return []
        self._requested_boot = self._autopilot.boots  # a reboot forgets rates
        mav = m.MAVLink(None, srcSystem=254, srcComponent=190)
        own = ARDUPILOT_RATES if self._autopilot.id_parameter == "MAV_SYSID" else PX4_RATES
        found = []
        for number, hz in (RATES | own).items():
            wish = m.MAVLink_command_long_message(0, 0, 511, 0, number, 1e6 / hz, 0, 0, 0, 0, 0)
            found.append((self.peers[0], bytes(wish.pack(mav))))
        return found

    def close(self) -> None:
        self._file.close()
