"""What the stand-in tells: one function a message, from the autopilot's state and its last reading.

Every stamp is the plant's time, from 1 s after boot so that no stamp is zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as m

from firmware_params.px4.messages import MAVLink_esc_status_message
from sim.physics.escs import reported_escs
from sim.px4.autopilot import Autopilot, Mode
from sim.px4.cascade import euler

PRESENT = 1 | 2 | 4 | 8 | 32 | 1024 | 2048 | 4096 | 8192 | 16384 | 32768 | 0x200000 | 0x2000000
PREARM = 0x10000000
TYPES = {4: 2, 6: 13, 8: 14, 12: 29, 3: 15}
# integers as missions and commands, bytewise parameters, FTP, targets, MAVLink 2
CAPABILITIES = 4 | 8 | 16 | 32 | 64 | 128 | 8192
SET_ACTUATOR_TARGET = 1024
STM32H7 = 6  # PX4_SOC_ARCH_ID

# message id: rate in Hz of simulated time, before anyone asks otherwise
DEFAULT_HZ = {
    0: 1.0,
    1: 5.0,
    2: 1.0,
    24: 5.0,
    30: 50.0,
    31: 50.0,
    32: 30.0,
    33: 10.0,
    36: 10.0,
    42: 1.0,
    74: 4.0,
    83: 10.0,
    85: 10.0,
    105: 50.0,
    132: 10.0,
    141: 1.0,
    147: 2.0,
    230: 1.0,
    242: 0.5,
    245: 2.0,
    291: 10.0,
    375: 10.0,
}


def heartbeat(a: Autopilot) -> Any:
    """0."""
    flags = 1 | 16 | 8 | 4 | (128 if a.armed else 0)
    kind = TYPES.get(a.rotors, 2)
    return m.MAVLink_heartbeat_message(kind, 12, flags, int(a.mode), 4 if a.armed else 3, 3)


def high_latency2(a: Autopilot) -> Any:
    """235. The upper half of the heartbeat's mode; of the rest only where it points and its charge."""
    r, charge = a.reading, round(100 * a.plant.charge)
    lat, lon = (round(1e7 * degrees) for degrees in a.home.geodetic(*r.position[:2].tolist()))
    up, mode = round(a.home.alt - float(r.position[2])), int(a.mode) >> 16
    nothing = [0] * 13  # from the heading to the climb
    return m.MAVLink_high_latency2_message(
        stamp_ms(a), TYPES.get(a.rotors, 2), 12, mode, lat, lon, up, up, *nothing, charge, 0, 0, 0, 0, 0
    )


def sys_status(a: Autopilot) -> Any:
    """1. The prearm bit says whether it would arm."""
    bits = PRESENT | PREARM
    healthy = bits if a.mixer.mix is not None else PRESENT
    r = a.reading
    charge, volts = round(100 * a.plant.charge), round(1000 * r.voltage)
    return m.MAVLink_sys_status_message(
        bits, bits, healthy, 250, volts, short(100 * r.current), charge, 0, 0, 0, 0, 0, 0
    )


def system_time(a: Autopilot) -> Any:
    """2. No wall clock: a seeded flight must not depend on the day."""
    return m.MAVLink_system_time_message(0, stamp_ms(a))


def gps_raw(a: Autopilot) -> Any:
    """24."""
    lat, lon, alt = _geodetic(a)
    n, e, _ = a.reading.velocity.tolist()
    course = round(100 * math.degrees(math.atan2(e, n)) % 36000)
    speed = short(100 * math.hypot(n, e))
    return m.MAVLink_gps_raw_int_message(
        stamp_us(a), 3, lat, lon, alt, 70, 90, speed, course, 14, alt, 900, 1500, 200, 0, 0
    )


def attitude(a: Autopilot) -> Any:
    """30."""
    r = a.reading
    return m.MAVLink_attitude_message(stamp_ms(a), *euler(tuple(r.quaternion.tolist())), *r.rates.tolist())


def attitude_quaternion(a: Autopilot) -> Any:
    """31."""
    r = a.reading
    return m.MAVLink_attitude_quaternion_message(stamp_ms(a), *r.quaternion.tolist(), *r.rates.tolist())


def local_position(a: Autopilot) -> Any:
    """32."""
    r = a.reading
    return m.MAVLink_local_position_ned_message(stamp_ms(a), *r.position.tolist(), *r.velocity.tolist())


def global_position(a: Autopilot) -> Any:
    """33."""
    lat, lon, alt = _geodetic(a)
    r = a.reading
    heading = round(100 * math.degrees(euler(tuple(r.quaternion.tolist()))[2])) % 36000
    relative = round(-1000 * r.position[2])
    vn, ve, vd = (short(100 * v) for v in r.velocity.tolist())
    return m.MAVLink_global_position_int_message(stamp_ms(a), lat, lon, alt, relative, vn, ve, vd, heading)


def servo_output(a: Autopilot) -> Any:
    """36. Microseconds; 900 on a disarmed output."""
    us = [round(v) for v in a.outputs_us][:16]
    return m.MAVLink_servo_output_raw_message(stamp_us(a) & 0xFFFFFFFF, 0, *(us + [0] * (16 - len(us))))


def vfr_hud(a: Autopilot) -> Any:
    """74."""
    r = a.reading
    n, e, d = r.velocity.tolist()
    heading = round(math.degrees(euler(tuple(r.quaternion.tolist()))[2])) % 360
    speed, throttle = math.hypot(n, e), round(100 * a.demand.thrust)
    return m.MAVLink_vfr_hud_message(speed, speed, heading, throttle, a.home.alt - r.position[2], -d)


def attitude_target(a: Autopilot) -> Any:
    """83."""
    d = a.demand
    return m.MAVLink_attitude_target_message(stamp_ms(a), 0, d.attitude, *d.rates, d.thrust)


def position_target(a: Autopilot) -> Any:
    """85."""
    g = a.goal
    return m.MAVLink_position_target_local_ned_message(
        stamp_ms(a), 1, 0, *g.position, *g.velocity, *g.acceleration, g.yaw, g.yaw_rate
    )


def highres_imu(a: Autopilot) -> Any:
    """105."""
    r = a.reading
    w, x, y, z = r.quaternion.tolist()
    n, d = 0.21, 0.43  # gauss
    mag = (
        n * (1 - 2 * (y * y + z * z)) + d * 2 * (x * z - w * y),
        n * 2 * (x * y - w * z) + d * 2 * (y * z + w * x),
        n * 2 * (x * z + w * y) + d * (1 - 2 * (x * x + y * y)),
    )
    alt = a.home.alt - float(r.position[2])
    pressure = 1013.25 * max(1 - 2.25577e-5 * alt, 0.0) ** 5.25588
    return m.MAVLink_highres_imu_message(
        stamp_us(a), *r.accel.tolist(), *r.rates.tolist(), *mag, pressure, 0.0, alt, 25.0, 0x1FFF, 0
    )


def distance_sensor(a: Autopilot) -> Any:
    """132. Of the body origin above the ground, downwards."""
    cm = min(max(round(100 * a.reading.height), 0), 4000)
    return m.MAVLink_distance_sensor_message(
        stamp_ms(a), 5, 4000, cm, 0, 0, 25, 1, 0.03, 0.03, (0, 0, 0, 0), 100
    )


def coax_demand(a: Autopilot) -> Any:
    """350. Of coax_mixer where it runs; PX4 has the stream in any case."""
    return a.module.demand_message(a.plant.time_s, stamp_us(a)) if a.module is not None else []


def actuator_control_target(a: Autopilot) -> Any:
    """140. Roll, pitch, yaw and thrust before the mixer; only on request."""
    d = a.demand
    return m.MAVLink_actuator_control_target_message(
        stamp_us(a), 0, (d.roll, d.pitch, d.yaw, d.thrust, 0.0, 0.0, 0.0, 0.0)
    )


def altitude(a: Autopilot) -> Any:
    """141."""
    up = -float(a.reading.position[2])
    return m.MAVLink_altitude_message(
        stamp_us(a), a.home.alt + up, a.home.alt + up, up, up, a.home.alt, a.reading.height
    )


def battery_status(a: Autopilot) -> Any:
    """147. A voltage a cell, in mV."""
    b, r = a.plant.battery, a.reading
    cell = round(1000 * r.voltage / b.cells)
    cells = [cell if k < b.cells else 0xFFFF for k in range(10)]
    used = round((0.95 - a.plant.charge) * b.capacity_Ah * 1000)
    charge = round(100 * a.plant.charge)
    return m.MAVLink_battery_status_message(
        0, 0, 1, 0x7FFF, cells, short(100 * r.current), max(used, 0), -1, charge, 0, 1
    )


def estimator_status(a: Autopilot) -> Any:
    """230. Attitude, velocity and position are known."""
    return m.MAVLink_estimator_status_message(stamp_us(a), 0x33F, 0.1, 0.1, 0.1, 0.1, 0.1, 0.0, 0.3, 0.4)


def home_position(a: Autopilot) -> Any:
    """242."""
    nan = math.nan
    h = a.home
    lat, lon, alt = round(1e7 * h.lat), round(1e7 * h.lon), round(1e3 * h.alt)
    return m.MAVLink_home_position_message(
        lat, lon, alt, 0.0, 0.0, 0.0, (1.0, 0.0, 0.0, 0.0), nan, nan, nan, stamp_us(a)
    )


def extended_sys_state(a: Autopilot) -> Any:
    """245."""
    state = 1 if a.landed else {Mode.TAKEOFF: 3, Mode.LAND: 4}.get(a.mode, 2)
    return m.MAVLink_extended_sys_state_message(0, state)


def mission_current(a: Autopilot) -> Any:
    """42: there is no mission."""
    return m.MAVLink_mission_current_message(0, 0xFFFF, 1, 0)


def esc_status(a: Autopilot) -> list[Any]:
    """291, four ESCs a message."""
    escs = reported_escs(a)
    if escs is None:
        return []
    more = -len(escs.rpm) % 4
    rpm = [round(v) for v in escs.rpm] + [0] * more
    volts, amps = escs.volts + [0.0] * more, escs.amps + [0.0] * more
    if a.version[:2] == (1, 14):  # it repeats the first four in the second batch
        rpm[4:8] = rpm[:4]
    return [
        MAVLink_esc_status_message(k, stamp_us(a), rpm[k : k + 4], volts[k : k + 4], amps[k : k + 4])
        for k in range(0, len(rpm), 4)
    ]


def actuator_output(a: Autopilot) -> Any:
    """375. Microseconds."""
    us = a.outputs_us
    return m.MAVLink_actuator_output_status_message(stamp_us(a), len(us), us + [0.0] * (32 - len(us)))


def autopilot_version(a: Autopilot) -> Any:
    """148."""
    major, minor, patch = a.version
    number = major << 24 | minor << 16 | patch << 8 | 255
    bits = CAPABILITIES | (SET_ACTUATOR_TARGET if a.takes_live else 0)
    none = [0] * 8
    # as PX4's stm32_common/version/board_identity.c makes them of the processor's three words
    high, middle = a.uid >> 64, a.uid >> 32 & 0xFFFFFFFF
    long_uid = [0x00, STM32H7, 0, 0, 0, 0, *a.uid.to_bytes(12, "big")] if a.uid else [0] * 18
    return m.MAVLink_autopilot_version_message(
        bits, number, number, 0, 0, none, none, none, 0, 0, middle << 32 | high, long_uid
    )


BUILDERS: dict[int, Callable[[Autopilot], Any]] = {
    0: heartbeat,
    1: sys_status,
    2: system_time,
    24: gps_raw,
    30: attitude,
    31: attitude_quaternion,
    32: local_position,
    33: global_position,
    36: servo_output,
    74: vfr_hud,
    83: attitude_target,
    85: position_target,
    105: highres_imu,
    132: distance_sensor,
    140: actuator_control_target,
    350: coax_demand,
    141: altitude,
    147: battery_status,
    148: autopilot_version,
    230: estimator_status,
    235: high_latency2,
    42: mission_current,
    242: home_position,
    245: extended_sys_state,
    291: esc_status,
    375: actuator_output,
}


def stamp_us(a: Autopilot) -> int:
    """Time of the reading, us since boot."""
    return round(1e6 * (a.reading.time_s - a.booted_s)) + 1_000_000


def stamp_ms(a: Autopilot) -> int:
    """Time of the reading, ms since boot."""
    return stamp_us(a) // 1000


def short(value: float) -> int:
    """As a 16 bit field takes it; what is beyond stays at its end."""
    return min(max(round(value), -32767), 32767)


def _geodetic(a: Autopilot) -> tuple[int, int, int]:
    n, e, d = a.reading.position.tolist()
    lat, lon = a.home.geodetic(n, e)
    return round(1e7 * lat), round(1e7 * lon), round(1e3 * (a.home.alt - d))
