"""A vehicle of a few lines on a UDP port: heartbeats, outputs, and PX4's parameter protocol.

Written on bare pymavlink, so that it shares nothing with the link it talks to.
"""

from __future__ import annotations

import socket
import struct
import threading
import time
import zlib
from typing import Any

from monitor_messages import HOVER_PULSES, attitude, battery, heartbeat, position, servo
from pymavlink.dialects.v20 import common as mavlink


class Vehicle:
    """Sends to 127.0.0.1:`port` until left; `parameters` may be changed at any time."""

    def __init__(self, port: int, parameters: dict[str, float] | None = None, armed: bool = True) -> None:
        self.port, self.armed = port, armed
        self.parameters = parameters or {}
        self.pulses = HOVER_PULSES
        self.mute = False
        self.reads: list[str] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Vehicle:
        self._thread.start()
        return self

    def __exit__(self, *rest: object) -> None:
        self._stop.set()
        self._thread.join(2.0)

    def _run(self) -> None:
        mav = mavlink.MAVLink(None, 1, 1)
        reader = mavlink.MAVLink(None, 1, 1)
        reader.robust_parsing = True
        start = time.monotonic()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
            line.settimeout(0.02)

            def send(message: Any) -> None:
                line.sendto(message.pack(mav), ("127.0.0.1", self.port))
                mav.seq = (mav.seq + 1) % 256

            tick = 0
            while not self._stop.is_set():
                boot_ms = round(1e3 * (time.monotonic() - start))
                if not self.mute and boot_ms >= 50 * tick:
                    if tick % 10 == 0:
                        send(heartbeat(self.armed))
                        send(battery())
                    tick += 1
                    send(servo(self.pulses))
                    send(attitude(boot_ms=boot_ms))
                    send(position(boot_ms=boot_ms))
                try:
                    data = line.recv(4096)
                except (TimeoutError, ConnectionError):
                    continue
                for message in reader.parse_buffer(data) or ():
                    if not self.mute:
                        self._answer(message, send)

    def _answer(self, message: Any, send: Any) -> None:
        kind = message.get_type()
        if kind == "COMMAND_LONG":
            send(mavlink.MAVLink_command_ack_message(message.command, 0))
            if message.command == mavlink.MAV_CMD_REQUEST_MESSAGE and message.param1 == 148:
                version = 1 << 24 | 16 << 16 | 1 << 8 | 255
                send(mavlink.MAVLink_autopilot_version_message(0, version, 0, 0, 0, *[[0] * 8] * 3, 0, 0, 0))
        elif kind == "PARAM_REQUEST_READ":
            name = message.param_id
            self.reads.append(name)
            if name == "_HASH_CHECK":
                digest = zlib.crc32(repr(sorted(self.parameters.items())).encode()) & 0x7FFFFFFF
                send(_value(name, struct.pack("<I", digest), 5))
            elif name in self.parameters:
                value = self.parameters[name]
                integer = name in ("CA_AIRFRAME", "CA_METHOD", "CA_ROTOR_COUNT")
                bits = struct.pack("<i", int(value)) if integer else struct.pack("<f", value)
                send(_value(name, bits, 6 if integer else 9))


def _value(name: str, bits: bytes, kind: int) -> Any:
    return mavlink.MAVLink_param_value_message(name.encode(), struct.unpack("<f", bits)[0], kind, 900, 65535)
