"""tlog: MAVLink frames, each after eight bytes of the recorder's clock. Times are the messages' own.

The recorder's clock only orders the frames: a simulator may run faster than the wall, and links add delay.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from coaxlink import files
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.data.logs.outputs import commands, used_outputs
from coaxlink.data.logs.streams import Message, TimeSeries, derived, euler_of, longest, merge, rows_of, series
from coaxlink.data.samples import Samples
from coaxlink.errors import InputError
from firmware_params import bounded

EPOCH_US = 1e15  # a stamp above this counts from 1970, one below from boot
ESC_TELEMETRY = ("ESC_TELEMETRY_1_TO_4", "ESC_TELEMETRY_5_TO_8", "ESC_TELEMETRY_9_TO_12")
NAMES = (
    "HEARTBEAT", "HIGHRES_IMU", "SCALED_IMU", "RAW_IMU", "ATTITUDE", "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED", "ACTUATOR_OUTPUT_STATUS", "SERVO_OUTPUT_RAW", "BATTERY_STATUS", "ESC_STATUS",
    *ESC_TELEMETRY, "DISTANCE_SENSOR", "EXTENDED_SYS_STATE",
)  # fmt: skip
WRAP_S = 2**32 / 1e6  # 32 bits of microseconds come round every 71 minutes
REBOOT_S = 5.0  # a clock that goes back by more than this was restarted
ARMED_FLAG, ARDUPILOT = 128, 3
ON_GROUND = 1
DOWNWARD = 25  # MAV_SENSOR_ROTATION_PITCH_270
NO_CELL_MV = 65535


def stamped_frames(path: Path) -> Iterator[tuple[int, bytes]]:
    """(recorder's clock in us since 1970, frame) of a tlog in order; a torn last frame is left out, damage is
    skipped. Raises InputError when there is more damage than log."""
    data = files.read_bytes(path, bounded.LOG)
    at = skipped = 0
    while at + 16 < len(data):
        size = _frame_size(data, at + 8)
        # a frame is believed when another, or the end, follows it: its first byte alone says little
        if size and (at + 8 + size + 9 > len(data) or _frame_size(data, at + 8 + size + 8)):
            if at + 8 + size <= len(data):
                yield int.from_bytes(data[at : at + 8], "big"), data[at + 8 : at + 8 + size]
            at += 8 + size
            continue
        if not skipped:
            first = at + 8
        at, skipped = at + 1, skipped + 1
        if 2 * skipped > len(data):
            raise InputError(path, f"byte {first}", "a MAVLink frame is expected after each time stamp")


def _frame_size(data: bytes, at: int) -> int:
    """Bytes of the frame that starts here, 0 if none does."""
    if data[at] == 0xFD and at + 3 <= len(data):
        return 12 + data[at + 1] + (13 if data[at + 2] & 1 else 0)
    return 8 + data[at + 1] if data[at] == 0xFE and at + 2 <= len(data) else 0


def read_tlog(path: Path) -> Samples:
    """A recorded link as flight columns. Raises InputError."""
    messages, garbled = _messages(path)
    shown = ", ".join(f"{name} {len(messages[name]['time_s'])}" for name in NAMES if name in messages)
    notes = [f"tlog: {shown}"]
    if garbled:
        notes.append(f"{garbled} frames left out: garbled on their way")
    motors = _motors(messages, notes)
    measured = [
        _imu(messages),
        _attitude(messages),
        series(messages.get("LOCAL_POSITION_NED"), {"vel_n_m_s": "vx", "vel_e_m_s": "vy", "vel_d_m_s": "vz"}),
        _height(messages, notes),
        _voltage(messages.get("BATTERY_STATUS")),
        derived(messages.get("HEARTBEAT"), lambda m: {"armed": m["base_mode"].astype(int) & ARMED_FLAG > 0}),
        derived(messages.get("EXTENDED_SYS_STATE"), lambda m: {"landed": m["landed_state"] == ON_GROUND}),
        *_rpm(messages, notes),
    ]
    return merge(str(path), motors, measured, notes)


def _messages(path: Path) -> tuple[dict[str, Message], int]:
    """Messages by name, of the autopilot that sends the most, in s since boot; and how many were lost."""
    from pymavlink.dialects.v20 import common

    from firmware_params.ardupilot import messages as _esc_telemetry  # noqa: F401  registers it
    from firmware_params.px4 import messages as _esc_status  # noqa: F401  registers ESC_STATUS

    parser = common.MAVLink(None)
    wanted = {i for i, cls in common.mavlink_map.items() if cls.msgname in NAMES}
    by_sender: dict[tuple[int, int], list[Any]] = defaultdict(list)
    garbled = 0
    for _, frame in stamped_frames(path):
        number = int.from_bytes(frame[7:10], "little") if frame[0] == 0xFD else frame[5]
        if number not in wanted:
            continue
        try:
            message = parser.decode(bytearray(frame))
        except common.MAVError:
            garbled += 1  # on its way: its CRC says so
            continue
        by_sender[(message.get_srcSystem(), message.get_srcComponent())].append(message)
    if not by_sender:
        raise InputError(path, "", "no telemetry of an autopilot in this tlog")
    motion = Counter({who: sum(m.get_type() != "HEARTBEAT" for m in sent) for who, sent in by_sender.items()})
    sent = _longest_boot(by_sender[motion.most_common(1)[0][0]])
    return {name: _message(rows) for name, rows in _stamped(sent).items()}, garbled


def _message(rows: list[tuple[float, Any]]) -> Message:
    """All messages of one kind as columns."""
    fields = rows[0][1].get_fieldnames()
    columns = {field: np.array([getattr(m, field) for _, m in rows], float) for field in fields}
    return columns | {"time_s": np.array([time for time, _ in rows])}


def _longest_boot(messages: list[Any]) -> list[Any]:
    """The messages of the boot that says the most: after a restart the stamps begin anew."""
    boots: list[list[Any]] = [[]]
    clock = 0.0
    for message in messages:
        stamp = getattr(message, "time_boot_ms", None)
        if stamp is not None:
            if stamp / 1e3 < clock - REBOOT_S:
                boots.append([])
            clock = stamp / 1e3
        boots[-1].append(message)
    return max(boots, key=len)


def _stamped(messages: list[Any]) -> dict[str, list[tuple[float, Any]]]:
    """(s since boot, message) by name."""
    rows: dict[str, list[tuple[float, Any]]] = defaultdict(list)
    clock = 0.0  # the latest stamp since boot: what messages without one get
    since_1970: dict[str, list[tuple[float, Any, float]]] = defaultdict(list)
    for message in messages:
        name = message.get_type()
        if hasattr(message, "time_boot_ms"):
            clock = message.time_boot_ms / 1e3
        elif name == "SERVO_OUTPUT_RAW":
            clock = message.time_usec / 1e6 + WRAP_S * round((clock - message.time_usec / 1e6) / WRAP_S)
        elif getattr(message, "time_usec", 0) > EPOCH_US:
            since_1970[name].append((message.time_usec / 1e6, message, clock))
            continue
        elif getattr(message, "time_usec", 0):
            clock = message.time_usec / 1e6
        rows[name].append((clock, message))
    for name, found in since_1970.items():
        offset = float(np.median([stamp - boot for stamp, _, boot in found if boot > 0] or [found[0][0]]))
        rows[name] += [(stamp - offset, message) for stamp, message, _ in found]
    return rows


def _motors(messages: Mapping[str, Message], notes: list[str]) -> TimeSeries | None:
    status, servo = messages.get("ACTUATOR_OUTPUT_STATUS"), messages.get("SERVO_OUTPUT_RAW")
    outputs = longest(status, servo)
    if outputs is None:
        return None
    if outputs is servo:
        servo = rows_of(servo, servo["port"] == 0)
        outputs, name = servo, "SERVO_OUTPUT_RAW"
        pulses = {} if servo is None else {n: servo[f"servo{n}_raw"] for n in range(1, 17)}
    else:
        name = "ACTUATOR_OUTPUT_STATUS"
        pulses = dict(enumerate(outputs["actuator"].T, 1))
    used = used_outputs(pulses)
    if outputs is None or not used:
        return None
    count = used[-1]
    notes.append(f"motor1..{count} = (PWM - 1000) / 1000, 0..1, from {name}")
    return TimeSeries.of(outputs["time_s"], commands({n: n for n in range(1, count + 1)}, pulses))


def _imu(messages: Mapping[str, Message]) -> TimeSeries | None:
    accel, gyro = ({ours.format(a): f"{a}{theirs}" for a in "xyz"} for ours, theirs in IMU_FIELDS)
    if "HIGHRES_IMU" in messages:
        return series(messages["HIGHRES_IMU"], accel | gyro)
    # ArduPilot's RAW_IMU is in mg and mrad/s as SCALED_IMU is; others send what their chip reads
    ardupilot = "HEARTBEAT" in messages and (messages["HEARTBEAT"]["autopilot"] == ARDUPILOT).any()
    imu = longest(messages.get("SCALED_IMU"), messages.get("RAW_IMU") if ardupilot else None)
    if imu is None:
        return None
    columns = {ours: imu[theirs] * (GRAVITY_M_S2 / 1e3) for ours, theirs in accel.items()}
    columns |= {ours: imu[theirs] * 1e-3 for ours, theirs in gyro.items()}
    return TimeSeries.of(imu["time_s"], columns)


IMU_FIELDS = (("accel_{}_m_s2", "acc"), ("gyro_{}_rad_s", "gyro"))


def _attitude(messages: Mapping[str, Message]) -> TimeSeries | None:
    quaternion = messages.get("ATTITUDE_QUATERNION")
    found = longest(messages.get("ATTITUDE"), quaternion)
    if found is quaternion:
        return derived(found, lambda m: euler_of([m[f"q{i}"] for i in range(1, 5)]))
    return series(found, {"roll_rad": "roll", "pitch_rad": "pitch", "yaw_rad": "yaw"})


def _height(messages: Mapping[str, Message], notes: list[str]) -> TimeSeries | None:
    ranger = messages.get("DISTANCE_SENSOR")
    down = None if ranger is None else rows_of(ranger, ranger["orientation"] == DOWNWARD)
    if down is not None:
        return derived(down, lambda m: {"height_m": m["current_distance"] / 100})
    if "LOCAL_POSITION_NED" in messages:
        notes.append("height_m from the estimator's z above its origin: no DISTANCE_SENSOR")
    return series(messages.get("LOCAL_POSITION_NED"), {"height_m": "z"}, -1.0)


def _voltage(battery: Message | None) -> TimeSeries | None:
    """V of the whole pack: the cells that are filled in, or the one total that some autopilots send."""
    if battery is None:
        return None
    cells = battery["voltages"]
    filled = (cells > 0) & (cells < NO_CELL_MV)
    pack = {"time_s": battery["time_s"], "pack": np.where(filled, cells, 0.0).sum(axis=1) / 1e3}
    return series(rows_of(pack, (battery["id"] == 0) & filled[:, 0]), {"voltage_V": "pack"})


def _rpm(messages: Mapping[str, Message], notes: list[str]) -> list[TimeSeries | None]:
    """Rotor speeds; a batch that only repeats rotors 1-4 (PX4 of the v1.14 era) is left out."""
    status = messages.get("ESC_STATUS")
    if status is not None:
        firsts = sorted(set(status["index"].astype(int).tolist()))
        batches = {first: rows_of(status, status["index"] == first) for first in firsts}
    else:
        batches = {4 * i: messages.get(name) for i, name in enumerate(ESC_TELEMETRY)}
    known = {first: batch for first, batch in batches.items() if batch is not None}
    found = []
    for first, batch in known.items():
        speeds, usual = batch["rpm"], known[0]["rpm"] if 0 in known else np.empty((0, 4))
        same = min(len(speeds), len(usual))
        if first and same > 10 and np.any(usual) and np.array_equal(speeds[:same], usual[:same]):
            notes.append(f"rpm{first + 1}..{first + 4} left out: ESC_STATUS repeats rotors 1-4 there")
            continue
        used = [i for i in range(4) if np.any(speeds[:, i])]
        columns = {f"rpm{first + i + 1}": speeds[:, i] for i in used}
        found.append(TimeSeries.of(batch["time_s"], columns))
    return found
