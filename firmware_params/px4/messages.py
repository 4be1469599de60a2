"""ESC_INFO (290) and ESC_STATUS (291), which PX4 sends and pymavlink up to 2.4.50 cannot read.

Importing this module adds both to pymavlink's `common` dialect. Fields, wire order (largest first) and the
CRC seed follow the public MAVLink definition, common.xml.
"""

# ruff: noqa: RUF012, SIM905  (class attributes as pymavlink lays them out)

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

from pymavlink.dialects.v20 import common

ESC_INFO, ESC_STATUS = 290, 291


class MAVLink_esc_info_message(common.MAVLink_message):  # noqa: N801 - pymavlink's naming
    """State of four ESCs, about 1 Hz: counters, failure flags, temperature in 0.01 degC."""

    id = ESC_INFO
    msgname = name = "ESC_INFO"
    fieldnames = (
        "index time_usec counter count connection_type info failure_flags error_count temperature".split()
    )
    ordered_fieldnames = (
        "time_usec error_count counter failure_flags temperature index count connection_type info".split()
    )
    fieldtypes = "uint8_t uint64_t uint16_t uint8_t uint8_t uint8_t uint16_t uint32_t int16_t".split()
    fielddisplays_by_name: dict[str, str] = {}
    fieldenums_by_name: dict[str, str] = {}
    fieldunits_by_name = {"time_usec": "us", "temperature": "cdegC"}
    native_format = bytearray(b"<QIHHhBBBB")
    orders = [5, 0, 2, 6, 7, 8, 3, 1, 4]
    lengths = [1, 4, 1, 4, 4, 1, 1, 1, 1]
    array_lengths = [0, 4, 0, 4, 4, 0, 0, 0, 0]
    crc_extra = 251
    unpacker = struct.Struct("<Q4IH4H4hBBBB")
    instance_field = "index"
    instance_offset = 42

    def __init__(
        self,
        index: int,
        time_usec: int,
        counter: int,
        count: int,
        connection_type: int,
        info: int,
        failure_flags: Sequence[int],
        error_count: Sequence[int],
        temperature: Sequence[int],
    ) -> None:
        values = (
            index,
            time_usec,
            counter,
            count,
            connection_type,
            info,
            failure_flags,
            error_count,
            temperature,
        )
        fill(self, values)

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """The frame, as pymavlink's own messages make it."""
        return pack(self, mav, force_mavlink1)


class MAVLink_esc_status_message(common.MAVLink_message):  # noqa: N801 - pymavlink's naming
    """Speed (rpm), voltage (V) and current (A) of the four ESCs from `index` on."""

    id = ESC_STATUS
    msgname = name = "ESC_STATUS"
    fieldnames = "index time_usec rpm voltage current".split()
    ordered_fieldnames = "time_usec rpm voltage current index".split()
    fieldtypes = "uint8_t uint64_t int32_t float float".split()
    fielddisplays_by_name: dict[str, str] = {}
    fieldenums_by_name: dict[str, str] = {}
    fieldunits_by_name = {"time_usec": "us", "rpm": "rpm", "voltage": "V", "current": "A"}
    native_format = bytearray(b"<QiffB")
    orders = [4, 0, 1, 2, 3]
    lengths = [1, 4, 4, 4, 1]
    array_lengths = [0, 4, 4, 4, 0]
    crc_extra = 10
    unpacker = struct.Struct("<Q4i4f4fB")
    instance_field = "index"
    instance_offset = 56

    def __init__(
        self,
        index: int,
        time_usec: int,
        rpm: Sequence[int],
        voltage: Sequence[float],
        current: Sequence[float],
    ) -> None:
        fill(self, (index, time_usec, rpm, voltage, current))

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """The frame, as pymavlink's own messages make it."""
        return pack(self, mav, force_mavlink1)


def fill(message: Any, values: Sequence[Any]) -> None:
    """Make a message of a class that is laid out as these are, with its fields in their order."""
    kind = type(message)
    common.MAVLink_message.__init__(message, kind.id, kind.msgname)
    message._fieldnames = kind.fieldnames
    message._instance_field, message._instance_offset = kind.instance_field, kind.instance_offset
    for name, value in zip(kind.fieldnames, values, strict=True):
        setattr(message, name, value)


def pack(message: Any, mav: Any, force_mavlink1: bool) -> bytes:
    """The frame of such a message."""
    flat: list[Any] = []
    for name in message.ordered_fieldnames:
        value = getattr(message, name)
        flat.extend(value) if isinstance(value, list | tuple) else flat.append(value)
    payload = message.unpacker.pack(*flat)
    return bytes(message._pack(mav, message.crc_extra, payload, force_mavlink1=force_mavlink1))


def register(dialect: Any = common) -> None:
    """Make a pymavlink dialect module read both messages; one it knows already stays."""
    dialect.mavlink_map.setdefault(ESC_INFO, MAVLink_esc_info_message)
    dialect.mavlink_map.setdefault(ESC_STATUS, MAVLink_esc_status_message)


register()
