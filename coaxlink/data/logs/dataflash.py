"""DataFlash logs of ArduPilot, binary or made text of, as flight columns.

Motors from MOUT (a script's faster copy of the outputs) or RCOU; accelerations of the IMU in use less the
estimator's bias (XKF2), since ArduPilot logs them raw.
"""

from __future__ import annotations

import contextlib
import functools
import struct
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from coaxlink.data.logs.changes import Change, periods, read_in_periods
from coaxlink.data.logs.dataflash_text import read_text
from coaxlink.data.logs.outputs import (
    ARDUPILOT_OUTPUTS,
    Map,
    ardupilot_map,
    as_motors,
    commands,
    motors_of_escs,
)
from coaxlink.data.logs.streams import Array, Message, TimeSeries, longest, merge, possible, rows_of, series
from coaxlink.data.quiet import one_line, silenced
from coaxlink.data.samples import DAMAGED, OUTPUTS_AS_MOTORS, PREMISES, Samples
from coaxlink.errors import InputError

TYPES = (
    "MOUT", "RCOU", "RCO2", "RCO3", "IMU", "XKF1", "XKF2", "XKF4", "NKF1", "ATT", "BAT", "CURR", "RFND",
    "ESC", "EV", "ARM",
)  # fmt: skip
OUTPUTS = ("MOUT", "RCOU", "RCO2", "RCO3")
MOST_LOST = 20_000  # messages that cannot be read; a torn log loses some, a card's bad block some hundred
TRAILING = 528  # bytes that may follow: pymavlink's own figure, twice the page of block-based logging
HEAD = b"\xa3\x95"  # of every message
EVENT_ARMED, EVENT_DISARMED, EVENT_LANDED, EVENT_AIRBORNE = 10, 11, 18, 28
INSTANCE = ("Instance", "Inst", "I")  # what the number of a sensor is called, over the years


def read_dataflash(path: Path) -> Samples:
    """An ArduPilot log as flight columns. Raises InputError."""
    found, damaged = _read(path, (*TYPES, "PARM"))
    first, changes = _set(found.pop("PARM", []))
    parameters = first | _before_arming(changes, found.get("EV", ()))
    messages = {name: message for name, rows in found.items() if (message := _message(rows)) is not None}
    notes: list[str] = []
    premises = [DAMAGED] * damaged
    outputs = ardupilot_map(parameters)
    motors = read_in_periods(
        periods(first, changes),
        lambda held, said, taken: _motors(
            {n: rows for n, m in messages.items() if n in OUTPUTS and (rows := held.of(m))},
            held.parameters,
            said,
            taken,
        ),
        notes,
        premises,
    )
    estimate = _core(messages, "XKF1") or messages.get("NKF1")
    attitude = longest(estimate, messages.get("ATT"))
    battery = _instance(messages.get("BAT"), INSTANCE) or messages.get("CURR")
    measured = [
        _imu(messages, notes),
        series(attitude, {"roll_rad": "Roll", "pitch_rad": "Pitch", "yaw_rad": "Yaw"}, np.pi / 180),
        series(estimate, {"vel_n_m_s": "VN", "vel_e_m_s": "VE", "vel_d_m_s": "VD"}),
        _height(messages, estimate, notes),
        series(battery, {"voltage_V": "Volt"}),
        *_rpm(messages.get("ESC"), outputs, notes, premises),
        _switch(messages.get("EV"), "armed", EVENT_ARMED, EVENT_DISARMED),
        _switch(messages.get("EV"), "landed", EVENT_LANDED, EVENT_AIRBORNE),
    ]
    samples = merge(str(path), motors, possible(measured, premises), notes).on_premises(*premises)
    return replace(samples, motors=tuple(o.motor for o in outputs), parameters=parameters)


def dataflash_parameters(path: Path, *, whole: bool = False) -> dict[str, float]:
    """The parameters an ArduPilot log holds, the last value of each.

    Raises InputError, with `whole` for a damaged log too.
    """
    found, damaged = _read(path, (*TYPES, "PARM") if whole else ("PARM",))
    if whole and damaged:
        raise InputError(path, "", PREMISES[DAMAGED])
    first, changes = _set(found.get("PARM", []))
    return first | {name: value for _, name, value in changes}


def dataflash_texts(path: Path) -> list[tuple[float, str]]:
    """(time_s, text) of what ArduPilot logged in words, in order. Raises InputError."""
    found, _ = _read(path, ("MSG",))
    return [(m.TimeUS / 1e6, str(m.Message)) for m in found.get("MSG", ())]


def is_binary(path: Path) -> bool:
    """Whether the log is as it was written on board, not made a text of."""
    with path.open("rb") as stream:
        return stream.read(2) == HEAD


def _set(rows: Sequence[Any]) -> tuple[dict[str, float], list[Change]]:
    """Parameters as a log begins with them, and everything that it says was set."""
    first: dict[str, float] = {}
    for m in rows:
        first.setdefault(m.Name, m.Value)
    return first, [(m.TimeUS / 1e6, m.Name, m.Value) for m in rows]


def _before_arming(changes: Sequence[Change], events: Sequence[Any]) -> dict[str, float]:
    """What was set before it was first armed, or at any time where no event says when that was."""
    armed = next((m.TimeUS / 1e6 for m in events if m.Id == EVENT_ARMED), None)
    return {name: value for time, name, value in changes if armed is None or time <= armed}


def _message(rows: list[Any]) -> Message | None:
    """The numeric fields of all messages of one kind; None where they have no stamps."""
    fields = [f for f in rows[0].get_fieldnames() if not isinstance(getattr(rows[0], f), (str, bytes))]
    columns = {f: np.array([getattr(m, f) for m in rows], float) for f in fields}
    return columns | {"time_s": columns["TimeUS"] / 1e6} if "TimeUS" in columns else None


def _read(path: Path, types: Sequence[str]) -> tuple[dict[str, list[Any]], bool]:
    """Messages of these types by name, and whether some could not be read. Raises InputError."""
    if not is_binary(path):
        return read_text(path, types)
    found: dict[str, list[Any]] = {}
    kind = _reader_class()
    reader = kind.__new__(kind)  # to close what a failing start opened
    try:
        with silenced():
            reader.__init__(str(path), zero_time_base=True)
            holes = _has_holes(reader)
            for number, form in reader.formats.items():
                if struct.calcsize(form.msg_struct) != form.len - 3:  # none can be read
                    reader.counts[number] = 0
            while (message := reader.recv_match(type=list(types))) is not None:
                found.setdefault(message.get_type(), []).append(message)
    except Exception as error:  # pymavlink raises bare Exception on a torn format message
        raise InputError(path, "", f"not a readable DataFlash log ({one_line(error)})") from error
    finally:
        for name in ("data_map", "filehandle"):
            with contextlib.suppress(AttributeError, BufferError):  # not opened; still looked at by an error
                getattr(reader, name).close()
    return found, holes or reader.lost > 0


def _has_holes(reader: Any) -> bool:
    """Whether bytes between messages belong to none, or more follow the last than a page of a card leaves."""
    formats = reader.formats
    ends = [int(at[-1]) + formats[n].len for n, at in enumerate(reader.offsets) if len(at) and n in formats]
    read = sum(reader.counts[n] * form.len for n, form in formats.items())
    return bool(read < max(ends, default=0) or reader.data_len - max(ends, default=0) >= TRAILING)


@functools.cache
def _reader_class() -> Any:
    from pymavlink import DFReader  # here and below: pymavlink and pyulog for binary logs alone

    class Reader(DFReader.DFReader_binary):
        """pymavlink looks for the next message it can read from each that it cannot, to the log's end: with
        a format that was damaged on the way that is the square of a log."""

        _deep = lost = 0

        def _parse_next(self) -> Any:
            self.lost += self._deep > 0
            if self.lost > MOST_LOST:
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
    messages: Mapping[str, Message],
    parameters: Mapping[str, float],
    notes: list[str],
    premises: list[str],
) -> TimeSeries | None:
    if "MOUT" in messages:  # by motors
        logged, where = messages["MOUT"], "MOUT"
        values = {n: logged[f"M{n}"] for n in range(1, 13) if f"M{n}" in logged}
        outputs = as_motors(values, parameters, "SERVO")
    elif "RCOU" in messages:
        logged, where = messages["RCOU"], "RCOU"
        values = _channels(messages)
        outputs = ardupilot_map(parameters)
        if not outputs:
            premises.append(OUTPUTS_AS_MOTORS)
            outputs = tuple(o for o in as_motors(values, parameters, "SERVO") if o.channel <= 8)
    else:
        return None
    return TimeSeries.of(logged["time_s"], commands(outputs, values, where, notes))


def _channels(messages: Mapping[str, Message]) -> dict[int, Array]:
    """(n,) pulses of each output at RCOU's stamps: outputs from 15 on stand in RCO2 and RCO3."""
    time, found = messages["RCOU"]["time_s"], {}
    for name in ("RCOU", "RCO2", "RCO3"):
        logged = messages.get(name, {})
        for n in range(1, ARDUPILOT_OUTPUTS + 1):
            if f"C{n}" in logged:
                found[n] = np.interp(time, logged["time_s"], logged[f"C{n}"])
    return found


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


def _rpm(esc: Message | None, outputs: Map, notes: list[str], premises: list[str]) -> list[TimeSeries | None]:
    instances = set(esc["Instance"].astype(int).tolist()) if esc and "Instance" in esc else set()
    motors = motors_of_escs(outputs, instances, notes, premises)
    fields = {"rpm{}": "RPM"}
    more = {"current{}_A": "Curr", "temperature{}_C": "Temp"}
    fields |= {ours: theirs for ours, theirs in more.items() if esc and np.any(esc.get(theirs, 0.0))}
    return [
        series(_instance(esc, ("Instance",), instance), {n.format(motor): f for n, f in fields.items()})
        for instance, motor in motors.items()
    ]


def _switch(events: Message | None, name: str, on: int, off: int) -> TimeSeries | None:
    """A state that two events turn on and off; before the first event it was the other one."""
    of_state = None if events is None else rows_of(events, np.isin(events["Id"], (on, off)))
    if of_state is None:
        return None
    states = (of_state["Id"] == on).astype(float)
    time = np.concatenate([[0.0], of_state["time_s"]])
    return TimeSeries.of(time, {name: np.concatenate([[1.0 - states[0]], states])})
