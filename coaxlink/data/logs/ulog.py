"""ULog of PX4 as flight columns.

`actuator_motors` holds the command before the thrust curve of THR_MDL_FAC, `actuator_outputs` (1000 + 1000 u)
the one after it; the faster of the two is used. Sensor topics are stamped by `timestamp_sample`.
"""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from coaxlink.data.logs.outputs import commands, px4_outputs, used_outputs
from coaxlink.data.logs.quiet import one_line, silenced
from coaxlink.data.logs.streams import Message, TimeSeries, derived, euler_of, merge, series
from coaxlink.data.samples import DAMAGED, Samples
from coaxlink.errors import InputError

STAMPED_BY_SAMPLE = ("vehicle_acceleration", "vehicle_angular_velocity", "vehicle_attitude")
TOPICS = [
    *STAMPED_BY_SAMPLE, "actuator_motors", "actuator_outputs", "sensor_combined", "vehicle_local_position",
    "distance_sensor", "battery_status", "esc_status", "vehicle_status", "vehicle_land_detected",
]  # fmt: skip
CIRCLES = 20  # steps back to where the reader was before; looking for a sync mark takes one or two
ARMED = 2
VELOCITY = {"vel_n_m_s": "vx", "vel_e_m_s": "vy", "vel_d_m_s": "vz"}


def read_ulog(path: Path) -> Samples:
    """A PX4 log as flight columns. Raises InputError."""
    log = _open(path)
    topics = {d.name: _message(d.name, d.data) for d in reversed(log.data_list)}  # the first instance wins
    notes: list[str] = []
    measured = [
        *_motion(topics),
        derived(topics.get("vehicle_attitude"), lambda m: euler_of([m[f"q[{i}]"] for i in range(4)])),
        series(topics.get("vehicle_local_position"), VELOCITY),
        _height(topics, notes),
        series(topics.get("battery_status"), {"voltage_V": "voltage_v"}),
        derived(topics.get("vehicle_status"), lambda m: {"armed": m["arming_state"] == ARMED}),
        series(topics.get("vehicle_land_detected"), {"landed": "landed"}),
        _rpm(topics.get("esc_status"), notes),
    ]
    samples = merge(str(path), _motors(topics, log.initial_parameters, notes), measured, notes)
    return samples.on_premises(*[DAMAGED] * bool(log.file_corruption))


def ulog_parameters(path: Path) -> dict[str, float | int]:
    """The parameters a PX4 log begins with. Raises InputError."""
    return dict(_open(path).initial_parameters)


def ulog_texts(path: Path) -> list[tuple[float, int, str]]:
    """(time_s, severity 0..7, text) of what PX4 logged in words, in order. Raises InputError."""
    found = [(m.timestamp / 1e6, m.log_level - ord("0"), str(m.message)) for m in _open(path).logged_messages]
    return sorted(found, key=lambda row: row[0])


def _message(name: str, topic: Mapping[str, Any]) -> Message:
    """A topic with its stamps in s, all in 64 bit; what is no number in a damaged log becomes NaN."""
    by_sample = name in STAMPED_BY_SAMPLE and "timestamp_sample" in topic
    with np.errstate(invalid="ignore"):
        fields = {field: np.asarray(values, np.float64) for field, values in topic.items()}
    return fields | {"time_s": np.asarray(topic["timestamp_sample" if by_sample else "timestamp"]) / 1e6}


def _open(path: Path) -> Any:
    from pyulog import ULog

    try:
        with path.open("rb", buffering=0) as raw, _Onward(raw) as stream, silenced():
            log = ULog(stream, TOPICS, disable_str_exceptions=True)
    except Exception as error:  # pyulog lets whatever a damaged file causes through
        raise InputError(path, "", f"not a readable ULog file ({one_line(error)})") from error
    return log


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
    topics: Mapping[str, Message], parameters: Mapping[str, Any], notes: list[str]
) -> TimeSeries | None:
    controls, outputs = topics.get("actuator_motors"), topics.get("actuator_outputs")
    if controls is not None and (outputs is None or len(controls["time_s"]) >= len(outputs["time_s"])):
        return _from_controls(controls, parameters, notes)
    return None if outputs is None else _from_outputs(outputs, parameters, notes)


def _from_controls(topic: Message, parameters: Mapping[str, Any], notes: list[str]) -> TimeSeries | None:
    factor = float(parameters.get("THR_MDL_FAC", 0.0))
    control = np.nan_to_num(np.stack([topic[f"control[{i}]"] for i in range(12)]))
    used = np.flatnonzero((control != 0).any(axis=1))
    count = int(parameters.get("CA_ROTOR_COUNT", 0)) or (int(used[-1]) + 1 if len(used) else 0)
    speed = np.clip(control[:count], 0, 1)
    if factor > 0:  # control = factor u^2 + (1 - factor) u
        linear = 1 - factor
        speed = (np.sqrt(linear**2 + 4 * factor * speed) - linear) / (2 * factor)
    notes.append(f"motor1..{count} from actuator_motors, THR_MDL_FAC = {factor:g} undone")
    return TimeSeries.of(topic["time_s"], {f"motor{i + 1}": speed[i] for i in range(count)})


def _from_outputs(topic: Message, parameters: Mapping[str, Any], notes: list[str]) -> TimeSeries | None:
    pulses = {n: topic[f"output[{n - 1}]"] for n in range(1, 17)}
    outputs = px4_outputs(parameters) or {n: n for n in used_outputs(pulses)}
    notes.append(f"motor1..{len(outputs)} = (PWM - 1000) / 1000 from actuator_outputs")
    return TimeSeries.of(topic["time_s"], commands(outputs, pulses))


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


def _rpm(topic: Message | None, notes: list[str]) -> TimeSeries | None:
    if topic is None:
        return None
    rpm = [topic[f"esc[{i}].esc_rpm"] for i in range(8) if f"esc[{i}].esc_rpm" in topic]
    rpm = rpm[: int(np.max(topic["esc_count"]))]
    if len(rpm) == 8 and np.any(rpm[0]) and all(np.array_equal(rpm[i], rpm[i + 4]) for i in range(4)):
        notes.append("rpm5..8 left out: esc_status repeats rotors 1-4 there")
        rpm = rpm[:4]
    return TimeSeries.of(topic["time_s"], {f"rpm{i + 1}": column for i, column in enumerate(rpm)})
