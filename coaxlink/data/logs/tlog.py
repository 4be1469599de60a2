"""tlog: MAVLink frames, each after eight bytes of the recorder's clock. Times are the messages' own.

The recorder's clock only orders the frames: a simulator may run faster than the wall, and links add delay.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink import files
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.data.logs.streams import Stream, euler_of, merge
from coaxlink.data.samples import Samples
from coaxlink.errors import InputError
from firmware_params import bounded

EPOCH_US = 1e15  # a stamp above this counts from 1970, one below from boot
ESC_TELEMETRY = ("ESC_TELEMETRY_1_TO_4", "ESC_TELEMETRY_5_TO_8", "ESC_TELEMETRY_9_TO_12")
NAMES = (
    "HEARTBEAT",
    "HIGHRES_IMU",
    "SCALED_IMU",
    "RAW_IMU",
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED",
    "ACTUATOR_OUTPUT_STATUS",
    "SERVO_OUTPUT_RAW",
    "BATTERY_STATUS",
    "ESC_STATUS",
    *ESC_TELEMETRY,
    "DISTANCE_SENSOR",
    "EXTENDED_SYS_STATE",
)
WRAP_S = 2**32 / 1e6
REBOOT_S = 5.0  # a clock that goes back by more than this was restarted
ARMED_FLAG, ARDUPILOT = 128, 3
ON_GROUND = 1
DOWNWARD = 25  # MAV_SENSOR_ROTATION_PITCH_270
Row = tuple[float, Any]


def frames(path: Path) -> Iterator[bytes]:
    """The frames of a tlog in order; a torn last frame is left out, damage is skipped.

    Raises InputError when there is more damage than log.
    """
    return (frame for _, frame in stamped_frames(path))


def stamped_frames(path: Path) -> Iterator[tuple[int, bytes]]:
    """(recorder's clock in us since 1970, frame) of a tlog in order; as `frames`."""
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
            break
    if 2 * skipped > len(data):
        raise InputError(path, f"byte {first}", "a MAVLink frame is expected after each time stamp")


def _frame_size(data: bytes, at: int) -> int:
    """Bytes of the frame that starts here, 0 if none does."""
    if data[at] == 0xFD and at + 3 <= len(data):
        return 12 + data[at + 1] + (13 if data[at + 2] & 1 else 0)
    return 8 + data[at + 1] if data[at] == 0xFE and at + 2 <= len(data) else 0


def read_tlog(path: Path) -> Samples:
    """A recorded link as flight columns. Raises InputError."""
    rows, garbled = _messages(path)
    notes = [f"tlog: {', '.join(f'{name} {len(found)}' for name, found in rows.items() if found)}"]
    if garbled:
        notes.append(f"{garbled} frames left out: garbled on their way")
    motors = _motors(rows, notes)
    streams = [
        _imu(rows),
        _attitude(rows),
        _columns(rows["LOCAL_POSITION_NED"], {"vel_n_m_s": "vx", "vel_e_m_s": "vy", "vel_d_m_s": "vz"}),
        _height(rows, notes),
        _columns(_valid_battery(rows), {"voltage_V": _pack_voltage}),
        _columns(rows["HEARTBEAT"], {"armed": lambda m: bool(m.base_mode & ARMED_FLAG)}),
        _columns(rows["EXTENDED_SYS_STATE"], {"landed": lambda m: m.landed_state == ON_GROUND}),
        *_rpm(rows, notes),
    ]
    return merge(str(path), motors, streams, notes)


def _messages(path: Path) -> tuple[dict[str, list[Row]], int]:
    """(time in s since boot, message) by name, of the autopilot that sends the most; frames lost."""
    from pymavlink.dialects.v20 import common

    from firmware_params.ardupilot import messages as _esc_telemetry  # noqa: F401  registers it
    from firmware_params.px4 import messages as _esc_status  # noqa: F401  registers ESC_STATUS

    parser = common.MAVLink(None)
    wanted = {i for i, cls in common.mavlink_map.items() if cls.msgname in NAMES}
    by_sender: dict[tuple[int, int], list[Any]] = defaultdict(list)
    garbled = 0
    for frame in frames(path):
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
    return _stamped(_longest_boot(by_sender[motion.most_common(1)[0][0]])), garbled


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


def _stamped(messages: list[Any]) -> dict[str, list[Row]]:
    rows: dict[str, list[Row]] = {name: [] for name in NAMES}
    clock = 0.0  # the latest stamp since boot: what messages without one get
    epoch: dict[str, list[tuple[float, Any, float]]] = defaultdict(list)
    for message in messages:
        name = message.get_type()
        if hasattr(message, "time_boot_ms"):
            clock = message.time_boot_ms / 1e3
        elif name == "SERVO_OUTPUT_RAW":  # 32 bits of microseconds come round every 71 minutes
            clock = message.time_usec / 1e6 + WRAP_S * round((clock - message.time_usec / 1e6) / WRAP_S)
        elif hasattr(message, "time_usec"):
            if message.time_usec > EPOCH_US:
                epoch[name].append((message.time_usec / 1e6, message, clock))
                continue
            if message.time_usec:
                clock = message.time_usec / 1e6
        rows[name].append((clock, message))
    for name, found in epoch.items():
        offset = float(np.median([stamp - boot for stamp, _, boot in found if boot > 0] or [found[0][0]]))
        rows[name] += [(stamp - offset, message) for stamp, message, _ in found]
    return rows


def _columns(rows: list[Row], fields: dict[str, Any]) -> Stream | None:
    """A stream of the fields (attribute names or functions of the message) of these rows."""
    if not rows:
        return None
    time = np.array([t for t, _ in rows])
    return Stream.of(
        time,
        {
            name: np.array([float(get(m) if callable(get) else getattr(m, get)) for _, m in rows])
            for name, get in fields.items()
        },
    )


def _motors(rows: dict[str, list[Row]], notes: list[str]) -> Stream | None:
    outputs = max(rows["ACTUATOR_OUTPUT_STATUS"], rows["SERVO_OUTPUT_RAW"], key=len)
    if not outputs:
        return None
    if outputs[0][1].get_type() == "SERVO_OUTPUT_RAW":
        first = [(t, m) for t, m in outputs if m.port == 0]
        pwm = np.array([[getattr(m, f"servo{n}_raw") for n in range(1, 17)] for _, m in first], float)
        time = np.array([t for t, _ in first])
    else:
        pwm = np.array([m.actuator for _, m in outputs], float)
        time = np.array([t for t, _ in outputs])
    used = np.flatnonzero((pwm >= 800).any(axis=0))
    count = int(used[-1]) + 1 if len(used) else 0
    if not count:
        return None
    notes.append(f"motor1..{count} = (PWM - 1000) / 1000, 0..1, from {outputs[0][1].get_type()}")
    command = np.clip((pwm[:, :count] - 1000) / 1000, 0, 1)
    return Stream.of(time, {f"motor{n + 1}": command[:, n] for n in range(count)})


def _imu(rows: dict[str, list[Row]]) -> Stream | None:
    if rows["HIGHRES_IMU"]:
        fields: dict[str, Any] = {f"accel_{a}_m_s2": f"{a}acc" for a in "xyz"}
        fields |= {f"gyro_{a}_rad_s": f"{a}gyro" for a in "xyz"}
        return _columns(rows["HIGHRES_IMU"], fields)

    def scaled(attribute: str, factor: float) -> Any:
        return lambda m: getattr(m, attribute) * factor

    fields = {f"accel_{a}_m_s2": scaled(f"{a}acc", GRAVITY_M_S2 / 1e3) for a in "xyz"}
    fields |= {f"gyro_{a}_rad_s": scaled(f"{a}gyro", 1e-3) for a in "xyz"}
    # ArduPilot's RAW_IMU is in these units; others send what their chip reads
    ardupilot = any(m.autopilot == ARDUPILOT for _, m in rows["HEARTBEAT"])
    return _columns(max(rows["SCALED_IMU"], rows["RAW_IMU"] if ardupilot else [], key=len), fields)


def _attitude(rows: dict[str, list[Row]]) -> Stream | None:
    if len(rows["ATTITUDE"]) >= len(rows["ATTITUDE_QUATERNION"]):
        return _columns(rows["ATTITUDE"], {"roll_rad": "roll", "pitch_rad": "pitch", "yaw_rad": "yaw"})
    found = rows["ATTITUDE_QUATERNION"]
    q = np.array([(m.q1, m.q2, m.q3, m.q4) for _, m in found]).T
    return Stream.of(np.array([t for t, _ in found]), euler_of(*q))


def _height(rows: dict[str, list[Row]], notes: list[str]) -> Stream | None:
    looking_down = [(t, m) for t, m in rows["DISTANCE_SENSOR"] if m.orientation == DOWNWARD]
    if looking_down:
        return _columns(looking_down, {"height_m": lambda m: m.current_distance / 100})
    if rows["LOCAL_POSITION_NED"]:
        notes.append("height_m from the estimator's z above its origin: no DISTANCE_SENSOR")
    return _columns(rows["LOCAL_POSITION_NED"], {"height_m": lambda m: -m.z})


def _valid_battery(rows: dict[str, list[Row]]) -> list[Row]:
    return [(t, m) for t, m in rows["BATTERY_STATUS"] if m.id == 0 and 0 < m.voltages[0] < 65535]


def _pack_voltage(message: Any) -> float:
    """V of the whole pack: the cells that are filled in, or the one total that some autopilots send."""
    return sum(v for v in message.voltages if 0 < v < 65535) / 1e3


def _rpm(rows: dict[str, list[Row]], notes: list[str]) -> list[Stream | None]:
    """Rotor speeds; a batch that only repeats rotors 1-4 (PX4 of the v1.14 era) is left out."""
    batches: dict[int, list[Row]] = defaultdict(list)
    for t, m in rows["ESC_STATUS"]:
        batches[m.index].append((t, m))
    for first, name in enumerate(ESC_TELEMETRY):
        if rows[name] and not rows["ESC_STATUS"]:
            batches[4 * first] = rows[name]
    speeds: dict[int, NDArray[np.float64]] = {
        index: np.array([m.rpm for _, m in found], float) for index, found in batches.items()
    }
    streams = []
    for index, found in sorted(batches.items()):
        same = min(len(speeds[index]), len(speeds.get(0, ())))
        if (
            index
            and same > 10
            and np.any(speeds[0])
            and np.array_equal(speeds[index][:same], speeds[0][:same])
        ):
            notes.append(f"rpm{index + 1}..{index + 4} left out: ESC_STATUS repeats rotors 1-4 there")
            continue
        used = [i for i in range(4) if np.any(speeds[index][:, i])]
        if used:
            time = np.array([t for t, _ in found])
            streams.append(Stream.of(time, {f"rpm{index + i + 1}": speeds[index][:, i] for i in used}))
    return streams
