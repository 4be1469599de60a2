"""ESC_TELEMETRY_1_TO_4 (11030), 5_TO_8 and 9_TO_12: ArduPilot's own, not in pymavlink's `common` dialect.

Importing this module adds them to it. Fields, wire order (largest first) and the CRC seeds follow
the public MAVLink definition, ardupilotmega.xml. A motor is at the number of its output; what an ESC does
not tell is 0.
"""

# ruff: noqa: N801, RUF012, SIM905  (classes as pymavlink names and lays them out)

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

from pymavlink.dialects.v20 import common

from firmware_params.px4.messages import fill, pack

ESC_TELEMETRY = {11030: 0, 11031: 4, 11032: 8}  # message: its first ESC, from 0
NAMES = tuple(f"ESC_TELEMETRY_{first + 1}_TO_{first + 4}" for first in ESC_TELEMETRY.values())


class _EscTelemetry(common.MAVLink_message):
    """degC, cV, cA, mAh, rpm and a running count of four ESCs."""

    fieldnames = "temperature voltage current totalcurrent rpm count".split()
    ordered_fieldnames = "voltage current totalcurrent rpm count temperature".split()
    fieldtypes = "uint8_t uint16_t uint16_t uint16_t uint16_t uint16_t".split()
    fielddisplays_by_name: dict[str, str] = {}
    fieldenums_by_name: dict[str, str] = {}
    fieldunits_by_name = {
        "temperature": "degC",
        "voltage": "cV",
        "current": "cA",
        "totalcurrent": "mAh",
        "rpm": "rpm",
    }
    native_format = bytearray(b"<HHHHHB")
    orders = [5, 0, 1, 2, 3, 4]
    lengths = [4] * 6
    array_lengths = [4] * 6
    unpacker = struct.Struct("<4H4H4H4H4H4B")
    instance_field = None
    instance_offset = -1

    def __init__(
        self,
        temperature: Sequence[int],
        voltage: Sequence[int],
        current: Sequence[int],
        totalcurrent: Sequence[int],
        rpm: Sequence[int],
        count: Sequence[int],
    ) -> None:
        fill(self, (temperature, voltage, current, totalcurrent, rpm, count))

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """The frame, as pymavlink's own messages make it."""
        return pack(self, mav, force_mavlink1)


class MAVLink_esc_telemetry_1_to_4_message(_EscTelemetry):
    """ESCs 1 to 4."""

    id, crc_extra = 11030, 144
    msgname = name = NAMES[0]


class MAVLink_esc_telemetry_5_to_8_message(_EscTelemetry):
    """ESCs 5 to 8."""

    id, crc_extra = 11031, 133
    msgname = name = NAMES[1]


class MAVLink_esc_telemetry_9_to_12_message(_EscTelemetry):
    """ESCs 9 to 12."""

    id, crc_extra = 11032, 85
    msgname = name = NAMES[2]


def register(dialect: Any = common) -> None:
    """Make a pymavlink dialect module read them; one it knows already stays."""
    for kind in (
        MAVLink_esc_telemetry_1_to_4_message,
        MAVLink_esc_telemetry_5_to_8_message,
        MAVLink_esc_telemetry_9_to_12_message,
    ):
        dialect.mavlink_map.setdefault(kind.id, kind)


register()
