"""Framing and the hot messages of live mixing by hand: a tenth of what pymavlink's objects cost.

Only what passes at the rate of the demand is here; everything else goes through pymavlink, and a property
test holds every field of these messages against pymavlink's bytes. Layout: MAVLink 2 (and 1) serialisation,
fields by size, CRC-16/MCRF4XX over header, payload and the message's own seed byte, trailing zeros cut.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from fastcrc.crc16 import mcrf4xx

V1, V2 = 0xFE, 0xFD
SIGNED = 0x01
SIGNATURE = 13  # bytes that follow the checksum of a signed frame
LONGEST = 280


@dataclass(frozen=True)
class Hot:
    """One message: its number, the order of its fields on the wire, its CRC seed."""

    name: str
    number: int
    layout: struct.Struct
    seed: bytes

    def pack(self, sequence: int, system: int, component: int, *fields: Any) -> bytes:
        """A MAVLink 2 frame; `fields` in wire order."""
        payload = self.layout.pack(*fields).rstrip(b"\0") or b"\0"
        head = _HEAD.pack(len(payload), 0, 0, sequence, system, component, self.number & 0xFFFF, 0)
        body = head + payload
        return b"\xfd" + body + _CRC.pack(mcrf4xx(body + self.seed))

    def unpack(self, payload: bytes) -> tuple[Any, ...]:
        """Fields in wire order of a payload, whose cut zeros are put back. Longer ones are newer: cut."""
        size = self.layout.size
        if len(payload) != size:
            payload = payload[:size].ljust(size, b"\0")
        return self.layout.unpack(payload)


_HEAD = struct.Struct("<BBBBBBHB")
_CRC = struct.Struct("<H")


def _hot(name: str, number: int, layout: str, seed: int) -> Hot:
    return Hot(name, number, struct.Struct(f"<{layout}"), bytes([seed]))


# time_usec, controls (8), group_mlx
ACTUATOR_CONTROL_TARGET = _hot("ACTUATOR_CONTROL_TARGET", 140, "Q8fB", 181)
# time_usec, controls (8), group_mlx, target_system, target_component
SET_ACTUATOR_CONTROL_TARGET = _hot("SET_ACTUATOR_CONTROL_TARGET", 139, "Q8fBBB", 168)
# time_usec, active, actuator (32)
ACTUATOR_OUTPUT_STATUS = _hot("ACTUATOR_OUTPUT_STATUS", 375, "QI32f", 251)
# time_usec, array_id, name, data (58)
DEBUG_FLOAT_ARRAY = _hot("DEBUG_FLOAT_ARRAY", 350, "QH10s58f", 232)
# payload_type, target_system, target_component, payload_length, payload
TUNNEL = _hot("TUNNEL", 385, "HBBB128s", 147)

HOT = {
    m.number: m
    for m in (
        ACTUATOR_CONTROL_TARGET,
        SET_ACTUATOR_CONTROL_TARGET,
        ACTUATOR_OUTPUT_STATUS,
        DEBUG_FLOAT_ARRAY,
        TUNNEL,
    )
}


class Frame(NamedTuple):
    """A frame whose checksum is right."""

    number: int
    sequence: int
    system: int
    component: int
    payload: bytes
    raw: bytes  # all of it, its signature too


class Scanner:
    """Bytes in, the frames of the wanted messages out; what is split between chunks is put together.

    Frames of other messages are skipped by their length where their CRC seed is unknown.
    """

    def __init__(self, wanted: frozenset[int] | set[int] = frozenset(HOT), seeds: Any = None) -> None:
        self._wanted = wanted
        self._seeds: dict[int, bytes] = seeds if seeds is not None else {n: h.seed for n, h in HOT.items()}
        self._rest = b""
        self.damaged = 0  # frames whose checksum was wrong, or noise between frames (counted once a run)

    def feed(self, data: bytes) -> list[Frame]:
        """The wanted frames completed by `data`.

        What waits for its other half was noise where `data` by itself is one whole frame that is wanted: a
        frame that only begins does not hold up those behind it.
        """
        if self._rest:
            if not self._whole(data):
                data = self._rest + data
            self._rest = b""
        found: list[Frame] = []
        at, end = 0, len(data)
        noise = False
        while at < end:
            start = data[at]
            if start != V2 and start != V1:
                if not noise:
                    self.damaged += 1
                    noise = True
                at += 1
                continue
            if at + 3 > end:
                break
            total = _size(data, at)
            if at + total > end:
                break
            frame = self._frame(data, at, total)
            if frame is None:  # not a frame: look for the next start inside it
                if not noise:
                    self.damaged += 1
                    noise = True
                at += 1
                continue
            noise = False
            if frame:
                found.append(frame)
            at += total
        self._rest = data[at:] if at < end else b""
        return found

    def _whole(self, data: bytes) -> bool:
        framed = len(data) >= 8 and data[0] in (V1, V2) and _size(data, 0) == len(data)
        return bool(framed and self._frame(data, 0, len(data)))

    def _frame(self, data: bytes, at: int, total: int) -> Frame | Literal[False] | None:
        """The frame; False for one that is not wanted; None for one that is damaged."""
        head = 10 if data[at] == V2 else 6
        if head == 10:
            if data[at + 2] & ~SIGNED:  # an incompatibility nobody here knows
                return None
            number = data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16
        else:
            number = data[at + 5]
        seed = self._seeds.get(number)
        stop = at + head + data[at + 1]
        if seed is None:
            return False
        if mcrf4xx(data[at + 1 : stop] + seed) != data[stop] | data[stop + 1] << 8:
            return None
        if number not in self._wanted:
            return False
        ids = at + 4 if head == 10 else at + 2
        payload, raw = data[at + head : stop], data[at : at + total]
        return Frame(number, data[ids], data[ids + 1], data[ids + 2], payload, raw)


def _size(data: bytes, at: int) -> int:
    """Bytes of the frame that begins there, by its header."""
    if data[at] == V1:
        return 8 + data[at + 1]
    return 12 + data[at + 1] + (SIGNATURE if data[at + 2] & SIGNED else 0)


def of_others(data: bytes, system: int) -> bool:
    """Whether a datagram is made of whole frames of other systems, none of which commands motors.

    By their headers alone: a quick look at what nobody here would use.
    """
    at, end = 0, len(data)
    while at + 8 <= end:
        if data[at] == V2 and at + 12 <= end:
            whose, number = data[at + 5], data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16
            size = 12 + data[at + 1] + (SIGNATURE if data[at + 2] & SIGNED else 0)
        elif data[at] == V1:
            whose, number, size = data[at + 3], data[at + 5], 8 + data[at + 1]
        else:
            return False
        if whose == system or number == SET_ACTUATOR_CONTROL_TARGET.number:
            return False
        at += size
    return at == end and end > 0


def known_seeds() -> dict[int, bytes]:
    """The CRC seed of every message of pymavlink's dialect: no damaged frame passes for a long skip."""
    from pymavlink.dialects.v20 import common

    return {number: bytes([kind.crc_extra]) for number, kind in common.mavlink_map.items()} | {
        n: h.seed for n, h in HOT.items()
    }
