"""tlog: MAVLink frames, each after eight bytes of the recorder's clock. Times are the messages' own.

The recorder's clock only orders the frames: a simulator may run faster than the wall, and links add delay.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import GRAVITY_M_S2, MICROSECONDS_WRAP_S
from coaxlink.data.logs.esc_readings import measured_escs
from coaxlink.data.logs.mavlink_frames import LONGEST_FRAME, Heard, Rows, Sender, heard, message_numbers
from coaxlink.data.logs.outputs import (
    Map,
    ardupilot_map,
    as_motors,
    commands,
    motorless,
    motors_of_escs,
    px4_maps,
    px4_outputs,
    tell_range,
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
from coaxlink.data.logs.stretches import LATE_S, UNHEARD_S, Stream, cuts, each_stretch, joined
from coaxlink.data.samples import DAMAGED, OUTPUTS_AS_MOTORS, Samples
from coaxlink.errors import InputError
from firmware_params.ardupilot.parameters import other_vehicle

ONLINE_BITS = 8  # of ESC_INFO
EPOCH_US = 1e15  # a stamp above this counts from 1970, one below from boot
ESC_TELEMETRY = ("ESC_TELEMETRY_1_TO_4", "ESC_TELEMETRY_5_TO_8", "ESC_TELEMETRY_9_TO_12")
NAMES = (
    "HEARTBEAT", "HIGHRES_IMU", "SCALED_IMU", "RAW_IMU", "ATTITUDE", "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED", "ACTUATOR_OUTPUT_STATUS", "SERVO_OUTPUT_RAW", "BATTERY_STATUS", "ESC_STATUS",
    "ESC_INFO", *ESC_TELEMETRY, "DISTANCE_SENSOR", "EXTENDED_SYS_STATE", "PARAM_VALUE",
)  # fmt: skip
CLOCKS = ("ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "SCALED_IMU")  # one at a time
QUIET = ("HEARTBEAT", "PARAM_VALUE")  # sent on the ground too
FLIGHT_MESSAGES = "messages of a flight"
LAST_SYSTEM = 255  # MAVLink
ARMED_FLAG, ARDUPILOT = 128, 3
ON_GROUND = 1
DOWNWARD = 25  # MAV_SENSOR_ROTATION_PITCH_270
NO_CELL_MV = 65535
INTEGERS = {1: "<B", 2: "<b", 3: "<H", 4: "<h", 5: "<I", 6: "<i"}  # MAV_PARAM_TYPE


def read_tlog(
    path: Path, system: int | None = None, motors: Sequence[TimeSeries] | None = None
) -> list[Samples]:
    """Every flight of a recorded link as flight columns, with other commands where `motors` has them.

    Of several vehicles that of `system`, else the one that sent the most. Raises InputError.
    """
    link = _link(path, system)
    if motors is not None and len(motors) != len(link.boots):
        problem = (
            f"{len(link.boots)} stretches, its commands beside it have {len(motors)}: one of both is cut"
        )
        raise InputError(path, "", problem)

    def read(number: int) -> Samples:
        return _flight(path, link, number, None if motors is None else motors[number])

    found = each_stretch(str(path), range(len(link.boots)), read)
    return [replace(one, provenance=(*link.provenance, *one.provenance)) for one in found]


def _flight(path: Path, link: _Link, number: int, motors: TimeSeries | None) -> Samples:
    boot = link.boots[number]
    messages, parameters = boot.messages, boot.parameters
    shown = ", ".join(f"{name} {len(messages[name]['time_s'])}" for name in NAMES if name in messages)
    notes = [f"tlog: {shown}"]
    if link.garbled:
        notes.append(f"{link.garbled} frames left out: garbled on their way")
    premises = [DAMAGED] * link.damaged
    maps = (
        ([m] if (m := ardupilot_map(parameters)) else []) if _is_ardupilot(messages) else px4_maps(parameters)
    )
    motors = motors or _motors(path, messages, parameters, notes, premises)
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


@dataclass(frozen=True)
class _Boot:
    """What an autopilot sent from one start to the next."""

    messages: Mapping[str, Message]  # in s since that start
    parameters: Mapping[str, float]  # the last value of each by its end, else the first that was heard later


@dataclass(frozen=True)
class _Link:
    """What one autopilot sent."""

    boots: list[_Boot]
    provenance: tuple[str, ...]  # of the other vehicles
    garbled: int
    damaged: bool  # a torn last frame is none


def _link(path: Path, system: int | None) -> _Link:
    """Of the autopilot of `system`, else of the one that sends the most of a flight."""
    found = heard(path, NAMES)
    if not found.rows:
        raise InputError(path, "", "no telemetry of an autopilot in this tlog")
    motion = {
        who: sum(len(rows.at) for name, rows in kinds.items() if name not in QUIET)
        for who, kinds in found.rows.items()
    }
    sender, provenance = chosen(path, motion, system, FLIGHT_MESSAGES)
    sent = found.rows[sender]
    reported = sent.pop("PARAM_VALUE", None)
    if not sent:
        raise InputError(path, "", f"system {sender[0]} sent parameters alone: no flight in this tlog")
    bytewise = not ("HEARTBEAT" in sent and bool((sent["HEARTBEAT"].fields["autopilot"] == ARDUPILOT).any()))
    boots = []
    begun = joined(found.clock_us / 1e6)
    edges = [0, *cuts(str(path), _streams(sent, found, begun), LATE_S, begun.tolist()), 2**62]
    for first, last in pairwise(edges):
        stated = {n: part for n, rows in sent.items() if len((part := rows.between(first, last - 1)).at)}
        values: dict[str, float] = {}
        if reported is not None:
            later = _parameters(reported.between(last, 2**62), bytewise=bytewise, first=True)
            values = later | _parameters(reported.between(0, last - 1), bytewise=bytewise)
        if stated:
            boots.append(_Boot(_stamped(stated), values))
    return _Link(boots, provenance, found.garbled, found.garbled > 0 or found.left > LONGEST_FRAME)


def flight_numbers() -> frozenset[int]:
    """Of the messages by which the vehicle to read is chosen."""
    return message_numbers([name for name in NAMES if name not in QUIET])


def _streams(sent: Mapping[str, Rows], found: Heard, begun: NDArray[np.intp]) -> Iterator[Stream]:
    """The board's clock in messages that it sends one at a time; what came over two links counts once in each
    recording, of which these are the first places.
    """
    for name in CLOCKS:
        if name in sent:
            fields, heard_s = sent[name].fields, found.clock_us[sent[name].at] / 1e6
            recording = np.searchsorted(begun, sent[name].at, side="right").astype(np.int64)
            bytes_of = [x.view(np.uint8).reshape(len(fields), -1) for x in (recording, fields)]
            key = np.ascontiguousarray(np.concatenate(bytes_of, axis=1))
            _, first, which = np.unique(key.view(f"V{key.shape[1]}"), return_index=True, return_inverse=True)
            first = first[which.ravel()]
            again = (np.arange(len(fields)) != first) & (heard_s - heard_s[first] < UNHEARD_S)
            rows = sent[name].rows(np.flatnonzero(~again))
            stamp, since_1970 = _stamps(name, rows)
            yield Stream(rows.at, np.where(since_1970, np.nan, stamp), heard_s[~again])


def chosen(
    path: Path, sent: Mapping[Sender, int], system: int | None, what: str
) -> tuple[Sender, tuple[str, ...]]:
    """Whom to read, and what must be reported of the others; `sent` is how much each sent. Raises InputError.

    >>> chosen(Path("f.tlog"), {(1, 1): 900, (2, 1): 40}, 2, "messages")[0]
    (2, 1)
    """
    if system is not None and not 1 <= system <= LAST_SYSTEM:
        raise InputError("`system`", "", f"a system id from 1 to {LAST_SYSTEM} is expected, found {system}")
    best: dict[int, Sender] = {}  # of each system the component that sent the most, of equals the first
    for who, count in sent.items():
        if count > (sent[best[who[0]]] if who[0] in best else 0):
            best[who[0]] = who
    listed = " and ".join(f"{one} ({sent[who]} {what})" for one, who in best.items())
    if system is not None:
        if system not in best:
            raise InputError(path, f"`system` {system}", f"is not in this tlog: found {listed or 'none'}")
        return best[system], (f"{path}: of systems {listed}, {system} is read",) if len(best) > 1 else ()
    if not best:
        return next(iter(sent)), ()
    first = max(best, key=lambda one: sent[best[one]])
    if len(best) == 1:
        return best[first], ()
    alike = sum(sent[who] == sent[best[first]] for who in best.values()) > 1
    why = "heard first of those that sent the most" if alike else "which sent the most"
    words = f"{path}: systems {listed}: {first} is read, {why}; `system` takes another"
    return best[first], (words,)


def tlog_parameters(path: Path, system: int | None = None) -> tuple[dict[str, float], tuple[str, ...]]:
    """The last value of each parameter that an autopilot sent (a ground station asks for all of them), and
    what must be reported of others.

    Of several senders that of `system`, else the one that sent the most. Raises InputError for none.
    """
    kinds = heard(path, ("HEARTBEAT", "PARAM_VALUE")).rows
    reported = {who: rows["PARAM_VALUE"] for who, rows in kinds.items() if "PARAM_VALUE" in rows}
    if not reported:
        problem = "no parameters (PARAM_VALUE) in this tlog: record one while a ground station loads them"
        raise InputError(path, "", problem)
    in_order = sorted(reported, key=lambda who: int(reported[who].at[0]))
    counts = {who: len(set(_names(reported[who]))) for who in in_order}
    sender, provenance = chosen(path, counts, system, "parameters")
    rows, beats = reported[sender], kinds[sender].get("HEARTBEAT")
    if beats is not None:
        plain = int(beats.fields["autopilot"][-1]) == ARDUPILOT
    else:
        plain = "FRAME_CLASS" in _names(rows)
    return _parameters(rows, bytewise=not plain), provenance


def _is_ardupilot(messages: Mapping[str, Message]) -> bool:
    return "HEARTBEAT" in messages and bool((messages["HEARTBEAT"]["autopilot"] == ARDUPILOT).any())


def _names(reported: Rows) -> list[str]:
    """The parameter of each PARAM_VALUE."""
    ids: list[bytes] = reported.fields["param_id"].tolist()
    return [name.split(b"\0", 1)[0].decode("ascii", errors="replace") for name in ids]


def _parameters(reported: Rows, *, bytewise: bool, first: bool = False) -> dict[str, float]:
    """The last value of each, or the first. PX4 sends an integer's bytes in the place of the float
    (`bytewise`), ArduPilot every value as a float."""
    fields = reported.fields
    values = {}
    for name, kind, value in zip(
        _names(reported), fields["param_type"].tolist(), fields["param_value"], strict=True
    ):
        form = INTEGERS.get(kind) if bytewise else None
        if first and name in values:
            continue
        values[name] = float(value if form is None else struct.unpack_from(form, value.tobytes())[0])
    return values


def _stamped(sent: Mapping[str, Rows]) -> dict[str, Message]:
    """By name, in s since boot: a message's own stamp, or else the latest of all before it."""
    if not sent:
        return {}
    stamps = [_stamps(name, rows) for name, rows in sent.items()]
    order = np.argsort(np.concatenate([rows.at for rows in sent.values()]))
    own = np.concatenate([np.where(since_1970, np.nan, stamp) for stamp, since_1970 in stamps])
    wraps = np.concatenate([np.full(len(rows.at), name == "SERVO_OUTPUT_RAW") for name, rows in sent.items()])
    clock, clocks = 0.0, np.empty(len(order))
    for i, stamp, short in zip(order.tolist(), own[order].tolist(), wraps[order].tolist(), strict=True):
        if short:
            clock = stamp + MICROSECONDS_WRAP_S * round((clock - stamp) / MICROSECONDS_WRAP_S)
        elif not math.isnan(stamp):
            clock = stamp
        clocks[i] = clock
    ends = np.cumsum([len(rows.at) for rows in sent.values()])
    messages: dict[str, Message] = {}
    for (name, rows), (stamp, since_1970), boot in zip(
        sent.items(), stamps, np.split(clocks, ends[:-1]), strict=True
    ):
        time_s = boot
        if since_1970.any():
            offsets = (stamp - boot)[since_1970 & (boot > 0)]
            offset = float(np.median(offsets)) if len(offsets) else float(stamp[since_1970][0])
            time_s = np.where(since_1970, stamp - offset, boot)
        first = np.argsort(since_1970, kind="stable")  # of equal times the one on the vehicle's clock
        columns = {field: column[first] for field, column in rows.columns().items()}
        messages[name] = columns | {"time_s": time_s[first]}
    return messages


def _stamps(name: str, rows: Rows) -> tuple[Array, NDArray[np.bool_]]:
    """(s, NaN where it has none; whether counted from 1970) of messages of one kind."""
    if rows.has("time_boot_ms"):
        return rows.fields["time_boot_ms"] / 1e3, np.zeros(len(rows.at), bool)
    if not rows.has("time_usec"):
        return np.full(len(rows.at), np.nan), np.zeros(len(rows.at), bool)
    count = rows.fields["time_usec"].astype(float)
    if name == "SERVO_OUTPUT_RAW":
        return count / 1e6, np.zeros(len(rows.at), bool)
    return np.where(count > 0, count / 1e6, np.nan), count > EPOCH_US


def _motors(
    path: Path,
    messages: Mapping[str, Message],
    parameters: Mapping[str, float],
    notes: list[str],
    premises: list[str],
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
        if other := other_vehicle(parameters):
            raise InputError(path, "", f"the log of {other}: a multirotor's is expected")
        if other := motorless(parameters):
            raise InputError(path, "", f"no output of this vehicle drives a motor ({other})")
        outputs = ardupilot_map(parameters)
        tell_range(parameters, notes, premises)
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
    """V of the whole pack: the cells that are filled in, or the one total that some autopilots send.

    Of several packs the first; the last is one without a number, as PX4's SITL has it (255).
    """
    if battery is None:
        return None
    cells = battery["voltages"]
    filled = (cells > 0) & (cells < NO_CELL_MV)
    pack = {"time_s": battery["time_s"], "pack": np.where(filled, cells, 0.0).sum(axis=1) / 1e3}
    first = battery["id"] == battery["id"].min()
    return series(rows_of(pack, first & filled[:, 0]), {"voltage_V": "pack"})


def _online(info: Message | None, esc: int, time_s: Array) -> NDArray[np.bool_]:
    """(n,) whether the last ESC_INFO has an ESC's bit: without it PX4 repeats what it last heard of it.

    Every batch holds the bits of the first eight (PX4's ESC_INFO.hpp). A driver that never sets the bit of an
    ESC whose speed moves does not keep them.
    """
    always = np.ones(len(time_s), bool)
    if info is None or esc >= ONLINE_BITS:
        return always
    order = np.argsort(info["time_s"], kind="stable")
    bits = (np.nan_to_num(info["info"][order]).astype(np.int64) >> esc) & 1 == 1
    last = np.searchsorted(info["time_s"][order], time_s, side="right") - 1
    online: NDArray[np.bool_] = bits[np.maximum(last, 0)]
    return online if online.any() else always


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
        online = _online(info, esc, time_s)
        if not online.all():
            notes.append(f"rpm{motor}: ESC {esc} is offline in {np.mean(~online):.0%} of ESC_STATUS")
        columns = {name.format(motor): c[online] for name, c in columns.items()}
        found.append(TimeSeries.of(time_s[online], columns))
        if esc in warm and np.any(warm[esc][1]):
            found.append(TimeSeries.of(warm[esc][0], {f"temperature{motor}_C": warm[esc][1]}))
    return measured_escs(found, notes)
