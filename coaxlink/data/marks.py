"""Files of other programs, known by their first bytes: named for what they are before anything is read.

Sources: Betaflight and INAV `blackbox.c` and blackbox-tools (headers, decoded tables), PX4 1.13
`ROMFS/px4fmu_common/init.d/airframes` and `mixers`, bsonspec.org 1.1, the magic numbers of each format.
"""

from __future__ import annotations

import re
from pathlib import Path

from coaxlink import files
from coaxlink.errors import InputError
from firmware_params import bounded

_BLACKBOX = re.compile(rb"Blackbox flight data recorder")
_REVISION = re.compile(rb"^\"?H? ?Firmware revision\"?[:,]\"?([\w .\-]{1,40})", re.MULTILINE)
_DECODED = re.compile(rb"\A\"?(loopIteration|time \(us\))\"?\s*,")  # blackbox_decode's table
_JSON = re.compile(rb"\A(\xef\xbb\xbf)?\s*(\{\s*[\"}]|\[\s*[\[{\"\d\]-])")
_PLAN = re.compile(rb'"fileType"\s*:\s*"(Plan|Parameters|\w+)"')
_MIXER = re.compile(rb"^\s*set\s+MIXER\s+(\S+)", re.MULTILINE)
_DEFAULTS = re.compile(rb"^\s*(\.|sh)\s+\S*etc/init\.d/rc\.\w+", re.MULTILINE)
_SETS = re.compile(rb"^\s*param\s+set", re.MULTILINE)
_GEOMETRY = re.compile(rb"CA_ROTOR_COUNT|CA_AIRFRAME")
_MIX = re.compile(rb"^(R:\s*\S+(\s+-?\d+){4}|M:\s*\d+\s*$)", re.MULTILINE)
_TEMPLATES = {b"octo_cox": "x8", b"octo_cox_w": "x8", b"hexa_cox": "y6"}  # PX4's mixer: ours of its motors
_START = "start from `template` x8, coax-quad, y6 or hexa-coax"
_BSON_TYPES = frozenset((*range(0x01, 0x14), 0x7F, 0xFF))
_FORMATS = (
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
    (b"MATLAB 5.0 MAT-file", "a MATLAB file"),
    (b"\x93NUMPY", "a NumPy array"),
    (b"#ROSBAG V", "a ROS bag"),
    (b"\x89MCAP0\r\n", "an MCAP recording"),
    (b"SQLite format 3\0", "an SQLite database (a ROS 2 bag is one)"),
    (b"PAR1", "a Parquet file"),
    (b"\x1f\x8b", "a gzip archive: unpack it first"),
    (b"BZh", "a bzip2 archive: unpack it first"),
    (b"\xfd7zXZ\0", "an xz archive: unpack it first"),
    (b"7z\xbc\xaf\x27\x1c", "a 7-Zip archive: unpack it first"),
    (b"Rar!\x1a\x07", "a RAR archive: unpack it first"),
    (b"%PDF-", "a PDF"),
    (b"\x80\x04\x95", "a Python pickle"),
    (b"\x7fELF", "a program"),
)
LOOKS = 8000  # bytes that tell a text's kind: a station's own lines may stand above the formats
_LOGS = (
    "flights are read from ULog (PX4), DataFlash (ArduPilot), tlog and CSV, stands from CSV and spreadsheets"
)


def refuse_foreign(path: Path) -> None:
    """Raises InputError for a file of another program, by its name."""
    with files.reading(path):
        bounded.check_regular(path)
        with path.open("rb") as stream:
            head = stream.read(LOOKS)
        length = path.stat().st_size
    if other := foreign(head, length):
        raise InputError(path, "", other)


def foreign(head: bytes, length: int) -> str:
    """What a file that begins so and has so many bytes is, and what is taken in its place; "" for no such.

    >>> foreign(b"H Product:Blackbox flight data recorder\\nH Firmware revision:INAV 7.1.0\\n", 9000)[:30]
    'a blackbox log of INAV 7.1.0: '
    >>> foreign(b"time_s,upper_rpm", 16)
    ''
    """
    if _BLACKBOX.search(head) or _DECODED.match(head):
        revision = _REVISION.search(head)
        whose = revision[1].decode("ascii", "replace").strip() if revision else "Betaflight or INAV"
        return f"a blackbox log of {whose}: {_LOGS}"
    for magic, name in _FORMATS:
        if head.startswith(magic):
            return f"{name}: {_LOGS}"
    if _is_bson(head, length):
        return f"BSON (binary JSON): {_LOGS}"
    if _JSON.match(head):
        plan = _PLAN.search(head)
        kind = "a mission plan of QGroundControl (JSON)" if plan and plan[1] == b"Plan" else "a JSON file"
        return f"{kind}: {_LOGS}; parameters as the ground station saves them (.params, .param)"
    return _of_old_px4(head)


def _is_bson(head: bytes, length: int) -> bool:
    """A document: its length, a type, a name of printable letters."""
    if len(head) < 8 or head[4] not in _BSON_TYPES:
        return False
    name, end, _ = head[5:].partition(b"\0")
    size = int.from_bytes(head[:4], "little")
    return (
        bool(end)
        and 0 < len(name) < 64
        and name.isascii()
        and name.decode().isprintable()
        and 5 <= size <= length
    )


def _of_old_px4(head: bytes) -> str:
    """Airframes and mixers of 1.13 and before, whose geometry is in no parameter."""
    mixer = _MIXER.search(head)
    if mixer and not _GEOMETRY.search(head):
        name = mixer[1]
        start = f"; start from `template` {_TEMPLATES[name]}" if name in _TEMPLATES else ""
        shown = name.decode("ascii", "replace")
        return f"an airframe file of PX4 1.13 or older: its geometry is in the mixer {shown}{start}"
    if _DEFAULTS.search(head) and not _SETS.search(head):
        return f"a script of PX4 that sets no parameter: its geometry is elsewhere; {_START}"
    if _MIX.search(head):
        return f"a mixer file of PX4 1.13 or older, which holds no places of rotors; {_START}"
    return ""
