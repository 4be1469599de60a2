"""A table as the files of its firmware: names, contents, and their writing."""

from __future__ import annotations

from pathlib import Path

from coaxlink import files
from coaxlink._version import __version__
from coaxlink.airframe import Airframe
from coaxlink.tables.ardupilot import ApReport
from coaxlink.tables.px4 import TableReport
from firmware_params import ardupilot, px4


def file_name(name: str) -> str:
    """A vehicle's name as a file name: in the folder it is put in, and short enough for any file system."""
    safe = "".join(c if c.isalnum() or c in "-_." else "-" for c in name).strip("-.")[:60]
    return safe.strip("-.") or "vehicle"


def table_files(frame: Airframe, report: TableReport | ApReport, made_from: str) -> dict[str, str]:
    """{NAME.params: text} for PX4, {NAME.param: text, scripts/NAME.lua: text} for ArduPilot.

    `made_from` says in the header which rotor model it is.
    """
    if isinstance(report, TableReport):
        lines = _header(frame, made_from, report.law, "PX4 v1.14 or later")
        text = px4.params_text(report.params, header=[*lines, "Vehicle-Id Component-Id Name Value Type"])
        return {f"{file_name(frame.name)}.params": text}
    lines = _header(frame, made_from, report.law, "ArduCopter 4.3 or later")
    text = ardupilot.param_text(report.params, lines)
    scripts = {f"scripts/{name}": script for name, script in report.scripts.items()}
    return {f"{file_name(frame.name)}.param": text, **scripts}


def write_table(folder: Path, frame: Airframe, rotor_file: Path, report: TableReport | ApReport) -> list[str]:
    """Write the table's files into a folder, and return their paths.

    Raises InputError when the folder cannot be written.
    """
    contents = table_files(frame, report, f"{rotor_file.name} sha256 {files.sha256(rotor_file)}")
    for name, text in contents.items():
        files.write_atomic(folder / name, text)
    return [str(folder / name) for name in contents]


def _header(frame: Airframe, made_from: str, law: str, firmware: str) -> list[str]:
    """The comment lines of every file: what it is for and what it was made from."""
    return [
        f"coaxlink {__version__}: mixer table of {frame.name}",
        "",
        f"Firmware: {firmware}",
        f"Vehicle: {frame.name}",
        f"Rotors: {len(frame.rotors)}",
        f"Law: {law}",
        f"Rotor model: {made_from}",
        "",
    ]
