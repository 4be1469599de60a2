"""ULog of PX4 as flight columns.

`actuator_motors` holds the command before the thrust curve of THR_MDL_FAC, `actuator_outputs` (1000 + 1000 u)
the one after it; the faster of the two is used. Sensor topics are stamped by `timestamp_sample`.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.logs.quiet import one_line, silenced
from coaxlink.data.logs.streams import Stream, euler_of, merge
from coaxlink.data.samples import Samples
from coaxlink.errors import InputError

TOPICS = [
    "actuator_motors",
    "actuator_outputs",
    "vehicle_acceleration",
    "vehicle_angular_velocity",
    "sensor_combined",
    "vehicle_attitude",
    "vehicle_local_position",
    "distance_sensor",
    "battery_status",
    "esc_status",
    "vehicle_status",
    "vehicle_land_detected",
]
CIRCLES = 20  # steps back to where the reader was before; looking for a sync mark takes one or two
ARMED = 2
FIRST_MOTOR_FUNCTION = 101
Topic = Mapping[str, NDArray[Any]]


def read_ulog(path: Path) -> Samples:
    """A PX4 log as flight columns. Raises InputError."""
    log = _open(path)
    topics: dict[str, Topic] = {d.name: d.data for d in reversed(log.data_list)}  # the first instance wins
    notes: list[str] = ["the file is damaged: some of it could not be read"] if log.file_corruption else []
    streams = [
        *_motion(topics),
        _attitude(topics.get("vehicle_attitude")),
        _plain(topics.get("vehicle_local_position"), {f"vel_{a}_m_s": f for a, f in _VELOCITY}),
        _height(topics, notes),
        _plain(topics.get("battery_status"), {"voltage_V": "voltage_v"}),
        _state(topics.get("vehicle_status"), "armed", lambda d: d["arming_state"] == ARMED),
        _state(topics.get("vehicle_land_detected"), "landed", lambda d: d["landed"]),
        _rpm(topics.get("esc_status"), notes),
    ]
    return merge(str(path), _motors(topics, log.initial_parameters, notes), streams, notes)


def ulog_parameters(path: Path) -> dict[str, float | int]:
    """The parameters a PX4 log begins with. Raises InputError."""
    return dict(_open(path).initial_parameters)


def ulog_texts(path: Path) -> list[tuple[float, int, str]]:
    """(time_s, severity 0..7, text) of what PX4 logged in words, in order. Raises InputError."""
    found = [(m.timestamp / 1e6, m.log_level - ord("0"), str(m.message)) for m in _open(path).logged_messages]
    return sorted(found, key=lambda row: row[0])


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


_VELOCITY = (("n", "vx"), ("e", "vy"), ("d", "vz"))


def _time(topic: Topic, sample: bool = False) -> NDArray[np.float64]:
    return (
        np.asarray(topic["timestamp_sample" if sample and "timestamp_sample" in topic else "timestamp"]) / 1e6
    )


def _float(values: NDArray[Any]) -> NDArray[np.float64]:
    """As 64 bit; what is no number in a damaged log becomes NaN, without a warning."""
    with np.errstate(invalid="ignore"):
        return np.asarray(values, np.float64)


def _plain(topic: Topic | None, fields: Mapping[str, str], sample: bool = False) -> Stream | None:
    if topic is None or any(field not in topic for field in fields.values()):
        return None
    columns = {name: _float(topic[field]) for name, field in fields.items()}
    return Stream.of(_time(topic, sample), columns)


def _state(topic: Topic | None, name: str, of: Any) -> Stream | None:
    return None if topic is None else Stream.of(_time(topic), {name: np.asarray(of(topic), float)})


def _motors(topics: Mapping[str, Topic], parameters: Mapping[str, Any], notes: list[str]) -> Stream | None:
    controls, outputs = topics.get("actuator_motors"), topics.get("actuator_outputs")
    if controls is not None and (outputs is None or len(controls["timestamp"]) >= len(outputs["timestamp"])):
        return _from_controls(controls, parameters, notes)
    return None if outputs is None else _from_outputs(outputs, parameters, notes)


def _from_controls(topic: Topic, parameters: Mapping[str, Any], notes: list[str]) -> Stream | None:
    factor = float(parameters.get("THR_MDL_FAC", 0.0))
    control = np.stack([_float(topic[f"control[{i}]"]) for i in range(12)])
    used = np.flatnonzero((np.nan_to_num(control) != 0).any(axis=1))
    count = int(parameters.get("CA_ROTOR_COUNT", 0)) or (int(used[-1]) + 1 if len(used) else 0)
    thrust = np.clip(np.nan_to_num(control[:count]), 0, 1)
    speed = thrust
    if factor > 0:  # control = factor u^2 + (1 - factor) u
        linear = 1 - factor
        speed = (np.sqrt(linear**2 + 4 * factor * thrust) - linear) / (2 * factor)
    notes.append(f"motor1..{count} from actuator_motors, THR_MDL_FAC = {factor:g} undone")
    return Stream.of(_time(topic), {f"motor{i + 1}": speed[i] for i in range(count)}) if count else None


def _from_outputs(topic: Topic, parameters: Mapping[str, Any], notes: list[str]) -> Stream | None:
    pwm = np.stack([_float(topic[f"output[{i}]"]) for i in range(16)])
    channel = {  # motor: output
        int(value) - FIRST_MOTOR_FUNCTION: int(match[1]) - 1
        for name, value in parameters.items()
        if (match := re.fullmatch(r"PWM_(?:MAIN|AUX)_FUNC(\d+)", name))
        and FIRST_MOTOR_FUNCTION <= value < FIRST_MOTOR_FUNCTION + 12
    }
    if not channel:  # firmware before 1.13: motors are the first outputs
        used = np.flatnonzero((pwm >= 800).any(axis=1))
        channel = {int(i): int(i) for i in used}
    notes.append(f"motor1..{len(channel)} = (PWM - 1000) / 1000 from actuator_outputs")
    columns = {f"motor{m + 1}": np.clip((pwm[c] - 1000) / 1000, 0, 1) for m, c in sorted(channel.items())}
    return Stream.of(_time(topic), columns) if columns else None


def _motion(topics: Mapping[str, Topic]) -> list[Stream | None]:
    combined = topics.get("sensor_combined")
    accel = _plain(
        topics.get("vehicle_acceleration"),
        {f"accel_{a}_m_s2": f"xyz[{i}]" for i, a in enumerate("xyz")},
        True,
    )
    gyro = _plain(
        topics.get("vehicle_angular_velocity"),
        {f"gyro_{a}_rad_s": f"xyz[{i}]" for i, a in enumerate("xyz")},
        True,
    )
    return [
        accel
        or _plain(combined, {f"accel_{a}_m_s2": f"accelerometer_m_s2[{i}]" for i, a in enumerate("xyz")}),
        gyro or _plain(combined, {f"gyro_{a}_rad_s": f"gyro_rad[{i}]" for i, a in enumerate("xyz")}),
    ]


def _attitude(topic: Topic | None) -> Stream | None:
    if topic is None:
        return None
    q = [_float(topic[f"q[{i}]"]) for i in range(4)]
    return Stream.of(_time(topic, sample=True), euler_of(*q))


def _height(topics: Mapping[str, Topic], notes: list[str]) -> Stream | None:
    """Height above ground: the estimator's terrain distance, the range finder, or its z as a last resort."""
    local, ranger = topics.get("vehicle_local_position"), topics.get("distance_sensor")
    if local is not None and "dist_bottom" in local and np.any(local["dist_bottom_valid"]):
        valid = np.asarray(local["dist_bottom_valid"]) != 0
        bottom, above = _float(local["dist_bottom"]), -_float(local["z"])
        if not valid.all():
            notes.append(
                f"height_m from the estimator's z, level ground, in {(~valid).mean():.0%} of the log"
            )
        # the estimator's z has an offset of its own: take it from where both are known
        height = np.where(valid, bottom, above + np.median((bottom - above)[valid]))
        return Stream.of(_time(local), {"height_m": height})
    if ranger is not None:
        return _plain(ranger, {"height_m": "current_distance"})
    if local is not None:
        notes.append("height_m from the estimator's z above its origin: no distance to the ground logged")
        return Stream.of(_time(local), {"height_m": -_float(local["z"])})
    return None


def _rpm(topic: Topic | None, notes: list[str]) -> Stream | None:
    if topic is None:
        return None
    rpm = [_float(topic[f"esc[{i}].esc_rpm"]) for i in range(8) if f"esc[{i}].esc_rpm" in topic]
    rpm = rpm[: int(np.max(topic["esc_count"]))]
    if len(rpm) == 8 and np.any(rpm[0]) and all(np.array_equal(rpm[i], rpm[i + 4]) for i in range(4)):
        notes.append("rpm5..8 left out: esc_status repeats rotors 1-4 there")
        rpm = rpm[:4]
    return Stream.of(_time(topic), {f"rpm{i + 1}": column for i, column in enumerate(rpm)}) if rpm else None
