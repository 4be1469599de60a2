"""ESC_INFO (290) and ESC_STATUS (291), which PX4 sends and pymavlink up to 2.4.50 cannot read.

Importing this module adds both to pymavlink's `common` dialect. Fields as in MAVLink's common.xml.
"""

from __future__ import annotations

from firmware_params.messages import message

ESC_INFO, ESC_STATUS = 290, 291

# state of four ESCs, about 1 Hz: counters, failure flags, temperature
MAVLink_esc_info_message = message(
    ESC_INFO,
    "ESC_INFO",
    "uint8_t index, uint64_t time_usec, uint16_t counter, uint8_t count, uint8_t connection_type, "
    "uint8_t info, uint16_t failure_flags[4], uint32_t error_count[4], int16_t temperature[4]",
    units={"time_usec": "us", "temperature": "cdegC"},
    instance="index",
)
# of the four ESCs from `index` on
MAVLink_esc_status_message = message(
    ESC_STATUS,
    "ESC_STATUS",
    "uint8_t index, uint64_t time_usec, int32_t rpm[4], float voltage[4], float current[4]",
    units={"time_usec": "us", "rpm": "rpm", "voltage": "V", "current": "A"},
    instance="index",
)
