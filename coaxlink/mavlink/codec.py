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

    def alone(self, data: bytes, system: int, component: int) -> tuple[Any, ...] | None:
        """Fields of a datagram that is just this message from there, unsigned and whole; else None.

        The short way of what comes hundreds of times a second; `Scanner` deals with everything else.
        """
        size = len(data)
        if (
            size < 13
            or data[0] != V2
            or data[2]
            or data[1] + 12 != size
            or data[5] != system
            or data[6] != component
            or data[7] | data[8] << 8 | data[9] << 16 != self.number
            or mcrf4xx(data[1:-2] + self.seed) != data[-2] | data[-1] << 8
        ):
            return None
        return self.unpack(data[10:-2])

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
# time_boot_ms, q1..q4, rollspeed, pitchspeed, yawspeed, repr_offset_q (4)
ATTITUDE_QUATERNION = _hot("ATTITUDE_QUATERNION", 31, "I7f4f", 246)
# time_boot_ms, q (4), body_roll_rate, body_pitch_rate, body_yaw_rate, thrust, type_mask
ATTITUDE_TARGET = _hot("ATTITUDE_TARGET", 83, "I4f4fB", 22)
# time_usec, active, actuator (32)
ACTUATOR_OUTPUT_STATUS = _hot("ACTUATOR_OUTPUT_STATUS", 375, "QI32f", 251)

HOT = {
    m.number: m
    for m in (
        ACTUATOR_CONTROL_TARGET,
        SET_ACTUATOR_CONTROL_TARGET,
        ATTITUDE_QUATERNION,
        ATTITUDE_TARGET,
        ACTUATOR_OUTPUT_STATUS,
    )
}


def fields_of(message: Any) -> tuple[Any, ...]:
    """The fields of one of pymavlink's messages of these kinds, in wire order."""
    flat: list[Any] = []
    for name in message.ordered_fieldnames:
        value = getattr(message, name)
        flat += value if isinstance(value, list | tuple) else [value]
    return tuple(flat)


class Frame(NamedTuple):
    """A frame whose checksum is right."""

    number: int
    sequence: int
    system: int
    component: int
    payload: bytes
    signed: bool


class Scanner:
    """Bytes in, the frames of the wanted messages out; what is split between chunks is put together.

    Frames of other messages are skipped by their length where their CRC seed is unknown.
    """

    def __init__(self, wanted: frozenset[int] | set[int] = frozenset(HOT), seeds: Any = None) -> None:
        self._wanted = wanted
        self._seeds: dict[int, bytes] = seeds if seeds is not None else {n: h.seed for n, h in HOT.items()}
        self._rest = b""
        self.damaged = 0  # frames whose checksum was wrong, or noise between frames (counted once a run)

    def drop(self) -> None:
        """Wait for no other half: the next bytes are a beginning."""
        self._rest = b""

    def feed(self, data: bytes) -> list[Frame]:
        """The wanted frames completed by `data`."""
        if self._rest:
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
            head = 10 if start == V2 else 6
            if at + head > end:
                break
            length = data[at + 1]
            signed = start == V2 and bool(data[at + 2] & SIGNED)
            total = head + length + 2 + (SIGNATURE if signed else 0)
            if at + total > end:
                break
            frame = self._frame(data, at, head, length, signed)
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

    def _frame(
        self, data: bytes, at: int, head: int, length: int, signed: bool
    ) -> Frame | Literal[False] | None:
        """The frame; False for one that is not wanted; None for one that is damaged."""
        if head == 10:
            if data[at + 2] & ~SIGNED:  # an incompatibility nobody here knows
                return None
            number = data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16
        else:
            number = data[at + 5]
        seed = self._seeds.get(number)
        stop = at + head + length
        if seed is None:
            return False
        if mcrf4xx(data[at + 1 : stop] + seed) != data[stop] | data[stop + 1] << 8:
            return None
        if number not in self._wanted:
            return False
        ids = at + 4 if head == 10 else at + 2
        return Frame(number, data[ids], data[ids + 1], data[ids + 2], data[at + head : stop], signed)


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
