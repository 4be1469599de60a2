"""What the autopilot says about itself: firmware, mode, battery, attitude, height, its last words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from coaxlink.monitor.modes import ARMED_FLAG, firmware_name, mode_name
from coaxlink.monitor.readings import Arrival, Readings

_DOWN = 25  # MAV_SENSOR_ROTATION_PITCH_270: a range finder that looks down
_TEXT_S = 15.0  # how long a status text stays on the screen


@dataclass(frozen=True)
class Vehicle:
    """What the autopilot says about itself."""

    system: int
    firmware: str
    version: str
    mode: str
    armed: bool
    voltage_V: float | None
    current_A: float | None
    remaining: float | None  # 0..1
    battery_stale: bool
    roll_rad: float | None
    pitch_rad: float | None
    yaw_rad: float | None
    attitude_stale: bool
    height_m: float | None
    height_source: str  # range (above ground), local or global (above home)
    height_stale: bool
    clock_s: float | None
    text: str  # newest status text, if it is fresh


def vehicle_of(readings: Readings, now_s: float) -> Vehicle | None:
    """None before the first heartbeat."""
    heartbeat = readings.get("HEARTBEAT")
    if heartbeat is None:
        return None
    beat = heartbeat.message
    voltage, current, remaining, battery_s = _battery(readings)
    attitude = readings.get("ATTITUDE")
    roll, pitch, yaw = (_field(attitude, name) for name in ("roll", "pitch", "yaw"))
    height, source, height_s = _height(readings, now_s)
    text = readings.get("STATUSTEXT")
    return Vehicle(
        readings.target[0] if readings.target else 0,
        firmware_name(beat.autopilot),
        version_of(readings),
        mode_name(beat.autopilot, beat.custom_mode),
        bool(beat.base_mode & ARMED_FLAG),
        voltage,
        current,
        remaining,
        battery_s is not None and now_s - battery_s > 5.0,
        roll,
        pitch,
        yaw,
        is_old(attitude, now_s, 2.0),
        height,
        source,
        height_s is not None and now_s - height_s > 2.0,
        readings.clock_s,
        _plain(text.message.text) if text and now_s - text.received_s <= _TEXT_S else "",
    )


def _battery(readings: Readings) -> tuple[float | None, float | None, float | None, float | None]:
    """Voltage in V, current in A, remaining 0..1 of the first battery, and when it was told."""
    batteries = readings.batches("BATTERY_STATUS")
    if batteries:
        arrival = next(iter(batteries.values()))
        m = arrival.message
        cells = [v for v in m.voltages if v != 0xFFFF]
        voltage = sum(cells) / 1e3 if cells else None
    elif (found := readings.get("SYS_STATUS")) is not None:
        arrival, m = found, found.message
        voltage = m.voltage_battery / 1e3 if m.voltage_battery != 0xFFFF else None
    else:
        return None, None, None, None
    current = m.current_battery / 100 if m.current_battery >= 0 else None
    remaining = m.battery_remaining / 100 if m.battery_remaining >= 0 else None
    return voltage, current, remaining, arrival.received_s


def _height(readings: Readings, now_s: float) -> tuple[float | None, str, float | None]:
    """Height in m, whose it is, and when it was told: above ground if a range finder says so."""
    for arrival in readings.batches("DISTANCE_SENSOR").values():
        m = arrival.message
        seen = m.min_distance < m.current_distance < m.max_distance
        if m.orientation == _DOWN and seen and not is_old(arrival, now_s, 2.0):
            return m.current_distance / 100, "range", arrival.received_s
    local = readings.get("LOCAL_POSITION_NED")
    down = _field(local, "z")
    if local is not None and down is not None:
        return -down, "local", local.received_s
    place = readings.get("GLOBAL_POSITION_INT")
    if place is not None:
        return place.message.relative_alt / 1e3, "global", place.received_s
    return None, "", None


def version_of(readings: Readings) -> str:
    """Firmware version as "1.16.1"; empty when it was not told."""
    arrival = readings.get("AUTOPILOT_VERSION")
    number = int(arrival.message.flight_sw_version) if arrival else 0
    return ".".join(str(number >> shift & 0xFF) for shift in (24, 16, 8)) if number else ""


def is_old(arrival: Arrival | None, now_s: float, limit_s: float) -> bool:
    return arrival is not None and now_s - arrival.received_s > limit_s


def _field(arrival: Arrival | None, name: str) -> float | None:
    return None if arrival is None else finite(getattr(arrival.message, name))


def finite(value: Any) -> float | None:
    """The number, or None for NaN and infinity."""
    number = float(value)
    return number if math.isfinite(number) else None


def _plain(text: Any) -> str:
    """A status text without what a terminal would act on."""
    raw = text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)
    return "".join(c for c in raw if c.isprintable()).strip()
