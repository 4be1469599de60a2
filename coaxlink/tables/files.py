"""A table as the files of its firmware: names, contents, and their writing."""

from __future__ import annotations

from collections.abc import Mapping
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


def px4_files(frame: Airframe, report: TableReport, made_from: str) -> dict[str, str]:
    """{NAME.params: text}; `made_from` says in the header which rotor model it is."""
    lines = _header(frame, made_from, report.law, "PX4 v1.14 or later")
    text = px4.params_text(report.params, header=[*lines, "Vehicle-Id Component-Id Name Value Type"])
    return {f"{file_name(frame.name)}.params": text}


def ap_files(frame: Airframe, report: ApReport, made_from: str) -> dict[str, str]:
    """{NAME.param: text, scripts/NAME.lua: text}."""
    lines = _header(frame, made_from, report.law, "ArduCopter 4.3 or later")
    text = ardupilot.param_text(report.params, lines)
    scripts = {f"scripts/{name}": script for name, script in report.scripts.items()}
    return {f"{file_name(frame.name)}.param": text, **scripts}


def write_px4(folder: Path, frame: Airframe, rotor_file: Path, report: TableReport) -> list[str]:
    """Write DIR/NAME.params and return its path. Raises InputError when the folder cannot be written."""
    return _write(folder, px4_files(frame, report, _made_from(rotor_file)))


def write_ap(folder: Path, frame: Airframe, rotor_file: Path, report: ApReport) -> list[str]:
    """Write DIR/NAME.param and DIR/scripts/*.lua, and return their paths.

    Raises InputError when the folder cannot be written.
    """
    return _write(folder, ap_files(frame, report, _made_from(rotor_file)))


def _made_from(rotor_file: Path) -> str:
    return f"{rotor_file.name} sha256 {files.sha256(rotor_file)}"


def _write(folder: Path, contents: Mapping[str, str]) -> list[str]:
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
