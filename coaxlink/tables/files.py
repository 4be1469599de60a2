"""A table as the files of its firmware: names, contents, and their writing."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from coaxlink import files
from coaxlink._version import __version__
from coaxlink.airframe import Airframe
from coaxlink.errors import InputError
from coaxlink.tables.ardupilot import ApReport
from coaxlink.tables.px4 import TableReport
from firmware_params import ardupilot, px4

SCRIPTS = "scripts"
_WITH = "File: "  # of the parameters' header: another file of the same table, and its CRC32
_AGAIN = "make the table again, its files are one thing"


def file_name(name: str) -> str:
    """A vehicle's name as a file name: in the folder it is put in, and short enough for any file system."""
    safe = "".join(c if c.isalnum() or c in "-_." else "-" for c in name).strip("-.")[:60]
    return safe.strip("-.") or "vehicle"


def table_files(
    frame: Airframe, report: TableReport | ApReport, made_from: str, beside: Mapping[str, bytes] | None = None
) -> dict[str, str]:
    """{NAME.params: text} for PX4, {NAME.param: text, scripts/NAME.lua: text} for ArduPilot.

    `made_from` says in the header which rotor model it is. `beside` is what else lies in the folder, by
    name. The parameters' header has the checksums of all other files.
    """
    texts = {f"{SCRIPTS}/{name}": script for name, script in getattr(report, "scripts", {}).items()}
    sums = [f"{_WITH}{name} {_crc(content)}" for name, content in {**texts, **(beside or {})}.items()]
    if isinstance(report, TableReport):
        lines = _header(frame, made_from, report.law, "PX4 v1.14 or later", sums)
        text = px4.params_text(report.params, header=[*lines, "Vehicle-Id Component-Id Name Value Type"])
        return {f"{file_name(frame.name)}.params": text}
    lines = _header(frame, made_from, report.law, "ArduCopter 4.3 or later", sums)
    return {f"{file_name(frame.name)}.param": ardupilot.param_text(report.params, lines), **texts}


def write_table(
    folder: Path,
    frame: Airframe,
    rotor_file: Path,
    report: TableReport | ApReport,
    beside: Mapping[str, bytes] | None = None,
) -> list[str]:
    """Write the table's files into a folder, together or not at all, and return their paths.

    Scripts of a table that was there before go: two tables fly on no board. Raises InputError when the
    folder cannot be written.
    """
    made_from = f"{rotor_file.name} sha256 {files.sha256(rotor_file)}"
    contents = table_files(frame, report, made_from, beside)
    everything: dict[str, str | bytes] = {**contents, **(beside or {})}
    files.write_together({folder / name: data for name, data in everything.items()})
    for name in (ardupilot.scripts.MATRIX_NAME, ardupilot.scripts.LOADER_NAME):
        if f"{SCRIPTS}/{name}" not in contents:
            (folder / SCRIPTS / name).unlink(missing_ok=True)
    return [str(folder / name) for name in contents]


def refuse_halves(source: Path, header: Sequence[str]) -> None:
    """Raises InputError where a file beside a table's parameters is not the one that they were written with.

    `header` are the comment lines of the parameters. A copied folder may lack the vehicle, never a script.
    """
    for line in header:
        name, _, crc = line.removeprefix(_WITH).rpartition(" ")
        path = source.parent / name
        if not line.startswith(_WITH) or ".." in path.parts or Path(name).is_absolute():
            continue
        if path.is_file() or path.parent.name == SCRIPTS:
            if not path.is_file():
                raise InputError(path, "", f"is missing: {source.name} was written with it; {_AGAIN}")
            if _crc(files.read_bytes(path)) != crc:
                raise InputError(path, "", f"is not what {source.name} was written with: {_AGAIN}")


def _crc(content: str | bytes) -> str:
    return f"{zlib.crc32(content.encode() if isinstance(content, str) else content):08x}"


def _header(frame: Airframe, made_from: str, law: str, firmware: str, sums: Sequence[str]) -> list[str]:
    """The comment lines of every file: what it is for and what it was made from."""
    return [
        f"coaxlink {__version__}: mixer table of {frame.name}",
        "",
        f"Firmware: {firmware}",
        f"Vehicle: {frame.name}",
        f"Rotors: {len(frame.rotors)}",
        f"Law: {law}",
        f"Rotor model: {made_from}",
        *sums,
        "",
    ]
