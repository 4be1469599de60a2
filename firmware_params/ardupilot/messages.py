"""ESC_TELEMETRY_1_TO_4 (11030), 5_TO_8 and 9_TO_12: ArduPilot's own, not in pymavlink's `common` dialect.

Importing this module adds them to it. Fields as in MAVLink's ardupilotmega.xml. A motor is at the number of
its output; what an ESC does not tell is 0.
"""

from __future__ import annotations

from firmware_params.messages import message

ESC_TELEMETRY = {11030: 0, 11031: 4, 11032: 8}  # message: its first ESC, from 0
NAMES = tuple(f"ESC_TELEMETRY_{first + 1}_TO_{first + 4}" for first in ESC_TELEMETRY.values())
_FIELDS = (
    "uint8_t temperature[4], uint16_t voltage[4], uint16_t current[4], uint16_t totalcurrent[4], "
    "uint16_t rpm[4], uint16_t count[4]"
)
_UNITS = {"temperature": "degC", "voltage": "cV", "current": "cA", "totalcurrent": "mAh", "rpm": "rpm"}

(
    MAVLink_esc_telemetry_1_to_4_message,
    MAVLink_esc_telemetry_5_to_8_message,
    MAVLink_esc_telemetry_9_to_12_message,
) = (message(number, name, _FIELDS, units=_UNITS) for number, name in zip(ESC_TELEMETRY, NAMES, strict=True))
