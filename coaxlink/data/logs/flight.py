"""Flight logs of every kind as Samples in the contract's flight columns."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coaxlink import files
from coaxlink.data.logs.held import at_the_commands
from coaxlink.data.logs.quiet import one_line
from coaxlink.data.samples import Samples
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
# of the rows in which a motor turns: in percent or microseconds next to none lies in 0..1
LEAST_SOUND = 0.2
AT_REST = 0.05  # of full command, judgement: below it a motor stands or idles, in any unit
_ULOG = b"ULog\x01\x12\x35"
_DATAFLASH = b"\xa3\x95"
_MAVLINK = (0xFD, 0xFE)


def read_flight_log(path: Path) -> Samples:
    """ULog, DataFlash, tlog or CSV, recognised by content, as the contract's flight columns on one time base.

    Columns: time_s, motor1..N (0..1, after the thrust curve), accel_* (specific force, m/s^2), gyro_*,
    roll_rad, pitch_rad, yaw_rad, vel_{n,e,d}_m_s, height_m; voltage_V, rpm1..N, armed, landed where logged.
    Raises InputError.
    """
    path = Path(path)
    kind = log_kind(path)
    if kind == "text":
        return read_flight_csv(path)
    name, read = _READERS[kind]
    try:
        return read(path)
    except _DAMAGE as error:  # formats describe their own fields: a damaged one promises what is not there
        raise InputError(path, "", f"not a readable {name} log ({one_line(error)})") from error


def _ulog(path: Path) -> Samples:
    from coaxlink.data.logs.ulog import read_ulog

    return read_ulog(path)


def _dataflash(path: Path) -> Samples:
    from coaxlink.data.logs.dataflash import read_dataflash

    return read_dataflash(path)


def _tlog(path: Path) -> Samples:
    from coaxlink.data.logs.tlog import read_tlog

    return read_tlog(path)


_READERS = {"ulog": ("ULog", _ulog), "dataflash": ("DataFlash", _dataflash), "tlog": ("tlog", _tlog)}
_DAMAGE = (LookupError, ValueError, TypeError, ArithmeticError, AttributeError, MemoryError)


def is_flight_log(path: Path) -> bool:
    """Whether a log is of a flight (motor commands, or binary), not of a stand. Raises InputError."""
    path = Path(path)
    if log_kind(path) != "text":
        return True
    return not is_spreadsheet(path) and any(MOTOR.fullmatch(name) for name in read_headings(path))


def log_kind(path: Path) -> str:
    """ulog, dataflash, tlog or text, by its first bytes. Raises InputError."""
    with files.reading(path):
        bounded.check_regular(path)
        with path.open("rb") as stream:
            head = stream.read(16)
    if head.startswith(_ULOG):
        return "ulog"
    if head.startswith(_DATAFLASH):
        return "dataflash"
    # the stamp, us since 1970, begins with a zero byte for 2000 years to come; no text does
    if len(head) > 9 and head[8] in _MAVLINK and head[0] == 0:
        return "tlog"
    suffixes = {".ulg": "ULog", ".tlog": "tlog", ".bin": "DataFlash"}
    if path.suffix.lower() in suffixes:
        found = "an empty file" if not head else "something else"
        raise InputError(path, "", f"a {suffixes[path.suffix.lower()]} file is expected, found {found}")
    return "text"


def impossible_commands(commands: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(rows,) whether a command is outside 0..1: a damaged packet, where most of the log is inside."""
    return np.asarray((commands < 0.0) | (commands > 1.0))


def read_flight_csv(path: Path) -> Samples:
    """A CSV flight log in our own columns, every column a number in every row.

    Commands outside 0..1 in part of the rows stay as they are; `refine` accuses them and leaves them out.
    Raises InputError, also where the commands are in another unit.
    """
    table = read_table(path)
    columns = {
        name: table.numbers(i)
        for i, name in enumerate(table.headings)
        if name and not table.column_is_empty(i)
    }
    samples = Samples(columns, str(path), (), table.lines)
    samples.require("time_s", "motor1", *MOTION)
    count = sum(MOTOR.fullmatch(name) is not None for name in columns)
    samples.require(*(f"motor{n}" for n in range(1, count + 1)))
    for n in range(1, count + 1):
        outside = impossible_commands(samples[f"motor{n}"])
        turning = np.abs(samples[f"motor{n}"]) > AT_REST
        if outside.sum() > (1.0 - LEAST_SOUND) * turning.sum():  # a unit, not a damaged stretch
            row = int(np.argmax(outside))
            found = f"0..1 is expected, found {samples[f'motor{n}'][row]:g}"
            raise InputError(path, f"{samples.place(row)}, column motor{n}", found)
    step = np.diff(samples["time_s"])
    if (step < 0).any():
        where = samples.place(int(np.argmax(step < 0)) + 1)
        raise InputError(path, f"{where}, column time_s", "time goes back; increasing stamps are expected")
    repeated = np.concatenate([[False], step == 0])
    if repeated.any():
        samples = samples.take(~repeated).with_notes(
            f"{int(repeated.sum())} rows with a repeated stamp left out"
        )
    return at_the_commands(samples, [f"motor{n}" for n in range(1, count + 1)])
