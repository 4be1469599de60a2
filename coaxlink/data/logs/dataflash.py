"""DataFlash logs of ArduPilot as flight columns.

Motors from MOUT (a script's faster copy of the outputs) or RCOU; accelerations of the IMU in use less the
estimator's bias (XKF2), since ArduPilot logs them raw.
"""

from __future__ import annotations

import contextlib
import functools
import struct
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from coaxlink.data.logs.outputs import ardupilot_outputs, commands, used_outputs
from coaxlink.data.logs.quiet import one_line, silenced
from coaxlink.data.logs.streams import Message, TimeSeries, longest, merge, rows_of, series
from coaxlink.data.samples import Samples
from coaxlink.errors import InputError

TYPES = (
    "MOUT", "RCOU", "IMU", "XKF1", "XKF2", "XKF4", "NKF1", "ATT", "BAT", "CURR", "RFND", "ESC", "EV", "ARM",
)  # fmt: skip
MOST_LOST = 20_000  # messages that cannot be read; a torn log loses some, a card's bad block some hundred
EVENT_ARMED, EVENT_DISARMED, EVENT_LANDED, EVENT_AIRBORNE = 10, 11, 18, 28
INSTANCE = ("Instance", "Inst", "I")  # what the number of a sensor is called, over the years


def read_dataflash(path: Path) -> Samples:
    """An ArduPilot log as flight columns. Raises InputError."""
    found, parameters = _read(path, TYPES)
    messages = {name: message for name, rows in found.items() if (message := _message(rows)) is not None}
    notes: list[str] = []
    estimate = _core(messages, "XKF1") or messages.get("NKF1")
    attitude = longest(estimate, messages.get("ATT"))
    battery = _instance(messages.get("BAT"), INSTANCE) or messages.get("CURR")
    measured = [
        _imu(messages, notes),
        series(attitude, {"roll_rad": "Roll", "pitch_rad": "Pitch", "yaw_rad": "Yaw"}, np.pi / 180),
        series(estimate, {"vel_n_m_s": "VN", "vel_e_m_s": "VE", "vel_d_m_s": "VD"}),
        _height(messages, estimate, notes),
        series(battery, {"voltage_V": "Volt"}),
        *_rpm(messages.get("ESC")),
        _switch(messages.get("EV"), "armed", EVENT_ARMED, EVENT_DISARMED),
        _switch(messages.get("EV"), "landed", EVENT_LANDED, EVENT_AIRBORNE),
    ]
    return merge(str(path), _motors(messages, parameters, notes), measured, notes)


def dataflash_parameters(path: Path) -> dict[str, float]:
    """The parameters an ArduPilot log holds, the last value of each. Raises InputError."""
    return _read(path, ())[1]


def dataflash_texts(path: Path) -> list[tuple[float, str]]:
    """(time_s, text) of what ArduPilot logged in words, in order. Raises InputError."""
    found, _ = _read(path, ("MSG",))
    return [(m.TimeUS / 1e6, str(m.Message)) for m in found.get("MSG", ())]


def _message(rows: list[Any]) -> Message | None:
    """The numeric fields of all messages of one kind; None where they have no stamps."""
    fields = [f for f in rows[0].get_fieldnames() if not isinstance(getattr(rows[0], f), (str, bytes))]
    columns = {f: np.array([getattr(m, f) for m in rows], float) for f in fields}
    return columns | {"time_s": columns["TimeUS"] / 1e6} if "TimeUS" in columns else None


def _read(path: Path, types: Sequence[str]) -> tuple[dict[str, list[Any]], dict[str, float]]:
    """The messages of these types by name, and the last value of each parameter. Raises InputError."""
    found: dict[str, list[Any]] = {}
    parameters: dict[str, float] = {}
    kind = _reader_class()
    reader = kind.__new__(kind)  # to close what a failing start opened
    try:
        with silenced():
            reader.__init__(str(path), zero_time_base=True)
            for number, form in reader.formats.items():
                if struct.calcsize(form.msg_struct) != form.len - 3:  # none can be read
                    reader.counts[number] = 0
            while (message := reader.recv_match(type=[*types, "PARM"])) is not None:
                if message.get_type() == "PARM":
                    parameters[message.Name] = message.Value
                else:
                    found.setdefault(message.get_type(), []).append(message)
    except Exception as error:  # pymavlink raises bare Exception on a torn format message
        raise InputError(path, "", f"not a readable DataFlash log ({one_line(error)})") from error
    finally:
        for name in ("data_map", "filehandle"):
            with contextlib.suppress(AttributeError, BufferError):  # not opened; still looked at by an error
                getattr(reader, name).close()
    return found, parameters


@functools.cache
def _reader_class() -> Any:
    from pymavlink import DFReader  # here and below: pymavlink and pyulog for binary logs alone

    class Reader(DFReader.DFReader_binary):
        """pymavlink looks for the next message it can read from each that it cannot, to the log's end: with
        a format that was damaged on the way that is the square of a log."""

        _deep = _lost = 0

        def _parse_next(self) -> Any:
            self._lost += self._deep > 0
            if self._lost > MOST_LOST:
                raise ValueError(f"more than {MOST_LOST} messages make no sense")
            self._deep += 1
            try:
                return super()._parse_next()
            finally:
                self._deep -= 1

    return Reader


def _instance(message: Message | None, keys: Sequence[str], wanted: float = 0) -> Message | None:
    """The rows of one instance, where the message has several."""
    key = next((k for k in keys if message and k in message), None)
    return message if message is None or key is None else rows_of(message, message[key] == wanted)


def _core(messages: Mapping[str, Message], name: str) -> Message | None:
    """The rows of the estimator's core in use (the one most often primary)."""
    primary = 0.0
    if "XKF4" in messages and "PI" in messages["XKF4"]:
        primary = Counter(messages["XKF4"]["PI"].tolist()).most_common(1)[0][0]
    return _instance(messages.get(name), ("C",), primary)


def _motors(
    messages: Mapping[str, Message], parameters: Mapping[str, float], notes: list[str]
) -> TimeSeries | None:
    low = parameters.get("MOT_PWM_MIN", 1000.0) or 1000.0
    high = parameters.get("MOT_PWM_MAX", 2000.0) or 2000.0
    source, letter = ("MOUT", "M") if "MOUT" in messages else ("RCOU", "C")
    if source not in messages:
        return None
    logged = messages[source]
    pulses = {n: logged[f"{letter}{n}"] for n in range(1, 15) if f"{letter}{n}" in logged}
    if source == "MOUT":
        outputs = {n: n for n in pulses if n <= 12}
    else:
        outputs = ardupilot_outputs(parameters) or {n: n for n in used_outputs(pulses) if n <= 8}
    notes.append(f"motor1..{len(outputs)} = (PWM - {low:g}) / {high - low:g} from {source}")
    return TimeSeries.of(logged["time_s"], commands(outputs, pulses, low, high))


def _imu(messages: Mapping[str, Message], notes: list[str]) -> TimeSeries | None:
    imu = _instance(messages.get("IMU"), ("I",))
    if imu is None:
        return None
    columns = {f"gyro_{a.lower()}_rad_s": imu[f"Gyr{a}"] for a in "XYZ"}
    columns |= {f"accel_{a.lower()}_m_s2": imu[f"Acc{a}"] for a in "XYZ"}
    bias = _core(messages, "XKF2")
    if bias is not None and all(f"A{a}" in bias for a in "XYZ"):
        for a in "XYZ":
            name = f"accel_{a.lower()}_m_s2"
            columns[name] = columns[name] - np.interp(imu["time_s"], bias["time_s"], bias[f"A{a}"])
        notes.append("accelerations less the estimator's bias (XKF2)")
    return TimeSeries.of(imu["time_s"], columns)


def _height(messages: Mapping[str, Message], estimate: Message | None, notes: list[str]) -> TimeSeries | None:
    ranger = _instance(messages.get("RFND"), ("Instance", "I"))
    for field in ("Dist", "Dist1"):
        if ranger is not None and field in ranger and np.any(ranger[field] > 0):
            return series(ranger, {"height_m": field})
    notes.append("height_m from the estimator's position above its origin: no range finder logged")
    return series(estimate, {"height_m": "PD"}, -1.0)


def _rpm(esc: Message | None) -> list[TimeSeries | None]:
    instances = sorted(set(esc["Instance"].tolist())) if esc and "Instance" in esc else []
    return [
        series(_instance(esc, ("Instance",), instance), {f"rpm{int(instance) + 1}": "RPM"})
        for instance in instances
    ]


def _switch(events: Message | None, name: str, on: int, off: int) -> TimeSeries | None:
    """A state that two events turn on and off; before the first event it was the other one."""
    of_state = None if events is None else rows_of(events, np.isin(events["Id"], (on, off)))
    if of_state is None:
        return None
    states = (of_state["Id"] == on).astype(float)
    time = np.concatenate([[0.0], of_state["time_s"]])
    return TimeSeries.of(time, {name: np.concatenate([[1.0 - states[0]], states])})
