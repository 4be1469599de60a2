"""What the autopilot says about itself: firmware, mode, battery, attitude, height, its last words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from coaxlink.monitor.telemetry.battery import battery_of
from coaxlink.monitor.telemetry.modes import ARMED_FLAG, firmware_name, mode_name
from coaxlink.monitor.telemetry.readings import Arrival, Readings
from firmware_params.plain import plain

_DOWN = 25  # MAV_SENSOR_ROTATION_PITCH_270: a range finder that looks down
_TEXT_S = 15.0  # how long a status text stays on the screen
_OLD_S = 2.0  # of a height or a speed
_IN_AIR = 2  # MAV_LANDED_STATE
_ABOVE_M = 0.5  # above ground or home, where the autopilot does not say whether it flies


@dataclass(frozen=True)
class VehicleState:
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
    battery_word: str = ""  # ok, low, critical, ...
    battery_minutes: float | None = None  # left
    battery_minutes_by: str = ""  # autopilot, battery_Wh or trend


def is_armed(readings: Readings) -> bool:
    """By the last heartbeat; False before the first."""
    heartbeat = readings.get("HEARTBEAT")
    return heartbeat is not None and bool(heartbeat.message.base_mode & ARMED_FLAG)


def vehicle_of(
    readings: Readings,
    now_s: float,
    *,
    energy_Wh: float | None = None,
    trend_min: float | None = None,
) -> VehicleState | None:
    """None before the first heartbeat; the last two as in `battery.battery_of`."""
    heartbeat = readings.get("HEARTBEAT")
    if heartbeat is None:
        return None
    beat = heartbeat.message
    pack = battery_of(readings, energy_Wh=energy_Wh, trend_min=trend_min)
    attitude = readings.get("ATTITUDE")
    roll, pitch, yaw = (_field(attitude, name) for name in ("roll", "pitch", "yaw"))
    height, source, height_s = _height(readings, now_s)
    last = readings.texts[-1] if readings.texts else None
    return VehicleState(
        readings.target[0] if readings.target else 0,
        firmware_name(beat.autopilot),
        version_of(readings),
        mode_name(beat.autopilot, beat.custom_mode),
        is_armed(readings),
        pack.voltage_V,
        pack.current_A,
        pack.remaining,
        pack.received_s is not None and now_s - pack.received_s > 5.0,
        roll,
        pitch,
        yaw,
        is_old(attitude, now_s, 2.0),
        height,
        source,
        height_s is not None and now_s - height_s > 2.0,
        readings.clock_s,
        plain(last.text, 100) if last and now_s - last.received_s <= _TEXT_S else "",
        pack.word,
        pack.minutes,
        pack.minutes_by,
    )


def on_ground(readings: Readings, now_s: float) -> bool:
    """Whether it stands, by the autopilot's word, else by its height; True when nobody says."""
    state = readings.get("EXTENDED_SYS_STATE")
    if state is not None and not is_old(state, now_s, 5.0) and state.message.landed_state:
        return bool(state.message.landed_state != _IN_AIR)
    height, _, reported_s = _height(readings, now_s)
    return height is None or reported_s is None or now_s - reported_s > _OLD_S or height < _ABOVE_M


def vertical_speed(readings: Readings, now_s: float) -> float | None:
    """m/s, down; None when nobody tells it now."""
    for name, field, scale in (
        ("LOCAL_POSITION_NED", "vz", 1.0),
        ("GLOBAL_POSITION_INT", "vz", 0.01),
        ("VFR_HUD", "climb", -1.0),
    ):
        arrival = readings.get(name)
        value = _field(arrival, field)
        if value is not None and not is_old(arrival, now_s, _OLD_S):
            return scale * value
    return None


def _height(readings: Readings, now_s: float) -> tuple[float | None, str, float | None]:
    """Height in m, whose it is, and when it was told: above ground if a range finder says so."""
    for arrival in readings.batches("DISTANCE_SENSOR").values():
        m = arrival.message
        in_range = m.min_distance < m.current_distance < m.max_distance
        if m.orientation == _DOWN and in_range and not is_old(arrival, now_s, 2.0):
            return m.current_distance / 100, "range", arrival.received_s
    local = readings.get("LOCAL_POSITION_NED")
    down = _field(local, "z")
    if local is not None and down is not None:
        return -down, "local", local.received_s
    position = readings.get("GLOBAL_POSITION_INT")
    if position is not None:
        return position.message.relative_alt / 1e3, "global", position.received_s
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
