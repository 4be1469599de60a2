"""The messages the screen lives on: asked for when they do not come, and again when they stop.

An autopilot is asked only for what it knows: ArduPilot answers a request for ESC_STATUS with a text to every
ground station. Its ESC_TELEMETRY_* come all together for the first one.
"""

from __future__ import annotations

import time

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import LinkError
from coaxlink.mavlink import Session
from coaxlink.monitor.watch import Watch

GONE_S = 5.0  # a stream that is silent for so long is asked for again
_COMMON = {
    "SERVO_OUTPUT_RAW": (mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, 10.0),
    "ATTITUDE": (mavlink.MAVLINK_MSG_ID_ATTITUDE, 10.0),
    "LOCAL_POSITION_NED": (mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, 5.0),
    "BATTERY_STATUS": (mavlink.MAVLINK_MSG_ID_BATTERY_STATUS, 1.0),
    "SYS_STATUS": (mavlink.MAVLINK_MSG_ID_SYS_STATUS, 1.0),
    "EXTENDED_SYS_STATE": (mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 1.0),
}
_PX4 = {"ESC_STATUS": (291, 10.0)}
_ARDUPILOT = {"ESC_TELEMETRY_1_TO_4": (11030, 10.0)}
# only a legacy mixer's demand can be turned into newtons
_LEGACY = {"ACTUATOR_CONTROL_TARGET": (mavlink.MAVLINK_MSG_ID_ACTUATOR_CONTROL_TARGET, 10.0)}
TRIES = 3  # of a stream that was promised and never came: the vehicle has none of it


class Streams:
    """Asks one vehicle; what it refuses is not asked for again."""

    def __init__(self, watch: Watch, session: Session) -> None:
        self._watch, self._session = watch, session
        identity = session.identity
        self._wanted = dict(_COMMON)
        self._wanted |= _PX4 if identity.is_px4 else _ARDUPILOT
        if identity.is_px4 and (identity.version or (99,)) < (1, 14):
            self._wanted |= _LEGACY
        self._left = dict.fromkeys(self._wanted, TRIES)

    def request_missing(self) -> None:
        """Ask for what has not come by itself, or no longer comes."""
        now = time.monotonic()
        latest = self._watch.collector.readings(now).latest
        fresh = {key.partition("[")[0] for key, a in latest.items() if now - a.received_s <= GONE_S}
        for name in fresh & self._left.keys():
            self._left[name] = TRIES
        for name, (message_id, rate_hz) in self._wanted.items():
            if name in fresh or not self._left[name]:
                continue
            self._left[name] -= 1
            try:
                if not self._session.request_stream(message_id, rate_hz):
                    self._left[name] = 0
            except LinkError:
                return  # nobody acknowledges here: do not keep asking
