"""A vehicle's parameters and files as something that can be put back, with board, firmware and time.

PX4's parameters are kept in QGC's format, ArduPilot's in its own; files lie beside them in a folder of the
same name.
"""

from __future__ import annotations

import itertools
import shutil
import struct
import time
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from coaxlink.data.logs.board_parameters import read_board_parameters
from coaxlink.errors import InputError
from coaxlink.files import read_bytes, write_atomic
from coaxlink.mavlink.identity import Identity
from coaxlink.mavlink.parameters import Number, Snapshot
from coaxlink.uploading.content import BoardFiles
from firmware_params import ardupilot, px4
from firmware_params.errors import TableError

_TITLE = "coaxlink backup"
FILES = ".files"  # of the folder beside a backup
_TABLE, _TABLE_FILE = "Table: ", "Table-File: "
_IN_A_LINE = 6


@dataclass(frozen=True)
class Note:
    """What was about to be written when a backup was taken: the names of parameters and of files."""

    names: frozenset[str] = frozenset()
    files: frozenset[str] = frozenset()

    def lines(self) -> list[str]:
        """As the header has it."""
        names = sorted(self.names)
        rows = [names[n : n + _IN_A_LINE] for n in range(0, len(names), _IN_A_LINE)]
        return [_TABLE + " ".join(row) for row in rows] + [_TABLE_FILE + name for name in sorted(self.files)]


@dataclass(frozen=True)
class Backup:
    """A backup read from disk."""

    path: Path
    params: Mapping[str, Number]
    types: Mapping[str, int]  # MAV_PARAM_TYPE; ArduPilot's format has none
    board: str  # board id it was taken from; "" where the file is none of ours and does not say
    firmware: str
    time: str
    files: Mapping[str, bytes] = field(default_factory=dict)  # by name
    proved: bool = False  # by its checksum: nobody changed it since it was written
    note: Note | None = None  # None: written by a coaxlink that noted nothing
    read: tuple[str, ...] = ()  # what was assumed in reading it, in words


def _reserved(folder: Path, identity: Identity, suffix: str) -> Path:
    """An empty file under a name that no other backup has: whole board id, UTC time, a counter.

    Made by exclusive creation, as several uploads at one moment may share the folder. Raises InputError.
    """
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    board = identity.uid or f"system{identity.system}"
    for again in itertools.count(1):
        path = folder / f"{board}-{stamp}{f'-{again}' if again > 1 else ''}{suffix}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path.with_suffix(FILES).lstat()
        except FileNotFoundError:
            try:
                path.open("x").close()
                return path
            except FileExistsError:
                continue
            except OSError as error:
                raise InputError(path, "", f"the backup cannot be written ({error.strerror})") from error
        except OSError as error:
            raise InputError(path, "", f"the backup cannot be written ({error.strerror})") from error
    raise AssertionError


def write_backup(
    folder: Path,
    suffix: str,
    identity: Identity,
    snapshot: Snapshot,
    files: BoardFiles,
    note: Note | None = None,
) -> Path:
    """Write every parameter and `files` atomically, the parameters last, under a name of its own in `folder`.

    `note` is what is to be written to the board after it. Raises InputError; then nothing is left.
    """
    path = _reserved(folder, identity, suffix)
    try:
        _write(path, identity, snapshot, files, note)
    except BaseException:
        shutil.rmtree(path.with_suffix(FILES), ignore_errors=True)
        path.unlink(missing_ok=True)
        raise
    return path


def _write(path: Path, identity: Identity, snapshot: Snapshot, files: BoardFiles, note: Note | None) -> None:
    values = list(snapshot.values.values())
    plain = path.suffix == ".param"  # ArduPilot's format: numbers only
    numbers = {v.name: float(v.value) if plain else v.value for v in values}
    header = [
        _TITLE,
        "",
        f"Board: {identity.uid or 'unknown'}",
        f"Board-Version: {identity.board or 'unknown'}",
        f"Firmware: {identity.name}",
        f"Git: {identity.git_hash or 'unknown'}",
        f"Time: {time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime())}",
        f"Hash: {snapshot.hash:08x}",
        f"Count: {len(values)}",
        f"Files: {sum(data is not None for data in files.values())}",
        *(note.lines() if note else ()),
        f"Sum: {_checksum(numbers, _by_name(files), note):08x}",
    ]
    for board_path, data in files.items():
        if data is not None:
            write_atomic(path.with_suffix(FILES) / Path(board_path).name, data)
    try:
        if plain:
            ardupilot.write_param_file(path, numbers, header)
            return
        px4.write_params_file(
            path,
            numbers,
            types={v.name: v.type for v in values},
            header=[*header, "", "Vehicle-Id Component-Id Name Value Type"],
            system=identity.system,
            component=identity.component,
        )
    except OSError as error:
        raise InputError(path, "", f"the backup cannot be written ({error.strerror})") from error
    except TableError as error:
        raise InputError(path, "", f"the backup cannot be written ({error})") from error


def read_backup(path: Path) -> Backup:
    """Read a backup; its counts must be whole. Another program's file or a log is one of an unnamed board.

    Raises InputError with the line.
    """
    read = read_board_parameters(path, telling=True)
    params, lines = read.params, read.header
    head = dict(line.split(": ", 1) for line in lines if ": " in line)
    if _TITLE not in lines:
        return Backup(path, params, read.types, "", read.firmware, "", read=read.notes)
    if "Count" not in head:
        raise InputError(path, "", "a coaxlink backup without its line '# Count:': it was cut")
    if head["Count"] != str(len(params)):
        raise InputError(
            path, "", f"{head['Count']} parameters are expected, found {len(params)}: it was cut"
        )
    folder = path.with_suffix(FILES)
    files = {p.name: read_bytes(p) for p in sorted(folder.glob("*")) if p.is_file()}
    if head.get("Files", "0") != str(len(files)):
        raise InputError(folder, "", f"{head.get('Files', '0')} files are expected, found {len(files)}")
    note = _note(lines)
    if "Sum" in head and head["Sum"] != f"{_checksum(params, files, note):08x}":
        raise InputError(path, "", "changed since it was written; delete its line '# Sum:' if that was meant")
    board, firmware, taken = (head.get(key, "") for key in ("Board", "Firmware", "Time"))
    return Backup(path, params, read.types, board, firmware, taken, files, "Sum" in head, note)


def _note(lines: Sequence[str]) -> Note | None:
    rows = [line.removeprefix(_TABLE).split() for line in lines if line.startswith(_TABLE)]
    files = [line.removeprefix(_TABLE_FILE) for line in lines if line.startswith(_TABLE_FILE)]
    if not rows and not files:
        return None
    return Note(frozenset(name for row in rows for name in row), frozenset(files))


def _by_name(files: BoardFiles) -> dict[str, bytes]:
    return {Path(board_path).name: data for board_path, data in files.items() if data is not None}


def _checksum(params: Mapping[str, Number], files: Mapping[str, bytes], note: Note | None) -> int:
    """CRC32 of values as the board has them and of files, in order of their names, and of the note."""
    crc = 0
    for name, value in sorted(params.items()):
        held = struct.pack("<q", value) if isinstance(value, int) else struct.pack("<f", value)
        crc = zlib.crc32(name.encode() + held, crc)
    for name, data in sorted(files.items()):
        crc = zlib.crc32(name.encode() + data, crc)
    for line in note.lines() if note else ():
        crc = zlib.crc32(line.encode(), crc)
    return crc
