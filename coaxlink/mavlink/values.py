"""Parameters as they travel: a value's bits in the float field of the wire.

Uploads, live mixing and the monitor all read and write them here.

PX4 sends an int32 bytewise in the float field, ArduPilot sends every value as a float; which of the two is
read from the capability bits, else from the kind of autopilot.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import InputError

Message = Any  # a pymavlink message
Number = float | int
_INTEGERS = {
    mavlink.MAV_PARAM_TYPE_UINT8: ("B", 0, 255),
    mavlink.MAV_PARAM_TYPE_INT8: ("b", -128, 127),
    mavlink.MAV_PARAM_TYPE_UINT16: ("H", 0, 65535),
    mavlink.MAV_PARAM_TYPE_INT16: ("h", -32768, 32767),
    mavlink.MAV_PARAM_TYPE_UINT32: ("I", 0, 2**32 - 1),
    mavlink.MAV_PARAM_TYPE_INT32: ("i", -(2**31), 2**31 - 1),
}
FLOAT = mavlink.MAV_PARAM_TYPE_REAL32


@dataclass(frozen=True)
class Value:
    """A parameter as the vehicle holds it."""

    name: str
    value: Number
    type: int  # MAV_PARAM_TYPE
    bits: bytes  # the four bytes of the wire's float field, for comparing

    def same(self, other: Value) -> bool:
        """True when type and every bit agree."""
        return self.type == other.type and self.bits == other.bits


def is_bytewise(autopilot: int, capabilities: int | None = None) -> bool:
    """Whether a vehicle of this MAV_AUTOPILOT sends integers as raw bytes; its capability bits know best."""
    if not capabilities:
        return autopilot == mavlink.MAV_AUTOPILOT_PX4
    return bool(capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE)


def encode(name: str, value: Number, kind: int, bytewise: bool) -> Value:
    """The wire's bits of a value, and the value as the vehicle will store it.

    Raises InputError for what the type cannot hold.
    """
    if kind not in _INTEGERS:
        if not math.isfinite(value):
            raise InputError(name, "", f"a finite number is expected, found {value}")
        bits = struct.pack("<f", value)
        return Value(name, struct.unpack("<f", bits)[0], kind, bits)
    code, low, high = _INTEGERS[kind]
    if not math.isfinite(value) or value != int(value) or not low <= value <= high:
        raise InputError(name, "", f"an integer in {low}..{high} is expected, found {value}")
    if bytewise:
        return Value(name, int(value), kind, struct.pack(f"<{code}", int(value)).ljust(4, b"\0"))
    return Value(name, int(value), kind, struct.pack("<f", float(value)))


def decode(message: Message, bytewise: bool) -> Value:
    """The parameter in a PARAM_VALUE, the one way for all that hear one; `bytewise` as `is_bytewise` says."""
    name, bits, kind = str(message.param_id), raw_bits(message), int(message.param_type)
    if kind not in _INTEGERS:
        return Value(name, struct.unpack("<f", bits)[0], kind, bits)
    if not bytewise:
        sent = float(message.param_value)
        return Value(name, int(sent) if math.isfinite(sent) else sent, kind, bits)
    code = _INTEGERS[kind][0]
    size = struct.calcsize(code)
    return Value(name, struct.unpack(f"<{code}", bits[:size])[0], kind, bits[:size].ljust(4, b"\0"))


class ParamSet(mavlink.MAVLink_param_set_message):
    """PARAM_SET whose value travels as bits: some int32 patterns would not survive being a Python float."""

    def __init__(self, system: int, component: int, value: Value) -> None:
        super().__init__(system, component, value.name.encode("ascii"), 0.0, value.type)
        self._bits = value.bits

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        rest = self.unpacker.pack(
            0.0, self.target_system, self.target_component, self._param_id_raw, self.param_type
        )
        frame = self._pack(mav, self.crc_extra, self._bits + rest[4:], force_mavlink1=force_mavlink1)
        return bytes(frame)


def raw_bits(message: Message) -> bytes:
    """The four bytes of PARAM_VALUE's value as they came, or would go."""
    frame = message.get_msgbuf()
    if not frame:  # not off a wire
        return struct.pack("<f", message.param_value)
    start = 10 if frame[0] == mavlink.PROTOCOL_MARKER_V2 else 6
    return bytes(frame[start : start + 4])
