"""What the autopilot says about itself: firmware, mode, battery, attitude, height, its last words.

The battery's word is the worse of the autopilot's (MAV_BATTERY_CHARGE_STATE) and of what the remaining
charge is by PX4's thresholds: the board's own if they were heard, else their defaults (BAT_LOW_THR 0.15,
BAT_CRIT_THR 0.07, BAT_EMERGEN_THR 0.05; PX4 v1.14 src/lib/battery/module.yaml). An ArduPilot without
failsafes says ok to the end. Its minutes are the autopilot's `time_remaining`; else the airframe's
`battery_Wh` over the power that is drawn; else how fast the remaining charge has been falling since the
vehicle was armed (`Drain`): five minutes on the ground say nothing of the flight that follows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.mavlink.modes import firmware_name, mode_name
from coaxlink.mavlink.telemetry import STALE_S, Battery, Telemetry, Timed
from coaxlink.monitor.incoming.heard import Heard
from coaxlink.monitor.incoming.table_reader import THRESHOLDS
from firmware_params.plain import plain

BATTERY_STALE_S = 5.0
_TEXT_S = 15.0  # how long a status text stays on the screen
_LANDED_S = 5.0  # how long the autopilot's word whether it flies is believed
_ABOVE_M = 0.5  # above ground or home, where the autopilot does not say whether it flies
_CHARGE = {
    mavlink.MAV_BATTERY_CHARGE_STATE_OK: "ok",
    mavlink.MAV_BATTERY_CHARGE_STATE_LOW: "low",
    mavlink.MAV_BATTERY_CHARGE_STATE_CRITICAL: "critical",
    mavlink.MAV_BATTERY_CHARGE_STATE_EMERGENCY: "emergency",
    mavlink.MAV_BATTERY_CHARGE_STATE_FAILED: "failed",
    mavlink.MAV_BATTERY_CHARGE_STATE_UNHEALTHY: "unhealthy",
    mavlink.MAV_BATTERY_CHARGE_STATE_CHARGING: "charging",
}
_LOW, _CRITICAL, _EMERGENCY = THRESHOLDS
_FALLING = ("ok", "low", "critical", "emergency")
_LEVELS = ((_EMERGENCY, 0.05, "emergency"), (_CRITICAL, 0.07, "critical"), (_LOW, 0.15, "low"))
_WINDOW_S = 300.0  # of the fall of the charge: a flight's power changes within minutes
_STEPS = 3  # falls of the remaining charge; it is reported in whole percents, so two ends err by one of three


@dataclass(frozen=True)
class VehicleState:
    """What the autopilot says about itself; None is not reported."""

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
    battery_word: str = ""  # ok, low, critical, ...; "" while nothing is reported
    battery_minutes: float | None = None  # left
    battery_minutes_by: str = ""  # autopilot, battery_Wh or trend


@dataclass(frozen=True)
class Drain:
    """When the remaining charge fell while armed, on the vehicle's clock: (time in s, remaining 0..1), oldest
    first."""

    falls: tuple[tuple[float, float], ...] = ()
    last: float | None = None

    def extended(self, clock_s: float | None, remaining: float | None, armed: bool) -> Drain:
        """With the present; a charge that rises, or a clock that goes back, begins anew, as does arming."""
        if not armed:
            return Drain()
        if clock_s is None or remaining is None or remaining == self.last:
            return self
        falls = self.falls
        back = self.last is not None and remaining > self.last
        if self.last is None or back or (falls and clock_s < falls[-1][0]):
            return Drain((), remaining)
        recent = tuple(f for f in falls if f[0] >= clock_s - _WINDOW_S)
        return Drain((*recent, (clock_s, remaining)), remaining)

    @property
    def minutes(self) -> float | None:
        """Until nothing remains at the pace of the last falls; None before it fell _STEPS times."""
        if len(self.falls) <= _STEPS:
            return None
        (first_s, first), (last_s, last) = self.falls[0], self.falls[-1]
        return last * (last_s - first_s) / (first - last) / 60.0 if last_s > first_s else None


def vehicle_of(
    heard: Heard, *, energy_Wh: float | None = None, trend_min: float | None = None
) -> VehicleState | None:
    """None before the first heartbeat; `energy_Wh` is of a full pack, `trend_min` what `Drain` found."""
    telemetry, now = heard.telemetry, heard.now()
    heartbeat = telemetry.newest("HEARTBEAT")
    if heartbeat is None:
        return None

    def old(timed: Timed | None, limit_s: float = STALE_S) -> bool:
        return timed is not None and now - timed.received_s > limit_s

    reported = battery_of(telemetry)
    pack = reported.value if reported else Battery(None, None, None)
    minutes, by = _minutes(pack, energy_Wh, trend_min)
    attitude = telemetry.latest("attitude")
    roll, pitch, yaw = attitude.value if attitude else (None, None, None)
    height, source, height_at = _height(telemetry)
    last = telemetry.texts[-1] if telemetry.texts else None
    return VehicleState(
        heard.target[0] if heard.target else 0,
        firmware_name(heartbeat.value.autopilot),
        version_of(telemetry),
        mode_name(heartbeat.value.autopilot, heartbeat.value.custom_mode),
        telemetry.armed,
        pack.voltage_V,
        pack.current_A,
        pack.remaining,
        old(reported, BATTERY_STALE_S),
        roll,
        pitch,
        yaw,
        old(attitude),
        height,
        source,
        old(height_at),
        telemetry.clock_s,
        plain(last.text, 100) if last and now - last.received_s <= _TEXT_S else "",
        _battery_word(pack, heard.parameters) if reported else "",
        minutes,
        by,
    )


def battery_of(telemetry: Telemetry) -> Timed | None:
    """The first battery whose voltage is reported."""
    return next((t for t in telemetry.each("battery").values() if t.value.voltage_V is not None), None)


def on_ground(telemetry: Telemetry) -> bool:
    """Whether it stands, by the autopilot's word, else by its height; True when nobody says."""
    state = telemetry.newest("EXTENDED_SYS_STATE")
    fresh = state is not None and telemetry.now() - state.received_s <= _LANDED_S
    if fresh and telemetry.landed_state != mavlink.MAV_LANDED_STATE_UNDEFINED:
        return telemetry.landed_state != mavlink.MAV_LANDED_STATE_IN_AIR
    height, _, at = _height(telemetry)
    return height is None or at is None or telemetry.now() - at.received_s > STALE_S or height < _ABOVE_M


def version_of(telemetry: Telemetry) -> str:
    """Firmware version as "1.16.1"; empty when it was not reported."""
    answer = telemetry.newest("AUTOPILOT_VERSION")
    number = int(answer.value.flight_sw_version) if answer else 0
    return ".".join(str(number >> shift & 0xFF) for shift in (24, 16, 8)) if number else ""


def _height(telemetry: Telemetry) -> tuple[float | None, str, Timed | None]:
    """Height in m, whose it is, and when it came: above ground if a range finder says so now."""
    if telemetry.get("height") is not None:
        ground = telemetry.latest("height")
        return telemetry.get("height"), "range", ground
    position, home = telemetry.latest("position"), telemetry.latest("home_height")
    if position is not None:
        return -position.value[2], "local", position
    return (home.value, "global", home) if home is not None else (None, "", None)


def _battery_word(pack: Battery, parameters: Mapping[str, float]) -> str:
    """A pack that charges, or has failed, is what it says; else the worse of its word and the thresholds'."""
    reported, judged = _CHARGE.get(pack.charge_state, ""), ""
    if pack.remaining is not None:
        judged = next((word for n, d, word in _LEVELS if pack.remaining <= _finite(parameters, n, d)), "ok")
    if not reported or not judged or reported not in _FALLING:
        return reported or judged
    return max(reported, judged, key=_FALLING.index)


def _finite(parameters: Mapping[str, float], name: str, default: float) -> float:
    value = parameters.get(name, default)
    return value if math.isfinite(value) else default


def _minutes(pack: Battery, energy_Wh: float | None, trend_min: float | None) -> tuple[float | None, str]:
    if pack.voltage_V is None:
        return None, ""
    if pack.remaining_s > 0.0:
        return pack.remaining_s / 60.0, "autopilot"
    if energy_Wh is not None and pack.remaining is not None and pack.current_A:
        return 60.0 * energy_Wh * pack.remaining / (pack.voltage_V * pack.current_A), "battery_Wh"
    return (trend_min, "trend") if trend_min is not None else (None, "")
