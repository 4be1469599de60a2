"""tlog: MAVLink frames, each after eight bytes of the recorder's clock. Times are the messages' own.

The recorder's clock only orders the frames: a simulator may run faster than the wall, and links add delay.
"""

from __future__ import annotations

import struct
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from coaxlink import files
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.data.logs.outputs import (
    Map,
    ardupilot_map,
    as_motors,
    commands,
    motors_of_escs,
    px4_maps,
    px4_outputs,
)
from coaxlink.data.logs.streams import (
    Array,
    Message,
    TimeSeries,
    derived,
    euler_of,
    longest,
    merge,
    possible,
    rows_of,
    series,
)
from coaxlink.data.samples import DAMAGED, OUTPUTS_AS_MOTORS, Samples
from coaxlink.errors import InputError
from firmware_params import bounded

EPOCH_US = 1e15  # a stamp above this counts from 1970, one below from boot
ESC_TELEMETRY = ("ESC_TELEMETRY_1_TO_4", "ESC_TELEMETRY_5_TO_8", "ESC_TELEMETRY_9_TO_12")
NAMES = (
    "HEARTBEAT", "HIGHRES_IMU", "SCALED_IMU", "RAW_IMU", "ATTITUDE", "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED", "ACTUATOR_OUTPUT_STATUS", "SERVO_OUTPUT_RAW", "BATTERY_STATUS", "ESC_STATUS",
    "ESC_INFO", *ESC_TELEMETRY, "DISTANCE_SENSOR", "EXTENDED_SYS_STATE", "PARAM_VALUE",
)  # fmt: skip
WRAP_S = 2**32 / 1e6  # 32 bits of microseconds come round every 71 minutes
REBOOT_S = 5.0  # a clock that goes back by more than this was restarted
ARMED_FLAG, ARDUPILOT = 128, 3
ON_GROUND = 1
DOWNWARD = 25  # MAV_SENSOR_ROTATION_PITCH_270
NO_CELL_MV = 65535
LONGEST_FRAME = 8 + 10 + 255 + 2 + 13  # stamp, header, payload, checksum, signature
INTEGERS = {1: "<B", 2: "<b", 3: "<H", 4: "<h", 5: "<I", 6: "<i"}  # MAV_PARAM_TYPE


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


def read_tlog(path: Path, motors: TimeSeries | None = None) -> Samples:
    """A recorded link as flight columns, with other commands where `motors` has them. Raises InputError."""
    messages, parameters, garbled, damaged = _messages(path)
    shown = ", ".join(f"{name} {len(messages[name]['time_s'])}" for name in NAMES if name in messages)
    notes = [f"tlog: {shown}"]
    if garbled:
        notes.append(f"{garbled} frames left out: garbled on their way")
    premises = [DAMAGED] * damaged
    maps = (
        ([m] if (m := ardupilot_map(parameters)) else []) if _is_ardupilot(messages) else px4_maps(parameters)
    )
    motors = motors or _motors(messages, parameters, notes, premises)
    measured = [
        _imu(messages),
        _attitude(messages),
        series(messages.get("LOCAL_POSITION_NED"), {"vel_n_m_s": "vx", "vel_e_m_s": "vy", "vel_d_m_s": "vz"}),
        _height(messages, notes),
        _voltage(messages.get("BATTERY_STATUS")),
        derived(messages.get("HEARTBEAT"), lambda m: {"armed": m["base_mode"].astype(int) & ARMED_FLAG > 0}),
        derived(messages.get("EXTENDED_SYS_STATE"), lambda m: {"landed": m["landed_state"] == ON_GROUND}),
        *_rpm(messages, maps[0] if len(maps) == 1 else (), notes, premises),
    ]
    samples = merge(str(path), motors, possible(measured, premises), notes).on_premises(*premises)
    known = tuple(sorted({o.motor for outputs in maps for o in outputs}))
    return replace(samples, motors=known, parameters=parameters)


def _messages(path: Path) -> tuple[dict[str, Message], dict[str, float], int, bool]:
    """Of the autopilot that sends the most: messages by name, in s since boot, the last value of each
    parameter; how many frames were garbled, and whether the file is damaged (a torn last frame is none)."""
    from pymavlink.dialects.v20 import common

    from firmware_params.ardupilot import messages as _esc_telemetry  # noqa: F401  registers it
    from firmware_params.px4 import messages as _esc_status  # noqa: F401  registers ESC_STATUS

    parser = common.MAVLink(None)
    wanted = {i for i, cls in common.mavlink_map.items() if cls.msgname in NAMES}
    by_sender: dict[tuple[int, int], list[Any]] = defaultdict(list)
    garbled, left = 0, path.stat().st_size
    for _, frame in stamped_frames(path):
        left -= 8 + len(frame)
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
    quiet = ("HEARTBEAT", "PARAM_VALUE")
    motion = Counter({who: sum(m.get_type() not in quiet for m in sent) for who, sent in by_sender.items()})
    sent = by_sender[motion.most_common(1)[0][0]]
    reported = [m for m in sent if m.get_type() == "PARAM_VALUE"]
    boot = _longest_boot([m for m in sent if m.get_type() != "PARAM_VALUE"])
    messages = {name: _message(rows) for name, rows in _stamped(boot).items()}
    bytewise = not _is_ardupilot(messages)
    values = {str(m.param_id): _parameter(m, bytewise) for m in reported}
    return messages, values, garbled, garbled > 0 or left > LONGEST_FRAME


def tlog_parameters(path: Path) -> dict[str, float]:
    """The last value of each parameter that the autopilot sent: a ground station asks for all of them.

    Of several senders the one that sent the most. Raises InputError where there is none.
    """
    from pymavlink.dialects.v20 import common

    parser = common.MAVLink(None)
    reported: dict[tuple[int, int], dict[str, Any]] = defaultdict(dict)
    autopilots: dict[tuple[int, int], int] = {}
    for _, frame in stamped_frames(path):
        number = int.from_bytes(frame[7:10], "little") if frame[0] == 0xFD else frame[5]
        if number not in (common.MAVLINK_MSG_ID_HEARTBEAT, common.MAVLINK_MSG_ID_PARAM_VALUE):
            continue
        try:
            message = parser.decode(bytearray(frame))
        except common.MAVError:
            continue
        sender = (message.get_srcSystem(), message.get_srcComponent())
        if message.get_type() == "HEARTBEAT":
            autopilots[sender] = int(message.autopilot)
        else:
            reported[sender][str(message.param_id)] = message
    if not reported:
        problem = "no parameters (PARAM_VALUE) in this tlog: record one while a ground station loads them"
        raise InputError(path, "", problem)
    sender = max(reported, key=lambda who: len(reported[who]))
    plain = autopilots.get(sender, ARDUPILOT if "FRAME_CLASS" in reported[sender] else 0) == ARDUPILOT
    return {name: _parameter(message, not plain) for name, message in reported[sender].items()}


def _is_ardupilot(messages: Mapping[str, Message]) -> bool:
    return "HEARTBEAT" in messages and bool((messages["HEARTBEAT"]["autopilot"] == ARDUPILOT).any())


def _parameter(message: Any, bytewise: bool) -> float:
    """PX4 sends an integer's bytes in the place of the float, ArduPilot every value as a float."""
    form = INTEGERS.get(int(message.param_type)) if bytewise else None
    if form is None:
        return float(message.param_value)
    frame = message.get_msgbuf()
    start = 10 if frame[0] == 0xFD else 6
    return float(struct.unpack_from(form, bytes(frame), start)[0])


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


def _motors(
    messages: Mapping[str, Message], parameters: Mapping[str, float], notes: list[str], premises: list[str]
) -> TimeSeries | None:
    status, servo = messages.get("ACTUATOR_OUTPUT_STATUS"), messages.get("SERVO_OUTPUT_RAW")
    logged = longest(status, servo)
    if logged is None:
        return None
    if logged is status:
        name, ports = "ACTUATOR_OUTPUT_STATUS", [logged]
        values = [dict(enumerate(logged["actuator"].T, 1))]
    else:
        name = "SERVO_OUTPUT_RAW"
        numbers = sorted(set(logged["port"].tolist()))
        ports = [rows for port in numbers if (rows := rows_of(logged, logged["port"] == port)) is not None]
        values = [{n: rows[f"servo{n}_raw"] for n in range(1, 17)} for rows in ports]
    if _is_ardupilot(messages):  # a second port holds outputs 17 to 32
        time = ports[0]["time_s"]
        for rows, more in zip(ports[1:], values[1:], strict=True):
            values[0] |= {16 + n: np.interp(time, rows["time_s"], column) for n, column in more.items()}
        outputs = ardupilot_map(parameters)
        known, found = bool(outputs), [(outputs or as_motors(values[0], parameters, "SERVO"), 0)]
    else:
        found, known = px4_outputs(values, parameters)
    if not any(outputs for outputs, _ in found):
        return None
    if not known:
        premises.append(OUTPUTS_AS_MOTORS)
    first = ports[found[0][1]]["time_s"]
    columns: dict[str, Array] = {}
    for outputs, port in found:
        for motor, command in commands(outputs, values[port], name, notes).items():
            columns[motor] = (
                command if port == found[0][1] else np.interp(first, ports[port]["time_s"], command)
            )
    return TimeSeries.of(first, columns)


def _imu(messages: Mapping[str, Message]) -> TimeSeries | None:
    accel, gyro = ({ours.format(a): f"{a}{theirs}" for a in "xyz"} for ours, theirs in IMU_FIELDS)
    if "HIGHRES_IMU" in messages:
        return series(messages["HIGHRES_IMU"], accel | gyro)
    # ArduPilot's RAW_IMU is in mg and mrad/s as SCALED_IMU is; others send what their chip reads
    imu = longest(messages.get("SCALED_IMU"), messages.get("RAW_IMU") if _is_ardupilot(messages) else None)
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


def _rpm(
    messages: Mapping[str, Message], outputs: Map, notes: list[str], premises: list[str]
) -> list[TimeSeries | None]:
    """Rotor speeds; a batch that only repeats rotors 1-4 (PX4 of the v1.14 era) is left out."""
    status = messages.get("ESC_STATUS")
    if status is not None:
        firsts = sorted(set(status["index"].astype(int).tolist()))
        batches = {first: rows_of(status, status["index"] == first) for first in firsts}
    else:
        batches = {4 * i: messages.get(name) for i, name in enumerate(ESC_TELEMETRY)}
    known = {first: batch for first, batch in batches.items() if batch is not None}
    ampere = 1.0 if status is not None else 0.01
    info = messages.get("ESC_INFO")  # of PX4, about once a second, hundredths of a degree
    speeds: dict[int, tuple[Array, dict[str, Array]]] = {}  # by ESC, counted from 0: stamps, columns
    warm: dict[int, tuple[Array, Array]] = {}
    for first, batch in known.items():
        rpm, usual = batch["rpm"], known[0]["rpm"] if 0 in known else np.empty((0, 4))
        same = min(len(rpm), len(usual))
        if first and same > 10 and np.any(usual) and np.array_equal(rpm[:same], usual[:same]):
            notes.append(f"rpm{first + 1}..{first + 4} left out: ESC_STATUS repeats rotors 1-4 there")
            continue
        values = {"rpm{}": rpm, "current{}_A": ampere * batch["current"]}
        values |= {"temperature{}_C": batch["temperature"]} if "temperature" in batch else {}
        for i in range(4):
            if np.any(rpm[:, i]):
                columns = {n: c[:, i] for n, c in values.items() if np.any(c[:, i])}
                speeds[first + i] = batch["time_s"], columns
        if info is not None and (of := rows_of(info, info["index"] == first)) is not None:
            warm |= {first + i: (of["time_s"], 0.01 * of["temperature"][:, i]) for i in range(4)}
    motors = motors_of_escs(outputs, speeds, notes, premises)
    found: list[TimeSeries | None] = []
    for esc, motor in motors.items():
        time_s, columns = speeds[esc]
        found.append(TimeSeries.of(time_s, {name.format(motor): c for name, c in columns.items()}))
        if esc in warm and np.any(warm[esc][1]):
            found.append(TimeSeries.of(warm[esc][0], {f"temperature{motor}_C": warm[esc][1]}))
    return found
