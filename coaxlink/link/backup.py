"""A vehicle's parameters as a file that can be put back: QGC's format, with board, firmware and time."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from coaxlink.errors import InputError
from coaxlink.link.parameters import Number, Snapshot
from coaxlink.link.session import Identity
from firmware_params import ardupilot, px4
from firmware_params.errors import ParamsFileError

_TITLE = "coaxlink backup"


@dataclass(frozen=True)
class Backup:
    """A backup read from disk."""

    path: Path
    params: dict[str, Number]
    types: dict[str, int]
    board: str  # board id it was taken from
    firmware: str
    time: str


def backup_path(folder: Path, identity: Identity) -> Path:
    """A name that no other backup has: board and UTC time."""
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    board = identity.uid.strip("0")[:16] or f"system{identity.system}"
    path, again = folder / f"{board}-{stamp}.params", 1
    while path.exists():
        again += 1
        path = folder / f"{board}-{stamp}-{again}.params"
    return path


def write_backup(path: Path, identity: Identity, snapshot: Snapshot) -> None:
    """Write every parameter of a vehicle atomically. Raises InputError."""
    header = (
        _TITLE,
        "",
        f"Board: {identity.uid or 'unknown'}",
        f"Board-Version: {identity.board or 'unknown'}",
        f"Firmware: {identity.name}",
        f"Git: {identity.git_hash or 'unknown'}",
        f"Time: {time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime())}",
        f"Hash: {snapshot.hash:08x}",
        f"Count: {len(snapshot.values)}",
        "",
        "Vehicle-Id Component-Id Name Value Type",
    )
    values = snapshot.values.values()
    try:
        px4.write_params_file(
            path,
            {v.name: v.value for v in values},
            types={v.name: v.type for v in values},
            header=header,
            system=identity.system,
            component=identity.component,
        )
    except OSError as error:
        raise InputError(path, "", f"the backup cannot be written ({error.strerror})") from error


def read_backup(path: Path) -> Backup:
    """Read a backup; its count must be whole. Raises InputError with the line."""
    try:
        read = px4.read_params_file(path, finite=False)
    except ParamsFileError as error:
        raise InputError(error.path, f"line {error.line}" if error.line else "", error.problem) from error
    head = dict(line.split(": ", 1) for line in read.header if ": " in line)
    if _TITLE not in read.header or "Count" not in head:
        raise InputError(path, "", "not a coaxlink backup (its header is missing); use upload for a table")
    if head["Count"] != str(len(read.params)):
        raise InputError(
            path, "", f"{head['Count']} parameters are expected, found {len(read.params)}: it was cut"
        )
    return Backup(
        path, read.params, read.types, head.get("Board", ""), head.get("Firmware", ""), head.get("Time", "")
    )


class ApBackup:
    """A backup of an ArduPilot board: parameters, and the scripts beside them."""

    def __init__(self, path: Path) -> None:
        """Read it. Raises InputError when it is none or was cut."""
        try:
            read = ardupilot.read_param_file(path, finite=False)
        except ParamsFileError as error:
            raise InputError(error.path, f"line {error.line}" if error.line else "", error.problem) from error
        head = dict(line.split(": ", 1) for line in read.header if ": " in line)
        if _TITLE not in read.header or "Count" not in head:
            raise InputError(
                path, "", "not a coaxlink backup (its header is missing); use upload for a table"
            )
        if head["Count"] != str(len(read.params)):
            raise InputError(
                path, "", f"{head['Count']} parameters are expected, found {len(read.params)}: it was cut"
            )
        self.path, self.params, self.board = path, read.params, head.get("Board", "")
        folder = path.with_suffix(".scripts")
        self.scripts = {p.name: p.read_bytes() for p in sorted(folder.glob("*.lua"))}
