"""DataFlash logs of ArduPilot, binary or made text of, as flight columns.

Motors from MOUT (a script's faster copy of the outputs) or RCOU; accelerations of the IMU in use less the
estimator's bias (XKF2), since ArduPilot logs them raw.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from coaxlink.data.logs.changes import Change, periods, read_in_periods
from coaxlink.data.logs.dataflash_records import Kept, Records, read_records
from coaxlink.data.logs.esc_readings import measured_escs
from coaxlink.data.logs.outputs import (
    ARDUPILOT_OUTPUTS,
    Map,
    ardupilot_map,
    as_motors,
    commands,
    motorless,
    motors_of_escs,
    tell_range,
)
from coaxlink.data.logs.streams import Array, Message, TimeSeries, longest, merge, possible, rows_of, series
from coaxlink.data.logs.stretches import ONBOARD_S, Stream, cuts, each_stretch
from coaxlink.data.samples import DAMAGED, OUTPUTS_AS_MOTORS, PREMISES, Samples
from coaxlink.errors import InputError
from firmware_params.ardupilot.parameters import other_vehicle

TYPES = (
    "MOUT", "RCOU", "RCO2", "RCO3", "IMU", "XKF1", "XKF2", "XKF4", "NKF1", "EKF1", "ATT", "BAT", "CURR",
    "RFND", "ESC", "EV", "ARM", "MSG",
)  # fmt: skip
PACED = ("ATT", "IMU", "RCOU", "MOUT", "XKF1", "NKF1", "EKF1")  # the board's clock in even steps
OUTPUTS = ("MOUT", "RCOU", "RCO2", "RCO3")
EVENT_ARMED, EVENT_DISARMED, EVENT_LANDED, EVENT_AIRBORNE = 10, 11, 18, 28
INSTANCE = ("Instance", "Inst", "I")  # what the number of a sensor is called, over the years


def read_dataflash(path: Path) -> list[Samples]:
    """Every flight of an ArduPilot log as flight columns. Raises InputError."""
    log = read_records(path, (*TYPES, "PARM"))
    _refuse_timeless(path, log)
    edges = [0, *_cuts(path, log), 2**62]
    return each_stretch(str(path), list(pairwise(edges)), lambda part: _flight(path, _between(log, *part)))


def _between(log: Records, first: int, last: int) -> Records:
    """One stretch; of parameters all that was reported by its end."""
    parts = {name: kept.between(first * (name != "PARM"), last) for name, kept in log.kinds.items()}
    now = {name: kept for name, kept in parts.items() if kept.messages}
    if "PARM" in now and first:  # what was set before holds from the beginning
        reported = now["PARM"]
        now["PARM"] = replace(reported, time_s=np.where(reported.at < first, -np.inf, reported.time_s))
    return Records(now, log.damaged)


def _flight(path: Path, log: Records) -> Samples:
    first, changes = _set(log.kinds.get("PARM"))
    parameters = first | _before_arming(changes, log.kinds.get("EV"))
    if other := other_vehicle(parameters):
        raise InputError(path, "", f"the log of {other}: a multirotor's is expected")
    messages = {n: _message(kept) for n, kept in log.kinds.items() if n not in ("PARM", "MSG")}
    if "MOUT" not in messages and (other := motorless(parameters)):
        raise InputError(path, "", f"no output of this log drives a motor ({other}): not this vehicle")
    notes: list[str] = []
    premises = [DAMAGED] * log.damaged
    outputs = ardupilot_map(parameters)
    motors = read_in_periods(
        periods(first, changes),
        lambda held, reported, taken: _motors(
            {n: rows for n, m in messages.items() if n in OUTPUTS and (rows := held.of(m))},
            held.parameters,
            reported,
            taken,
        ),
        notes,
        premises,
    )
    estimate = _core(messages, "XKF1") or messages.get("NKF1") or messages.get("EKF1")
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
    reported = log.kinds.get("MSG")
    rows = () if reported is None else zip(reported.time_s.tolist(), reported.messages, strict=True)
    return replace(
        samples,
        motors=tuple(o.motor for o in outputs),
        parameters=parameters,
        texts=tuple((time, None, str(m.Message)) for time, m in rows),
    )


def dataflash_parameters(path: Path, *, whole: bool = False) -> dict[str, float]:
    """The parameters an ArduPilot log holds, the last value of each.

    Raises InputError, with `whole` for a damaged log too.
    """
    log = read_records(path, (*TYPES, "PARM") if whole else ("PARM",))
    if whole and log.damaged:
        raise InputError(path, "", PREMISES[DAMAGED])
    first, changes = _set(log.kinds.get("PARM"))
    return first | {name: value for _, name, value in changes}


def _cuts(path: Path, log: Records) -> list[int]:
    """Where another stretch begins."""
    streams = [Stream(kept.at, kept.time_s) for n in PACED if (kept := log.kinds.get(n)) and kept.stamped]
    return cuts(str(path), streams, ONBOARD_S, log.begins)


def _refuse_timeless(path: Path, log: Records) -> None:
    """Raises InputError for a log of before 3.2, whose motion has no time."""
    timeless = [name for name in PACED if name in log.kinds and not log.kinds[name].stamped]
    if timeless and not any(log.kinds[name].stamped for name in PACED if name in log.kinds):
        problem = f"a log of ArduCopter before 3.2 ({', '.join(timeless)} have no time): not read"
        raise InputError(path, "", problem)


def _set(reported: Kept | None) -> tuple[dict[str, float], list[Change]]:
    """Parameters as a log begins with them, and everything that it says was set."""
    if reported is None:
        return {}, []
    rows = [(t, m.Name, m.Value) for t, m in zip(reported.time_s.tolist(), reported.messages, strict=True)]
    first: dict[str, float] = {}
    for time, name, value in rows:
        if time == -np.inf:
            first[name] = value
        else:
            first.setdefault(name, value)
    return first, [row for row in rows if row[0] > -np.inf]


def _before_arming(changes: Sequence[Change], events: Kept | None) -> dict[str, float]:
    """What was set before it was first armed, or at any time where no event says when that was."""
    rows = [] if events is None else zip(events.time_s.tolist(), events.messages, strict=True)
    armed = next((t for t, m in rows if m.Id == EVENT_ARMED), None)
    return {name: value for time, name, value in changes if armed is None or time <= armed}


def _message(kept: Kept) -> Message:
    """The numeric fields of all messages of one kind."""
    rows = kept.messages
    fields = [f for f in rows[0].get_fieldnames() if not isinstance(getattr(rows[0], f), (str, bytes))]
    return {f: np.array([getattr(m, f) for m in rows], float) for f in fields} | {"time_s": kept.time_s}


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
    tell_range(parameters, notes, premises)
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
            for field in (f"C{n}", f"Ch{n}", f"Chan{n}"):  # by 2016, by 2014, before
                if field in logged:
                    found[n] = np.interp(time, logged["time_s"], logged[field])
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
    found = [
        series(_instance(esc, ("Instance",), instance), {n.format(motor): f for n, f in fields.items()})
        for instance, motor in motors.items()
    ]
    return measured_escs(found, notes)


def _switch(events: Message | None, name: str, on: int, off: int) -> TimeSeries | None:
    """A state that two events turn on and off; before the first event it was the other one."""
    of_state = None if events is None else rows_of(events, np.isin(events["Id"], (on, off)))
    if of_state is None:
        return None
    states = (of_state["Id"] == on).astype(float)
    time = np.concatenate([[0.0], of_state["time_s"]])
    return TimeSeries.of(time, {name: np.concatenate([[1.0 - states[0]], states])})
