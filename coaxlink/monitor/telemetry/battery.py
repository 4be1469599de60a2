"""The battery: what it reads, in a word, and for how many minutes it lasts.

The word is the worse of the autopilot's (MAV_BATTERY_CHARGE_STATE) and of what the remaining charge is by
PX4's thresholds: the board's own if they were heard, else their defaults (BAT_LOW_THR 0.15, BAT_CRIT_THR
0.07, BAT_EMERGEN_THR 0.05; PX4 v1.14 src/lib/battery/module.yaml). An ArduPilot without failsafes says ok
to the end.

Minutes: the autopilot's `time_remaining`; else the airframe's `battery_Wh` over the power that is drawn; else
how fast the remaining charge has been falling since the vehicle was armed, once it fell by three of its whole
percents: five minutes on the ground say nothing of the flight that follows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from coaxlink.monitor.telemetry.readings import Readings

_NO_CELL = 0xFFFF
_WORDS = {
    1: "ok",
    2: "low",
    3: "critical",
    4: "emergency",
    5: "failed",
    6: "unhealthy",
    7: "charging",
}
_DOWN = ("ok", "low", "critical", "emergency")
THRESHOLDS = ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR")
_THRESHOLDS = (("BAT_EMERGEN_THR", 0.05, "emergency"), ("BAT_CRIT_THR", 0.07, "critical"))
_LOW = ("BAT_LOW_THR", 0.15, "low")
_WINDOW_S = 300.0  # of the fall of the charge: a flight's power changes within minutes
_STEPS = 3  # falls of the remaining charge; it is told in whole percents, so two ends err by one of three


@dataclass(frozen=True)
class Battery:
    """The first battery that is told of; None is not told."""

    voltage_V: float | None = None
    current_A: float | None = None
    remaining: float | None = None  # 0..1
    word: str = ""  # ok, low, critical, emergency, failed, unhealthy, charging; "" while nothing is told
    minutes: float | None = None
    minutes_by: str = ""  # autopilot, battery_Wh or trend
    received_s: float | None = None


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


def battery_of(
    readings: Readings, *, energy_Wh: float | None = None, trend_min: float | None = None
) -> Battery:
    """Of the readings; `energy_Wh` is what a full pack holds, `trend_min` what `Drain` found.

    A monitor that is not fitted reads 0 V: no pack that flies does.
    """
    status = readings.get("SYS_STATUS")
    for arrival in (*readings.batches("BATTERY_STATUS").values(), *((status,) if status else ())):
        m = arrival.message
        cells = [m.voltage_battery] if arrival is status else m.voltages
        voltage = sum(v for v in cells if 0 < v < _NO_CELL) / 1e3
        if voltage <= 0.0:
            continue
        current = m.current_battery / 100 if m.current_battery >= 0 else None
        remaining = m.battery_remaining / 100 if m.battery_remaining >= 0 else None
        word = _worse(
            _WORDS.get(int(getattr(m, "charge_state", 0) or 0), ""), _judged(remaining, readings.parameters)
        )
        reported_s = float(getattr(m, "time_remaining", 0) or 0)
        minutes, by = _minutes(reported_s, voltage, current, remaining, energy_Wh, trend_min)
        return Battery(voltage, current, remaining, word, minutes, by, arrival.received_s)
    return Battery()


def _minutes(
    reported_s: float,
    voltage_V: float,
    current_A: float | None,
    remaining: float | None,
    energy_Wh: float | None,
    trend_min: float | None,
) -> tuple[float | None, str]:
    if reported_s > 0.0:
        return reported_s / 60.0, "autopilot"
    if energy_Wh is not None and remaining is not None and current_A:
        return 60.0 * energy_Wh * remaining / (voltage_V * current_A), "battery_Wh"
    return (trend_min, "trend") if trend_min is not None else (None, "")


def _worse(reported: str, judged: str) -> str:
    """A pack that charges, or has failed, is what it says; else the one further down."""
    if not reported or not judged or reported not in _DOWN:
        return reported or judged
    return max(reported, judged, key=_DOWN.index)


def _judged(remaining: float | None, parameters: Mapping[str, float]) -> str:
    if remaining is None:
        return ""
    for name, default, word in (*_THRESHOLDS, _LOW):
        threshold = parameters.get(name, default)
        if remaining <= (threshold if math.isfinite(threshold) else default):
            return word
    return "ok"
