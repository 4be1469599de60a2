"""What live compensation reads of the vehicle: the newest value of each kind, how old it is, who sends it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.effects import effect

STALE_S = 2.0


class Telemetry:
    """The newest of what effects read, with the (monotonic) time it came; fed by a session."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock = clock
        self._values: dict[str, tuple[float, Any]] = {}

    def hear(self, message: Any) -> None:
        """Session subscriber."""
        name = message.get_type()
        if name == "BATTERY_STATUS" and message.id == 0:
            cells = [v for v in message.voltages if 0 < v < 0xFFFF]
            self._put("voltage", sum(cells) / 1e3 if cells else math.nan)
        elif name == "SYS_STATUS" and 0 < message.voltage_battery < 0xFFFF:
            self._put("voltage", message.voltage_battery / 1e3)
        elif name == "DISTANCE_SENSOR" and message.orientation == 25:
            self._put("height", message.current_distance / 100.0)
        elif name == "LOCAL_POSITION_NED":
            self._put("velocity", (message.vx, message.vy, message.vz))
        elif name == "ATTITUDE":
            self._put("attitude", (message.roll, message.pitch, message.yaw))
            self._put("rates", (message.rollspeed, message.pitchspeed, message.yawspeed))
        elif name == "HIGHRES_IMU" and message.fields_updated & 0x200:
            self._put("pressure", 100.0 * message.abs_pressure)
        elif name == "SCALED_PRESSURE":
            self._put("pressure", 100.0 * message.press_abs)
        elif name == "HYGROMETER_SENSOR":  # a barometer's own temperature is the board's, not the air's
            self._put("air", message.temperature / 100.0)

    def _put(self, name: str, value: Any) -> None:
        numbers = value if isinstance(value, tuple) else (value,)
        if all(math.isfinite(v) for v in numbers):
            self._values[name] = (self.clock(), value)

    def get(self, name: str) -> Any:
        """The value, None when there is none or it is stale."""
        found = self._values.get(name)
        return found[1] if found and self.clock() - found[0] <= STALE_S else None

    def age(self, name: str) -> float:
        """Seconds since the value came; 0 where there is none."""
        found = self._values.get(name)
        return max(self.clock() - found[0], 0.0) if found else 0.0


def body_axes(roll: float, pitch: float, yaw: float) -> list[list[float]]:
    """(3, 3) rotation from NED to body (FRD) for the angles yaw, pitch, roll (z, y, x)."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return [
        [cp * cy, cp * sy, -sp],
        [sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp],
        [cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp],
    ]


def wanted_streams(names: Sequence[str]) -> dict[int, float]:
    """Message id -> rate in Hz of what these effects read."""
    rates: dict[int, float] = {}
    for name in names:
        known = effect(name)
        for message, rate_hz in (known.messages if known else {}).items():
            message_id = getattr(mavlink, f"MAVLINK_MSG_ID_{message}")
            rates[message_id] = max(rate_hz, rates.get(message_id, 0.0))
    return rates
