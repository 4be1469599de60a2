"""mix.live: what the live loop did, a fixed record a demand; as a flight log with the mix.tlog beside it.

The line `coaxlink live 1`, a line of JSON (law, airframe, number of rotors), then records, little-endian:
stamp of the demand (us, vehicle's clock), time (s, monotonic), demand (4: roll, pitch, yaw, thrust), commands
(8), allocation error (4: N, N m), latency (s), state (index into live.guard.STATES). A cut last record is
dropped.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink import files
from coaxlink.data.logs.streams import TimeSeries
from coaxlink.data.logs.stretches import LATE_S, Stream, cuts
from coaxlink.data.logs.tlog import read_tlog
from coaxlink.data.samples import Samples
from coaxlink.errors import InputError
from firmware_params import bounded

MAGIC = b"coaxlink live 1\n"
RECORD = struct.Struct("<Qd4f8f4ffB")
TYPE = np.dtype(
    [
        ("stamp_us", "<u8"), ("time_s", "<f8"), ("demand", "<f4", 4), ("commands", "<f4", 8),
        ("error", "<f4", 4), ("latency_s", "<f4"), ("state", "u1"),
    ]
)  # fmt: skip


def read_record(path: Path) -> tuple[dict[str, Any], NDArray[Any]]:
    """(header, structured array of the records). Raises InputError when it is no such file."""
    data = files.read_bytes(path, bounded.LOG)
    end = data.find(b"\n", len(MAGIC))
    if not data.startswith(MAGIC) or end < 0:
        raise InputError(path, "", "not a live record (`record`)")
    body = data[end + 1 :]
    length = len(body) // RECORD.size * RECORD.size
    with files.reading(path):
        about = bounded.parse_json(data[len(MAGIC) : end].decode("utf-8", "replace"))
    if not isinstance(about, dict):
        raise InputError(path, "line 2", "a JSON object is expected")
    return about, np.frombuffer(body[:length], TYPE)


def read_live(path: Path, system: int | None = None) -> list[Samples]:
    """The commands of a mix.live, and all else of the tlog of the same name beside it. Raises InputError."""
    about, rows = read_record(path)
    beside = path.with_suffix(".tlog")
    if not beside.is_file():
        problem = f"holds commands alone: the {beside.name} of the same `record` is needed beside it"
        raise InputError(path, "", problem)
    count = about.get("rotors")
    if not isinstance(count, int) or not 2 <= count <= rows["commands"].shape[1]:
        raise InputError(path, "line 2, rotors", f"2 to {rows['commands'].shape[1]} are expected")
    commands = {f"motor{n + 1}": rows["commands"][:, n].astype(float) for n in range(count)}
    stamps = rows["stamp_us"] * 1e-6
    edges = [0, *cuts(str(path), [Stream(np.arange(len(stamps)), stamps)], LATE_S), len(stamps)]
    pieces = [
        TimeSeries.of(stamps[a:b], {name: column[a:b] for name, column in commands.items()})
        for a, b in pairwise(edges)
    ]
    motors = [piece for piece in pieces if piece is not None]
    if not motors:
        raise InputError(path, "", "fewer than two demands were answered")
    found = read_tlog(beside, system, motors)
    return [replace(one, source=one.source.replace(str(beside), str(path), 1)) for one in found]
