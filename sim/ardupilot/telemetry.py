"""What the stand-in ArduCopter tells: the world's common messages, and those that are ArduPilot's own."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as m

from sim.physics.escs import reported_escs
from sim.px4 import telemetry as common
from sim.px4.telemetry import short, stamp_ms, stamp_us

VERSION = 4 << 24 | 8 << 16  # 4.8.0-dev
ESC_MESSAGES = (
    m.MAVLink_esc_telemetry_1_to_4_message,
    m.MAVLink_esc_telemetry_5_to_8_message,
    m.MAVLink_esc_telemetry_9_to_12_message,
)
# integers as missions and commands, floats as parameters, FTP, targets, MAVLink 2
CAPABILITIES = 2 | 4 | 8 | 32 | 64 | 128 | 256 | 8192


def heartbeat(a: Any) -> Any:
    """0."""
    flags = 1 | 16 | 64 | (128 if a.armed else 0) | (8 if a.ap_mode == 4 else 0)
    kind = common.TYPES.get(a.rotors, 2)
    return m.MAVLink_heartbeat_message(kind, 3, flags, a.ap_mode, 4 if a.armed and not a.landed else 3, 3)


def sys_status(a: Any) -> Any:
    """1."""
    bits = common.PRESENT | common.PREARM
    healthy = common.PRESENT if a.prearm() else bits
    volts, amps, charge = 0, -1, -1
    if _has_battery(a):
        volts, amps = round(1000 * a.reading.voltage), short(100 * a.reading.current)
        charge = round(100 * a.plant.charge)
    return m.MAVLink_sys_status_message(bits, bits, healthy, 250, volts, amps, charge, 0, 0, 0, 0, 0, 0)


def _has_battery(a: Any) -> bool:
    return bool(a.store["BATT_MONITOR"] > 0)


def battery_status(a: Any) -> list[Any]:
    """147. The whole pack in the first cell, as a monitor that knows no cells has it; none without one."""
    if not _has_battery(a):
        return []
    r, b = a.reading, a.plant.battery
    cells = [round(1000 * r.voltage), *[0xFFFF] * 9]
    used = max(round((0.95 - a.plant.charge) * b.capacity_Ah * 1000), 0)
    charge = round(100 * a.plant.charge)
    amps = short(100 * r.current)
    return [m.MAVLink_battery_status_message(0, 0, 0, 0x7FFF, cells, amps, used, -1, charge, 0, 1)]


def _imu(a: Any) -> list[int]:
    """mg and mrad/s, cut towards zero: they are cast to integers."""
    r = a.reading
    values = [v / 9.80665 * 1000 for v in r.accel.tolist()] + [1000 * v for v in r.rates.tolist()]
    return [short(math.trunc(v)) for v in values]


def scaled_imu(a: Any) -> Any:
    """26."""
    return m.MAVLink_scaled_imu_message(stamp_ms(a), *_imu(a), 210, 0, 430, 3500)


def raw_imu(a: Any) -> Any:
    """27."""
    return m.MAVLink_raw_imu_message(stamp_us(a), *_imu(a), 210, 0, 430, 0, 3500)


def autopilot_version(a: Any) -> Any:
    """148."""
    # the processor's 12 bytes as they are (AP_HAL_ChibiOS/Util.cpp)
    none, long_uid = [0] * 8, [*a.uid.to_bytes(12, "big"), *[0] * 6]
    return m.MAVLink_autopilot_version_message(
        CAPABILITIES, VERSION, 0, 0, 0, none, none, none, 0x1209, 0x5740, 0, long_uid
    )


def ekf_status(a: Any) -> Any:
    """193. Attitude, speeds and positions are known."""
    return m.MAVLink_ekf_status_report_message(0x1F | 0x300, 0.05, 0.04, 0.03, 0.02, 0.0)


def rangefinder(a: Any) -> Any:
    """173."""
    return m.MAVLink_rangefinder_message(a.reading.height, a.reading.height)


def esc_telemetry(a: Any) -> list[Any]:
    """11030 and those after it, four ESCs each: they come together, for a request of the first."""
    escs = reported_escs(a)
    if escs is None:
        return []
    out = []
    for first, message in zip(range(0, len(escs.rpm), 4), ESC_MESSAGES, strict=False):
        columns = [(v + [0.0] * 4)[first : first + 4] for v in (escs.volts, escs.amps, escs.rpm)]
        volts, amps, rpm = ([round(k * v) for v in c] for k, c in zip((100, 100, 1), columns, strict=True))
        there = [1 if first + k < len(escs.rpm) else 0 for k in range(4)]
        count = [(stamp_ms(a) & 0xFFFF) * t for t in there]
        out.append(message([30 * t for t in there], volts, [max(v, 0) for v in amps], [0] * 4, rpm, count))
    return out


def attitude_target(a: Any) -> Any:
    """83. Rates and thrust of the loops; the attitude is the one asked for."""
    d = a.demand
    rates = tuple(0.0 if math.isnan(v) else v for v in d.rates)
    return m.MAVLink_attitude_target_message(stamp_ms(a), 0, d.attitude, *rates, d.thrust)


BUILDERS: dict[int, Callable[[Any], Any]] = {
    **{k: v for k, v in common.BUILDERS.items() if k not in (140, 291, 375)},
    0: heartbeat,
    1: sys_status,
    26: scaled_imu,
    27: raw_imu,
    83: attitude_target,
    147: battery_status,
    148: autopilot_version,
    173: rangefinder,
    193: ekf_status,
    11030: esc_telemetry,
}
DEFAULT_HZ = {0: 1.0}  # nothing else goes out until someone asks

# REQUEST_DATA_STREAM: stream number to messages
GROUPS = {
    1: (27,),
    2: (1, 24, 42, 242, 245),
    3: (36,),
    4: (83,),
    6: (32, 33),
    10: (30, 31, 11030),
    11: (74,),
    12: (2, 132, 147, 173, 193),
}
