"""What the stand-in ArduCopter tells: the world's common messages, and those that are ArduPilot's own."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as m

from sim.px4 import telemetry as common
from sim.px4.telemetry import short, stamp_ms, stamp_us

VERSION = 4 << 24 | 8 << 16  # 4.8.0-dev
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
    r = a.reading
    charge, volts = round(100 * a.plant.charge), round(1000 * r.voltage)
    return m.MAVLink_sys_status_message(
        bits, bits, healthy, 250, volts, short(100 * r.current), charge, 0, 0, 0, 0, 0, 0
    )


def raw_imu(a: Any) -> Any:
    """27. mg and mrad/s."""
    r = a.reading
    accel = [short(v / 9.80665 * 1000) for v in r.accel.tolist()]
    gyro = [short(1000 * v) for v in r.rates.tolist()]
    return m.MAVLink_raw_imu_message(stamp_us(a), *accel, *gyro, 210, 0, 430, 0, 3500)


def distance_sensor(a: Any) -> Any:
    """132."""
    return common.distance_sensor(a)


def autopilot_version(a: Any) -> Any:
    """148."""
    none, long_uid = [0] * 8, [0x40 + (a.uid & 0xFF), *[0] * 17]
    return m.MAVLink_autopilot_version_message(
        CAPABILITIES, VERSION, 0, 0, 0, none, none, none, 0x1209, 0x5740, 0, long_uid
    )


def ekf_status(a: Any) -> Any:
    """193. Attitude, speeds and positions are known."""
    return m.MAVLink_ekf_status_report_message(0x1F | 0x300, 0.05, 0.04, 0.03, 0.02, 0.0)


def rangefinder(a: Any) -> Any:
    """173."""
    return m.MAVLink_rangefinder_message(a.reading.height, a.reading.height)


def _esc(a: Any, first: int, message: Callable[..., Any]) -> Any:
    r = a.reading
    rpm = [round(a.plant.pair.speed_max_rpm * u) for u in r.speeds.tolist()][first : first + 4]
    rpm += [0] * (4 - len(rpm))
    share = max(short(100 * r.current / a.rotors), 0)
    volts = round(100 * r.voltage)
    count = stamp_ms(a) & 0xFFFF
    return message([30] * 4, [volts] * 4, [share] * 4, [0] * 4, rpm, [count] * 4)


def esc_telemetry_1(a: Any) -> Any:
    """11030."""
    return _esc(a, 0, m.MAVLink_esc_telemetry_1_to_4_message)


def esc_telemetry_5(a: Any) -> Any:
    """11031."""
    return _esc(a, 4, m.MAVLink_esc_telemetry_5_to_8_message)


def home_position(a: Any) -> Any:
    """242."""
    return common.home_position(a)


def servo_output(a: Any) -> Any:
    """36."""
    us = [round(v) for v in a.outputs_us][:16]
    time_us = stamp_us(a) & 0xFFFFFFFF
    return m.MAVLink_servo_output_raw_message(time_us, 0, *(us + [0] * (16 - len(us))))


def attitude_target(a: Any) -> Any:
    """83. Rates and thrust of the loops; the attitude is the one asked for."""
    d = a.demand
    rates = tuple(0.0 if math.isnan(v) else v for v in d.rates)
    return m.MAVLink_attitude_target_message(stamp_ms(a), 0, d.attitude, *rates, d.thrust)


BUILDERS: dict[int, Callable[[Any], Any]] = {
    **{k: v for k, v in common.BUILDERS.items() if k not in (140, 375)},
    0: heartbeat,
    1: sys_status,
    27: raw_imu,
    36: servo_output,
    83: attitude_target,
    148: autopilot_version,
    173: rangefinder,
    193: ekf_status,
    11030: esc_telemetry_1,
    11031: esc_telemetry_5,
}
DEFAULT_HZ = {0: 1.0}  # nothing else goes out until someone asks

# REQUEST_DATA_STREAM: stream number to messages
GROUPS = {
    1: (27,),
    2: (1, 24, 42, 242, 245),
    3: (36,),
    4: (83,),
    6: (32, 33),
    10: (30, 31),
    11: (74,),
    12: (2, 132, 147, 173, 193, 11030, 11031),
}
