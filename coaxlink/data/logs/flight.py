"""Flight logs of every kind as Samples in the contract's flight columns."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coaxlink import files
from coaxlink.data.logs.dataflash_text import is_dataflash_text
from coaxlink.data.logs.streams import at_the_commands
from coaxlink.data.marks import LOOKS, foreign
from coaxlink.data.quiet import one_line
from coaxlink.data.samples import SIGNED_SPEEDS, Samples
from coaxlink.data.table import is_spreadsheet, read_headings, read_table
from coaxlink.errors import InputError
from firmware_params import bounded

MOTOR = re.compile(r"motor([1-9]\d?)")
MOTION = (
    *(f"{what}_{axis}_{unit}" for what, unit in (("accel", "m_s2"), ("gyro", "rad_s")) for axis in "xyz"),
    "roll_rad",
    "pitch_rad",
    "yaw_rad",
)
OURS = re.compile(
    r"time_s|(motor|rpm)[1-9]\d?|(accel|gyro)_[xyz]_\w+|(roll|pitch|yaw)_rad|vel_[ned]_m_s|height_m|voltage_V"
    r"|armed|landed"
)
# of the rows in which a motor turns: in percent or microseconds next to none lies in 0..1
LEAST_SOUND = 0.2
ABSURD = 1e9  # of any column of ours in any unit; damaged floats go far beyond
SLOWEST_S = 1.0  # between two rows: slower tells nothing of a flight
SYSTEM_IDS = ("MAV_SYS_ID", "SYSID_THISMAV", "MAV_SYSID")  # PX4, ArduPilot until 4.6 and after
AT_REST = 0.05  # of full command, judgement: below it a motor stands or idles, in any unit
_PRINTOUT = re.compile(rb"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d+: \w+ {")
_ULOG = b"ULog\x01\x12\x35"
_DATAFLASH = b"\xa3\x95"
_MAVLINK = (0xFD, 0xFE)
_LIVE = b"coaxlink live 1"
_NAMES = {"ulog": "ULog", "dataflash": "DataFlash", "tlog": "tlog", "live": "mix.live"}
_SUFFIXES = {".ulg": "ulog", ".bin": "dataflash", ".tlog": "tlog", ".live": "live"}
_DAMAGE = (LookupError, ValueError, TypeError, ArithmeticError, AttributeError, MemoryError)


def read_flights(path: Path, system: int | None = None) -> list[Samples]:
    """ULog, DataFlash, tlog, mix.live or CSV, by content, as the contract's flight columns: a table a flight.

    A log is cut where its clock goes back or its board started again; each one's `provenance` says so. Of
    several vehicles that of `system` is read, else the one that sent the most.

    Columns: time_s, motor1..N (0..1, after the thrust curve), accel_* (specific force, m/s^2), gyro_*,
    roll_rad, pitch_rad, yaw_rad, vel_{n,e,d}_m_s, height_m; voltage_V, rpm1..N, armed, landed where logged.
    Raises InputError.
    """
    return [_amounts(log) for log in _read(Path(path), system)]


def _amounts(log: Samples) -> Samples:
    """With speeds as amounts: an ESC that tells the direction by the sign tells a speed."""
    rpm = {n: c for n, c in log.columns.items() if n.startswith("rpm")}
    signed = {n: np.abs(c) for n, c in rpm.items() if np.sum(c < 0.0) > np.sum(c > 0.0)}
    return log.with_columns(**signed).on_premises(SIGNED_SPEEDS) if signed else log


def _read(path: Path, system: int | None) -> list[Samples]:
    kind = log_kind(path)
    try:
        if kind == "ulog":
            from coaxlink.data.logs.ulog import read_ulog

            found = read_ulog(path)
        elif kind == "dataflash":
            from coaxlink.data.logs.dataflash import read_dataflash

            found = read_dataflash(path)
        elif kind == "tlog":
            from coaxlink.data.logs.tlog import read_tlog

            return read_tlog(path, system)
        elif kind == "live":
            from coaxlink.data.logs.live_record import read_live

            return read_live(path, system)
        else:
            found = [read_flight_csv(path)]
    except _DAMAGE as error:  # formats describe their own fields: a damaged one promises what is not there
        if kind == "text":
            raise
        raise InputError(path, "", f"not a readable {_NAMES[kind]} log ({one_line(error)})") from error
    refuse_other_system(path, system, found[0].parameters)
    return found


def read_flight_log(path: Path, system: int | None = None) -> Samples:
    """The flight of a log that holds one, as `read_flights`. Raises InputError, also for several."""
    found = read_flights(path, system)
    if len(found) > 1:
        problem = f"{len(found)} stretches, and one is expected: read_flights gives each"
        raise InputError(path, "", problem)
    return found[0]


def refuse_other_system(path: Path, system: int | None, parameters: Mapping[str, float]) -> None:
    """Raises InputError where a log of one vehicle is not of the one that was asked for."""
    if system is None:
        return
    own = next((parameters[name] for name in SYSTEM_IDS if name in parameters), None)
    if own != system:
        found = "which does not say its number" if own is None else f"number {own:g}"
        raise InputError(path, f"`system` {system}", f"this log is of one vehicle, {found}")


def is_flight_log(path: Path) -> bool:
    """Whether a log is of a flight (motor commands, or binary), not of a stand. Raises InputError."""
    path = Path(path)
    if log_kind(path) != "text":
        return True
    return not is_spreadsheet(path) and any(MOTOR.fullmatch(name) for name in read_headings(path))


def log_kind(path: Path) -> str:
    """ulog, dataflash, tlog, live or text, by its first bytes.

    Raises InputError, for another program's file by its name.
    """
    with files.reading(path):
        bounded.check_regular(path)
        with path.open("rb") as stream:
            head = stream.read(LOOKS)
    if head.startswith(_ULOG):
        return "ulog"
    if head.startswith(_DATAFLASH) or is_dataflash_text(head):
        return "dataflash"
    if head.startswith(_LIVE):
        return "live"
    if _PRINTOUT.match(head):
        raise InputError(path, "", "a printout of mavlogdump: the .bin or .tlog it was made of is expected")
    # the stamp, us since 1970, begins with a zero byte for 2000 years to come; no text does
    if len(head) > 9 and head[8] in _MAVLINK and head[0] == 0:
        return "tlog"
    if other := foreign(head, path.stat().st_size):
        raise InputError(path, "", other)
    promised = _SUFFIXES.get(path.suffix.lower())
    if promised:
        found = "an empty file" if not head else "something else"
        raise InputError(path, "", f"a {_NAMES[promised]} file is expected, found {found}")
    return "text"


def impossible_commands(commands: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(rows,) whether a command is outside 0..1: a damaged packet, where most of the log is inside."""
    return np.asarray((commands < 0.0) | (commands > 1.0))


def read_flight_csv(path: Path) -> Samples:
    """A CSV flight log in our own columns, each a number in every row; of others those that are numbers.

    Commands outside 0..1 in part of the rows stay as they are; `refine` flags them and leaves them out.
    Raises InputError, also where the commands are in another unit.
    """
    table = read_table(path)
    columns, left = {}, []
    for i, name in enumerate(table.headings):
        if not name or table.column_is_empty(i):
            continue
        values = table.numbers(i, ABSURD) if OURS.fullmatch(name) else table.numbers_or_none(i)
        if values is None:
            left.append(name)
        else:
            columns[name] = values
    notes = (f"left out (no numbers): {', '.join(left)}",) if left else ()
    samples = Samples(columns, str(path), notes, table.lines)
    samples.require("time_s", "motor1", *MOTION)
    count = sum(MOTOR.fullmatch(name) is not None for name in columns)
    motors = [f"motor{n}" for n in range(1, count + 1)]
    samples.require(*motors)
    for name in motors:
        outside = impossible_commands(samples[name])
        turning = np.abs(samples[name]) > AT_REST
        if outside.sum() > (1.0 - LEAST_SOUND) * turning.sum():  # a unit, not a damaged stretch
            row = int(np.argmax(outside))
            found = f"0..1 is expected, found {samples[name][row]:g}"
            raise InputError(path, f"{samples.place(row)}, column {name}", found)
    step = np.diff(samples["time_s"])
    if (step < 0).any():
        where = samples.place(int(np.argmax(step < 0)) + 1)
        raise InputError(path, f"{where}, column time_s", "time goes back; increasing stamps are expected")
    usual = float(np.median(step)) if len(step) else 0.0
    if usual > SLOWEST_S:
        found = f"rows every {usual:g} s: a flight needs several a second; seconds are expected, not ms or us"
        raise InputError(path, "column time_s", found)
    repeated = np.concatenate([[False], step == 0])
    if repeated.any():
        note = f"{int(repeated.sum())} rows with a repeated stamp left out"
        samples = samples.take(~repeated).with_notes(note)
    return at_the_commands(samples, motors)
