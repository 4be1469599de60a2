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
from numpy.typing import NDArray

from coaxlink.data.logs.quiet import one_line, silenced
from coaxlink.data.logs.streams import Stream, merge
from coaxlink.data.samples import Samples
from coaxlink.errors import InputError

TYPES = [
    "MOUT",
    "RCOU",
    "IMU",
    "XKF1",
    "XKF2",
    "XKF4",
    "NKF1",
    "ATT",
    "BAT",
    "CURR",
    "RFND",
    "ESC",
    "EV",
    "ARM",
]
MOST_LOST = 20_000  # messages that cannot be read; a torn log loses some, a card's bad block some hundred
FIRST_MOTOR_FUNCTION = 33
EVENT_ARMED, EVENT_DISARMED, EVENT_LANDED, EVENT_AIRBORNE = 10, 11, 18, 28
Rows = dict[str, NDArray[np.float64]]  # field: (n,)


def read_dataflash(path: Path) -> Samples:
    """An ArduPilot log as flight columns. Raises InputError."""
    messages, parameters = _messages(path)
    notes: list[str] = []
    estimate = _core(messages, "XKF1") or messages.get("NKF1")
    velocity = {"vel_n_m_s": "VN", "vel_e_m_s": "VE", "vel_d_m_s": "VD"}
    streams = [
        _imu(messages, notes),
        _attitude(estimate, messages.get("ATT")),
        _fields(estimate, velocity) if estimate else None,
        _height(messages, estimate, notes),
        _fields(
            _first(messages.get("BAT"), ("Instance", "Inst", "I")) or messages.get("CURR"),
            {"voltage_V": "Volt"},
        ),
        *_rpm(messages.get("ESC")),
        _switch(messages, "armed", EVENT_ARMED, EVENT_DISARMED),
        _switch(messages, "landed", EVENT_LANDED, EVENT_AIRBORNE),
    ]
    return merge(str(path), _motors(messages, parameters, notes), streams, notes)


def dataflash_parameters(path: Path) -> dict[str, float]:
    """The parameters an ArduPilot log holds, the last value of each. Raises InputError."""
    return _messages(path, ())[1]


def dataflash_texts(path: Path) -> list[tuple[float, str]]:
    """(time_s, text) of what ArduPilot logged in words, in order. Raises InputError."""
    found, _ = _read(path, ("MSG",))
    return [(m.TimeUS / 1e6, str(m.Message)) for m in found.get("MSG", ())]


def _messages(path: Path, types: Sequence[str] = TYPES) -> tuple[dict[str, Rows], dict[str, float]]:
    found, parameters = _read(path, types)
    rows = {}
    for name, messages in found.items():
        fields = [
            f for f in messages[0].get_fieldnames() if not isinstance(getattr(messages[0], f), (str, bytes))
        ]
        rows[name] = {f: np.array([getattr(m, f) for m in messages], float) for f in fields}
    return rows, parameters


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
    from pymavlink import DFReader

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


def _first(rows: Rows | None, keys: tuple[str, ...], wanted: float = 0) -> Rows | None:
    """The rows of one instance, where the message has several."""
    key = next((k for k in keys if rows and k in rows), None)
    if rows is None or key is None:
        return rows
    mask = rows[key] == wanted
    return {f: column[mask] for f, column in rows.items()} if mask.any() else None


def _core(messages: Mapping[str, Rows], name: str) -> Rows | None:
    """The rows of the estimator's core in use (the one most often primary)."""
    primary = 0.0
    if "XKF4" in messages and "PI" in messages["XKF4"]:
        primary = Counter(messages["XKF4"]["PI"].tolist()).most_common(1)[0][0]
    return _first(messages.get(name), ("C",), primary)


def _fields(rows: Rows | None, fields: Mapping[str, str], factor: float = 1.0) -> Stream | None:
    if rows is None or any(f not in rows for f in fields.values()):
        return None
    return Stream.of(rows["TimeUS"] / 1e6, {name: factor * rows[f] for name, f in fields.items()})


def _motors(messages: Mapping[str, Rows], parameters: Mapping[str, float], notes: list[str]) -> Stream | None:
    low, high = (
        parameters.get("MOT_PWM_MIN", 1000.0) or 1000.0,
        parameters.get("MOT_PWM_MAX", 2000.0) or 2000.0,
    )
    outputs, scripted = messages.get("RCOU"), messages.get("MOUT")
    if scripted is not None:
        channels = {n: f"M{n}" for n in range(1, 13) if f"M{n}" in scripted}
        source, rows = "MOUT", scripted
    elif outputs is not None:
        channels = {
            int(parameters.get(f"SERVO{c}_FUNCTION", 0)) - FIRST_MOTOR_FUNCTION + 1: f"C{c}"
            for c in range(1, 15)
            if FIRST_MOTOR_FUNCTION <= parameters.get(f"SERVO{c}_FUNCTION", 0) < FIRST_MOTOR_FUNCTION + 8
        }
        if not channels:  # firmware of before 2016: motors are the first outputs
            used = [c for c in range(1, 9) if f"C{c}" in outputs and (outputs[f"C{c}"] >= 800).any()]
            channels = {c: f"C{c}" for c in used}
        source, rows = "RCOU", outputs
    else:
        return None
    notes.append(f"motor1..{len(channels)} = (PWM - {low:g}) / {high - low:g} from {source}")
    columns = {
        f"motor{n}": np.clip((rows[c] - low) / (high - low), 0, 1) for n, c in sorted(channels.items())
    }
    return Stream.of(rows["TimeUS"] / 1e6, columns) if columns else None


def _imu(messages: Mapping[str, Rows], notes: list[str]) -> Stream | None:
    imu = _first(messages.get("IMU"), ("I",))
    if imu is None:
        return None
    time = imu["TimeUS"] / 1e6
    columns = {f"gyro_{a.lower()}_rad_s": imu[f"Gyr{a}"] for a in "XYZ"}
    columns |= {f"accel_{a.lower()}_m_s2": imu[f"Acc{a}"] for a in "XYZ"}
    bias = _core(messages, "XKF2")
    if bias is not None and all(f"A{a}" in bias for a in "XYZ"):
        for a in "XYZ":
            name = f"accel_{a.lower()}_m_s2"
            columns[name] = columns[name] - np.interp(time, bias["TimeUS"] / 1e6, bias[f"A{a}"])
        notes.append("accelerations less the estimator's bias (XKF2)")
    return Stream.of(time, columns)


def _attitude(estimate: Rows | None, att: Rows | None) -> Stream | None:
    rows = max((r for r in (estimate, att) if r), key=lambda r: len(r["TimeUS"]), default=None)
    names = {"roll_rad": "Roll", "pitch_rad": "Pitch", "yaw_rad": "Yaw"}
    return _fields(rows, names, np.pi / 180)


def _height(messages: Mapping[str, Rows], estimate: Rows | None, notes: list[str]) -> Stream | None:
    ranger = _first(messages.get("RFND"), ("Instance", "I"))
    for field in ("Dist", "Dist1"):
        if ranger is not None and field in ranger and np.any(ranger[field] > 0):
            return _fields(ranger, {"height_m": field})
    notes.append("height_m from the estimator's position above its origin: no range finder logged")
    return _fields(estimate, {"height_m": "PD"}, -1.0) if estimate else None


def _rpm(rows: Rows | None) -> list[Stream | None]:
    streams = []
    for instance in sorted(set(rows.get("Instance", np.empty(0)).tolist())) if rows else []:
        streams.append(_fields(_first(rows, ("Instance",), instance), {f"rpm{int(instance) + 1}": "RPM"}))
    return streams


def _switch(messages: Mapping[str, Rows], name: str, on: int, off: int) -> Stream | None:
    """A state that two events turn on and off; before the first event it was the other one."""
    events = messages.get("EV")
    if events is None:
        return None
    mask = np.isin(events["Id"], (on, off))
    states = (events["Id"][mask] == on).astype(float)
    if not len(states):
        return None
    time = np.concatenate([[0.0], events["TimeUS"][mask] / 1e6])
    return Stream.of(time, {name: np.concatenate([[1.0 - states[0]], states])})
