"""ULog of PX4 as flight columns.

`actuator_motors` holds the command before the thrust curve of THR_MDL_FAC, by motors: where it is logged it
is used. `actuator_outputs` holds the one after it, by drivers and their channels. Sensor topics are stamped
by `timestamp_sample`.
"""

from __future__ import annotations

import io
import math
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink import files
from coaxlink.data.logs.changes import Change, periods, read_in_periods
from coaxlink.data.logs.demands import DEMANDS, between_rows
from coaxlink.data.logs.esc_readings import measured_escs
from coaxlink.data.logs.outputs import (
    PX4_MOTOR_1,
    PX4_MOTORS,
    Map,
    Parameters,
    commands,
    motors_of_escs,
    px4_maps,
    px4_outputs,
)
from coaxlink.data.logs.streams import Array, Message, TimeSeries, derived, euler_of, merge, possible, series
from coaxlink.data.logs.stretches import each_stretch
from coaxlink.data.logs.ulog_chain import Chain, chain
from coaxlink.data.quiet import one_line, silenced
from coaxlink.data.samples import DAMAGED, OUTPUTS_AS_MOTORS, PREMISES, Samples
from coaxlink.errors import InputError
from firmware_params import bounded

STAMPED_BY_SAMPLE = ("vehicle_acceleration", "vehicle_angular_velocity", "vehicle_attitude")
TOPICS = [
    *STAMPED_BY_SAMPLE, "actuator_motors", "actuator_outputs", "sensor_combined", "vehicle_local_position",
    "distance_sensor", "battery_status", "esc_status", "vehicle_status", "vehicle_land_detected", *DEMANDS,
]  # fmt: skip
CIRCLES = 20  # steps back to where the reader was before; looking for a sync mark takes one or two
ARMED, DOWNWARD = 2, 25  # of arming_state; ROTATION_DOWNWARD_FACING
VELOCITY = {"vel_n_m_s": "vx", "vel_e_m_s": "vy", "vel_d_m_s": "vz"}


def read_ulog(path: Path) -> list[Samples]:
    """Every flight of a PX4 log as flight columns. Raises InputError."""
    found = _chain(path)
    return each_stretch(str(path), found.parts, lambda part: _flight(path, _open(path, part), found.torn))


def _flight(path: Path, log: Any, torn: bool) -> Samples:
    instances: dict[str, list[Message]] = {}
    for topic in sorted(log.data_list, key=lambda d: d.multi_id):
        instances.setdefault(topic.name, []).append(_message(topic.name, topic.data))
    topics = {name: _chosen(name, found) for name, found in instances.items()}
    outputs, escs = (instances.get(name, []) for name in ("actuator_outputs", "esc_status"))
    notes: list[str] = []
    parameters = _parameters(log)
    premises = [DAMAGED] * _is_damaged(log, torn)
    maps = px4_maps(parameters)
    motors = read_in_periods(
        periods(_numbers(log.initial_parameters), _changes(log)),
        lambda held, reported, taken: _motors(
            held.of(topics.get("actuator_motors")),
            {name: held.of(topics.get(name)) for name in DEMANDS},
            [rows for one in outputs if (rows := held.of(one))],
            held.parameters,
            reported,
            taken,
        ),
        notes,
        premises,
    )
    measured = [
        *_motion(topics),
        derived(topics.get("vehicle_attitude"), lambda m: euler_of([m[f"q[{i}]"] for i in range(4)])),
        series(topics.get("vehicle_local_position"), VELOCITY),
        _height(topics, notes),
        series(topics.get("battery_status"), {"voltage_V": "voltage_v"}),
        derived(topics.get("vehicle_status"), lambda m: {"armed": m["arming_state"] == ARMED}),
        series(topics.get("vehicle_land_detected"), {"landed": "landed"}),
        *_rpm(escs, maps, notes, premises),
    ]
    samples = merge(str(path), motors, possible(measured, premises), notes).on_premises(*premises)
    reported = ((m.timestamp / 1e6, m.log_level - ord("0"), str(m.message)) for m in log.logged_messages)
    return replace(
        samples,
        motors=_motors_of(motors, maps, "actuator_motors" in topics),
        parameters=parameters,
        texts=tuple(sorted(reported, key=lambda row: row[0])),
    )


def ulog_parameters(path: Path, *, whole: bool = False) -> dict[str, float | int]:
    """The parameters a PX4 log begins with, of several logs in one file those of the last.

    Raises InputError, with `whole` for a damaged log too.
    """
    found = _chain(path)
    log = _open(path, found.parts[-1])
    if whole and _is_damaged(log, found.torn):
        raise InputError(path, "", PREMISES[DAMAGED])
    return _numbers(log.initial_parameters)


def _parameters(log: Any) -> dict[str, float]:
    """As they were at take-off: what the log begins with, and what was set before it was first armed.

    A table may be uploaded and flown in one boot; what is set in the air is not this flight's beginning.
    """
    armed = [
        topic.data["timestamp"][topic.data["arming_state"] == ARMED]
        for topic in log.data_list
        if topic.name == "vehicle_status" and "arming_state" in topic.data
    ]
    first = min((int(stamps[0]) for stamps in armed if len(stamps)), default=None)
    found = _numbers(log.initial_parameters)
    later = {name: value for stamp, name, value in log.changed_parameters if first is None or stamp <= first}
    return found | _numbers(later)


def _changes(log: Any) -> list[Change]:
    """What was set after the log began."""
    return [
        (stamp / 1e6, name, float(value))
        for stamp, name, value in log.changed_parameters
        if _numbers({name: value})
    ]


def _numbers(parameters: Mapping[str, Any]) -> dict[str, float]:
    """Those that are finite numbers: of a damaged log some are bytes of no known type."""
    return {n: v for n, v in parameters.items() if isinstance(v, (int, float)) and math.isfinite(v)}


def _message(name: str, topic: Mapping[str, Any]) -> Message:
    """A topic with its stamps in s, all in 64 bit; what is no number in a damaged log becomes NaN."""
    by_sample = name in STAMPED_BY_SAMPLE and "timestamp_sample" in topic
    with np.errstate(invalid="ignore"):
        fields = {field: np.asarray(values, np.float64) for field, values in topic.items()}
    return fields | {"time_s": np.asarray(topic["timestamp_sample" if by_sample else "timestamp"]) / 1e6}


def _chosen(name: str, instances: list[Message]) -> Message:
    """The instance in use, else the first: the pack that is connected, the range finder that looks down."""
    if name == "battery_status":
        return next((m for m in instances if np.nanmax(m.get("voltage_v", np.zeros(1))) > 0.0), instances[0])
    if name == "distance_sensor":
        down = (m for m in instances if np.any(m.get("orientation", np.full(1, DOWNWARD)) == DOWNWARD))
        return next(down, instances[0])
    return instances[0]


def _chain(path: Path) -> Chain:
    return chain(path, files.read_bytes(path, bounded.LOG))


def _open(path: Path, part: bytes) -> Any:
    from pyulog import ULog

    try:
        with _Onward(io.BytesIO(part)) as stream, silenced():
            log = ULog(stream, TOPICS, disable_str_exceptions=True)
    except Exception as error:  # pyulog lets whatever a damaged file causes through
        raise InputError(path, "", f"not a readable ULog file ({one_line(error)})") from error
    return log


def _is_damaged(log: Any, torn: bool) -> bool:
    spoiled = len(_numbers(log.initial_parameters)) < len(log.initial_parameters)
    return torn or spoiled or bool(log.file_corruption)


class _Onward(io.BufferedReader):
    """A file whose reader must get on. pyulog steps back and tries again a byte further on where a message
    makes no sense; from a message that the end of the file cuts it steps too far, and comes by for ever."""

    _furthest = _circles = 0

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """As of any file. Raises EOFError after CIRCLES steps back none of which led further on."""
        position = super().seek(offset, whence)
        if whence == os.SEEK_SET or position > self._furthest:
            self._furthest, self._circles = position, 0
        else:
            self._circles += 1
            if self._circles > CIRCLES:
                raise EOFError("its messages lead in a circle")
        return position


def _motors(
    controls: Message | None,
    demands: Mapping[str, Message | None],
    outputs: list[Message],
    parameters: Parameters,
    notes: list[str],
    premises: list[str],
) -> TimeSeries | None:
    if controls is not None:
        return _from_controls(controls, demands, parameters, notes)
    instances = [
        {n: topic[f"output[{n - 1}]"] for n in range(1, 17) if f"output[{n - 1}]" in topic}
        for topic in outputs
    ]
    found, known = px4_outputs(instances, parameters)
    if found and not known:
        premises.append(OUTPUTS_AS_MOTORS)
    columns: dict[str, Array] = {}
    first = outputs[found[0][1]]["time_s"] if found else np.zeros(0)
    for driver, instance in found:  # drivers of one vehicle publish at one rate
        time = outputs[instance]["time_s"]
        for name, command in commands(driver, instances[instance], "actuator_outputs", notes).items():
            columns[name] = command if time is first else np.interp(first, time, command)
    return TimeSeries.of(first, columns)


def _motors_of(motors: TimeSeries | None, maps: list[Map], commanded: bool) -> tuple[int, ...]:
    """The vehicle's motors: as many as the allocation commands, else as *_FUNCn say."""
    if commanded and motors is not None:
        return tuple(range(1, len(motors.columns) + 1))
    return tuple(sorted({o.motor for outputs in maps for o in outputs}))


def _from_controls(
    topic: Message, demands: Mapping[str, Message | None], parameters: Mapping[str, Any], notes: list[str]
) -> TimeSeries | None:
    factor = float(parameters.get("THR_MDL_FAC", 0.0))
    control = np.nan_to_num(np.stack([topic[f"control[{i}]"] for i in range(12)]))
    used = np.flatnonzero((control != 0).any(axis=1))
    count = int(parameters.get("CA_ROTOR_COUNT", 0)) or (int(used[-1]) + 1 if len(used) else 0)
    commands = np.clip(control[:count], 0, 1)
    notes.append(f"motor1..{count} from actuator_motors, THR_MDL_FAC = {factor:g} undone")
    found = TimeSeries.of(topic["time_s"], {f"motor{i + 1}": commands[i] for i in range(count)})
    if found is None:
        return None
    if (closer := between_rows(found, demands)) is not None:
        notes.append(f"{_hz(found)} commands a second: between them by the {_hz(closer)} demands a second")
        found = closer
    if factor <= 0:
        return found
    linear = 1 - factor  # control = factor u^2 + (1 - factor) u
    return replace(
        found,
        columns={
            n: (np.sqrt(linear**2 + 4 * factor * c) - linear) / (2 * factor) for n, c in found.columns.items()
        },
    )


def _hz(series_: TimeSeries) -> str:
    return f"{1.0 / series_.period_s:.0f}"


def _motion(topics: Mapping[str, Message]) -> list[TimeSeries | None]:
    """Accelerations and rates, filtered where logged, else raw."""
    combined = topics.get("sensor_combined")
    found = []
    for name, topic, raw in (
        ("accel_{}_m_s2", "vehicle_acceleration", "accelerometer_m_s2"),
        ("gyro_{}_rad_s", "vehicle_angular_velocity", "gyro_rad"),
    ):
        columns = {name.format(axis): f"xyz[{i}]" for i, axis in enumerate("xyz")}
        in_raw = {ours: theirs.replace("xyz", raw) for ours, theirs in columns.items()}
        found.append(series(topics.get(topic), columns) or series(combined, in_raw))
    return found


def _height(topics: Mapping[str, Message], notes: list[str]) -> TimeSeries | None:
    """Height above ground: the estimator's terrain distance, the range finder, or its z as a last resort."""
    local, ranger = topics.get("vehicle_local_position"), topics.get("distance_sensor")
    if local is not None and "dist_bottom" in local and np.any(local["dist_bottom_valid"]):
        valid = local["dist_bottom_valid"] != 0
        bottom, above = local["dist_bottom"], -local["z"]
        if not valid.all():
            notes.append(
                f"height_m from the estimator's z, level ground, in {(~valid).mean():.0%} of the log"
            )
        # the estimator's z has an offset of its own: take it from where both are known
        height = np.where(valid, bottom, above + np.median((bottom - above)[valid]))
        return TimeSeries.of(local["time_s"], {"height_m": height})
    if ranger is not None:
        return series(ranger, {"height_m": "current_distance"})
    if local is not None:
        notes.append("height_m from the estimator's z above its origin: no distance to the ground logged")
    return series(local, {"height_m": "z"}, -1.0)


def _rpm(
    topics: list[Message], maps: list[Map], notes: list[str], premises: list[str]
) -> list[TimeSeries | None]:
    found = []
    for topic in topics:
        rpm = [topic[f"esc[{i}].esc_rpm"] for i in range(PX4_MOTORS) if f"esc[{i}].esc_rpm" in topic]
        rpm = rpm[: int(np.max(topic["esc_count"]))]
        if len(rpm) == 8 and np.any(rpm[0]) and all(np.array_equal(rpm[i], rpm[i + 4]) for i in range(4)):
            notes.append("rpm5..8 left out: esc_status repeats rotors 1-4 there")
            rpm = rpm[:4]
        motors = _functions(topic, len(rpm))
        if not motors:  # before 1.13: ESCs are numbered as their driver's outputs
            driver = maps[0] if len(maps) == 1 else ()
            motors = motors_of_escs(driver, range(len(rpm)), notes, premises)
        for esc, motor in motors.items():
            columns = {f"rpm{motor}": rpm[esc]}
            for ours, theirs in (("current{}_A", "current"), ("temperature{}_C", "temperature")):
                if np.any(values := topic.get(f"esc[{esc}].esc_{theirs}", np.zeros(1))):
                    columns[ours.format(motor)] = values
            online = _online(topic, esc)
            if not online.all():
                notes.append(f"rpm{motor}: ESC {esc} is offline in {np.mean(~online):.0%} of esc_status")
            found.append(TimeSeries.of(topic["time_s"][online], {n: c[online] for n, c in columns.items()}))
    return measured_escs(found, notes)


def _online(topic: Message, esc: int) -> NDArray[np.bool_]:
    """(n,) whether `esc_online_flags` have an ESC's bit: without it the driver repeats what it last heard.

    A driver that never sets the bit of an ESC whose speed moves does not keep the flags.
    """
    flags = np.nan_to_num(topic.get("esc_online_flags", np.zeros(1))).astype(np.int64)
    online = (flags >> esc) & 1 == 1
    return online if online.any() else np.ones(len(topic["time_s"]), bool)


def _functions(topic: Message, count: int) -> dict[int, int]:
    """{ESC, counted from 0: motor} as `esc_status` itself says."""
    found = {}
    for i in range(count):
        function = topic.get(f"esc[{i}].actuator_function", np.zeros(1))
        last = int(np.nan_to_num(function[-1]))
        if PX4_MOTOR_1 <= last < PX4_MOTOR_1 + PX4_MOTORS:
            found[i] = last - PX4_MOTOR_1 + 1
    return found
