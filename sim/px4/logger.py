"""PX4's flight log: ULog on the card, from arming to disarming, topics and rates as PX4's own.

Format: PX4's description of ULog, version 1. `SDLOG_MODE` 0 logs while armed, 1 also from boot to the first
disarming, 2 always, 4 from the first arming on, -1 never; 3 goes by a switch of the pilot's, who has none.
`SDLOG_PROFILE` is a mask (0: the default set): bit 0 the default set, 3 system identification, 4 high rate; a
later bit's rate holds. What the other bits add is not here. PX4 reads both once, when it boots.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from firmware_params.px4.parameters import INT32
from sim.line.logger import Logger
from sim.physics.escs import EscReport, reported_escs
from sim.px4.autopilot import Mode

FOLDER = "log/sess{:03d}"
DEFAULT, SYSTEM_IDENTIFICATION, HIGH_RATE = 1 << 0, 1 << 3, 1 << 4  # SDLogProfileMask
ALL_HZ = 250.0  # a topic without an interval: every step of this world
NAV_STATES = {Mode.MISSION: 3, Mode.HOLD: 4, Mode.RTL: 5, Mode.OFFBOARD: 14, Mode.TAKEOFF: 17, Mode.LAND: 18}
ESC = (
    "uint64_t timestamp;int32_t esc_rpm;float esc_voltage;float esc_current;"
    "uint8_t esc_state;uint8_t[3] _padding0"
)
SIZES = {
    "uint64_t": "Q",
    "int32_t": "i",
    "uint32_t": "I",
    "uint16_t": "H",
    "uint8_t": "B",
    "bool": "B",
    "float": "f",
}


@dataclass(frozen=True)
class Topic:
    """One kind of row: fields as ULog writes them, Hz in the default set and where a profile has it too."""

    fields: str
    row: Callable[[Any, int], tuple[Any, ...]]
    hz: float
    identification_hz: float = 0.0
    high_hz: float = 0.0

    def rate(self, profile: int) -> float:
        """Hz by SDLOG_PROFILE, 0 when it is not logged."""
        rates = (
            (DEFAULT, self.hz),
            (SYSTEM_IDENTIFICATION, self.identification_hz),
            (HIGH_RATE, self.high_hz),
        )
        found = [hz for bit, hz in rates if hz and (profile or DEFAULT) & bit]
        return found[-1] if found else 0.0

    @property
    def layout(self) -> struct.Struct:
        """Of a row, the stamp first."""
        form = "<"
        for item in self.fields.split(";"):
            kind, _, _ = item.partition(" ")
            name, _, count = kind.rstrip("]").partition("[")
            form += (count or "1") + SIZES[name] if name != "esc_report" else "QiffB3x" * int(count)
        return struct.Struct(form)


STAMPS = "uint64_t timestamp;uint64_t timestamp_sample;"


def _motors(a: Any, now: int) -> tuple[Any, ...]:
    """Commands before the thrust curve, in the order of motors."""
    u = np.zeros(12)
    command = np.asarray(a.command if a.armed else np.zeros(a.rotors))
    for output, motor in enumerate(a._wiring()):
        if motor < a.rotors:
            u[motor] = command[output]
    factor = float(a.store["THR_MDL_FAC"])
    control = factor * u * u + (1.0 - factor) * u
    control[a.rotors :] = np.nan
    return now, now, 0, *control.tolist()


def _outputs(a: Any, now: int) -> tuple[Any, ...]:
    us = a.outputs_us[:16]
    return now, len(us), *us, *[0.0] * (16 - len(us))


def _local(a: Any, now: int) -> tuple[Any, ...]:
    r = a.reading
    speeds = r.velocity.tolist()
    return now, now, *r.position.tolist(), *speeds, r.height, 1, 1, 1, 1, 1


def _battery(a: Any, now: int) -> tuple[Any, ...]:
    r, b = a.reading, a.plant.battery
    used = max((0.95 - a.plant.charge) * b.capacity_Ah * 1000.0, 0.0)
    return now, r.voltage, r.current, used, a.plant.charge, b.cells, 1


def _escs(a: Any, now: int) -> tuple[Any, ...]:
    escs = reported_escs(a) or EscReport([], [], [])
    rows: list[Any] = []
    count = min(len(escs.rpm), 8)
    for k in range(8):
        there = (round(escs.rpm[k]), escs.volts[k], escs.amps[k]) if k < count else (0, 0.0, 0.0)
        rows += [now, *there, 0]
    return now, count, (1 << count) - 1, *rows


TOPICS: dict[str, Topic] = {
    "sensor_combined": Topic(
        "uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;"
        "int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;"
        "uint32_t accelerometer_integral_dt",
        lambda a, t: (t, *a.reading.rates.tolist(), 4000, 0, *a.reading.accel.tolist(), 4000),
        ALL_HZ,
        ALL_HZ,
        ALL_HZ,
    ),
    "vehicle_acceleration": Topic(
        STAMPS + "float[3] xyz", lambda a, t: (t, t, *a.reading.accel.tolist()), 20.0, ALL_HZ
    ),
    "vehicle_angular_velocity": Topic(
        STAMPS + "float[3] xyz", lambda a, t: (t, t, *a.reading.rates.tolist()), 50.0, ALL_HZ, ALL_HZ
    ),
    "vehicle_attitude": Topic(
        STAMPS + "float[4] q", lambda a, t: (t, t, *a.reading.quaternion.tolist()), 20.0, high_hz=ALL_HZ
    ),
    "vehicle_local_position": Topic(
        STAMPS + "float x;float y;float z;float vx;float vy;float vz;float dist_bottom;"
        "bool xy_valid;bool z_valid;bool v_xy_valid;bool v_z_valid;bool dist_bottom_valid",
        _local,
        10.0,
    ),
    "actuator_motors": Topic(
        STAMPS + "uint16_t reversible_flags;float[12] control", _motors, 10.0, ALL_HZ, ALL_HZ
    ),
    "actuator_outputs": Topic("uint64_t timestamp;uint32_t noutputs;float[16] output", _outputs, 10.0),
    "vehicle_thrust_setpoint": Topic(
        STAMPS + "float[3] xyz", lambda a, t: (t, t, 0.0, 0.0, -a.demand.thrust), 50.0, high_hz=ALL_HZ
    ),
    "vehicle_torque_setpoint": Topic(
        STAMPS + "float[3] xyz",
        lambda a, t: (t, t, a.demand.roll, a.demand.pitch, a.demand.yaw),
        50.0,
        ALL_HZ,
        ALL_HZ,
    ),
    "battery_status": Topic(
        "uint64_t timestamp;float voltage_v;float current_a;float discharged_mah;float remaining;"
        "uint8_t cell_count;bool connected",
        _battery,
        5.0,
    ),
    "esc_status": Topic(
        "uint64_t timestamp;uint8_t esc_count;uint8_t esc_online_flags;esc_report[8] esc",
        _escs,
        4.0,
        high_hz=200.0,
    ),
    "vehicle_status": Topic(
        "uint64_t timestamp;uint8_t arming_state;uint8_t nav_state",
        lambda a, t: (t, 2 if a.armed else 1, NAV_STATES.get(a.mode, 4)),
        2.0,
    ),
    "vehicle_land_detected": Topic("uint64_t timestamp;bool landed", lambda a, t: (t, int(a.landed)), 2.0),
}
EVENTS = {  # written at once when these change
    "vehicle_status": lambda a: (a.armed, a.mode),
    "vehicle_land_detected": lambda a: a.landed,
}


def framed(kind: str, body: bytes) -> bytes:
    """One ULog message."""
    return struct.pack("<HB", len(body), ord(kind)) + body


def keyed(kind: str, key: str, value: bytes) -> bytes:
    """An information or parameter message."""
    return framed(kind, bytes([len(key)]) + key.encode() + value)


class UlogLogger(Logger):
    """Writes `log/sessNNN/logNNN.ulg`: without a clock PX4 counts boots and logs."""

    suffix = ".ulg"

    def __init__(self, autopilot: Any) -> None:
        self._layouts = {name: topic.layout for name, topic in TOPICS.items()}
        self._session = self._number = 0
        self._flown = False
        self._read_settings(autopilot)
        self._states: dict[str, Any] = {}
        self._now = 0
        super().__init__(autopilot)
        autopilot.files.folders.add("log")

    def booted(self) -> None:
        """After a reboot the count of logs starts anew, in a folder of its own."""
        self.close()
        self._number, self._flown = 0, False
        self._read_settings(self.autopilot)

    def _read_settings(self, autopilot: Any) -> None:
        """Mode and profile, which count from a boot on."""
        self._mode, profile = int(autopilot.store["SDLOG_MODE"]), int(autopilot.store["SDLOG_PROFILE"])
        rates = [
            (number, name, topic, topic.rate(profile)) for number, (name, topic) in enumerate(TOPICS.items())
        ]
        self._logged = [(*topic, EVENTS.get(topic[1])) for topic in rates if topic[3]]

    def wanted(self) -> bool:
        a, mode = self.autopilot, self._mode
        self._flown = self._flown or a.armed
        if mode in (-1, 3):
            return False
        return a.armed or mode == 2 or (mode == 1 and not self._flown) or (mode == 4 and self._flown)

    def path(self) -> str:
        folders = self.autopilot.files.folders
        if not self._number:
            self._session = 1
            while FOLDER.format(self._session) in folders:
                self._session += 1
        self._number += 1
        folder = FOLDER.format(self._session)
        folders.add(folder)
        return f"{folder}/log{self._number:03d}.ulg"

    def listed(self) -> list[str]:
        """As the file system lists its folders (mavlink_log_handler.cpp: readdir), which is by no age."""
        return sorted(self.logs(), key=lambda path: zlib.crc32(path.encode()))

    def begin(self) -> bytes:
        a = self.autopilot
        self._states.clear()
        out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", self._now)
        out += framed("B", bytes(40))
        major, minor, patch = a.version
        release = major << 24 | minor << 16 | patch << 8 | 255
        for key, text in (("sys_name", "PX4"), ("ver_hw", "STAND_IN")):
            out += keyed("I", f"char[{len(text)}] {key}", text.encode())
        out += keyed("I", "uint32_t ver_sw_release", struct.pack("<I", release))
        out += framed("F", f"esc_report:{ESC};".encode())
        for name, topic in TOPICS.items():
            out += framed("F", f"{name}:{topic.fields};".encode())
        out += self.parameters(a.store.names)
        for number, name in enumerate(TOPICS):
            out += framed("A", struct.pack("<BH", 0, number) + name.encode())
        return out

    def parameters(self, names: list[str]) -> bytes:
        store, out = self.autopilot.store, b""
        for name in names:
            integer = store.type(name) == INT32
            value = struct.pack("<i", int(store[name])) if integer else struct.pack("<f", store[name])
            out += keyed("P", f"{'int32_t' if integer else 'float'} {name}", value)
        return out

    def record(self, now_us: int) -> None:
        self._now = now_us
        super().record(now_us)

    def rows(self, now_us: int) -> bytes:
        a, out = self.autopilot, b""
        for number, name, topic, hz, event in self._logged:
            fresh = False
            if event is not None:
                state = event(a)
                fresh = self._states.get(name) != state
                self._states[name] = state
            if self.due(name, now_us, hz) or fresh:
                out += framed(
                    "D", struct.pack("<H", number) + self._layouts[name].pack(*topic.row(a, now_us))
                )
        return out

    def text(self, severity: int, text: str) -> bytes:
        return framed("L", struct.pack("<BQ", ord("0") + severity, self._now) + text.encode())
