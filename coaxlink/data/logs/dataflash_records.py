"""The messages of a DataFlash log, binary or made text of, in the order of the file.

Up to ArduCopter 3.2 messages count milliseconds (TimeMS), and parameters, events and texts have no time: they
get that of the last message before them that has one.
"""

from __future__ import annotations

import contextlib
import functools
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.logs.dataflash_text import read_text
from coaxlink.data.quiet import one_line, silenced
from coaxlink.errors import InputError

MOST_LOST = 20_000  # messages that cannot be read; a torn log loses some, a card's bad block some hundred
TRAILING = 528  # bytes that may follow: pymavlink's own figure, twice the page of block-based logging
HEAD = b"\xa3\x95"  # of every message
FORMAT_OF_FORMATS = 128  # the type of FMT, with which a log begins
CLOCKS = {"TimeUS": 1e6, "TimeMS": 1e3}  # a second


@dataclass(frozen=True)
class Kept:
    """All messages of one kind."""

    at: NDArray[np.int64]  # (n,) place in the file, increasing
    time_s: NDArray[np.float64]  # (n,) NaN where no message before it has a time
    messages: list[Any]
    stamped: bool  # whether they have a time of their own

    def between(self, first: int, last: int) -> Kept:
        """Those of the places from `first` to before `last`."""
        rows = slice(*np.searchsorted(self.at, [first, last]).tolist())
        return Kept(self.at[rows], self.time_s[rows], self.messages[rows], self.stamped)


@dataclass
class Records:
    """What a log holds of the kinds that were asked for."""

    kinds: dict[str, Kept] = field(default_factory=dict)
    damaged: bool = False  # some of it could not be read
    begins: list[int] = field(
        default_factory=list
    )  # places where formats are given anew: another log follows


def read_records(path: Path, types: Sequence[str]) -> Records:
    """Messages of these types. Raises InputError."""
    if is_binary(path):
        return _of_binary(path, types)
    found, begins, damaged = read_text(path, types)
    return Records(_kept(found), damaged, begins)


def _kept(found: dict[str, list[tuple[int, Any]]]) -> dict[str, Kept]:
    """By name, those without a time dated by what stands before them."""
    clock: list[tuple[int, float]] = []
    times: dict[str, NDArray[np.float64]] = {}
    for name, rows in found.items():
        own = next((c for c in CLOCKS if hasattr(rows[0][1], c)), None)
        if own is not None:
            times[name] = np.array([getattr(m, own) for _, m in rows], float) / CLOCKS[own]
            clock += zip((at for at, _ in rows), times[name].tolist(), strict=True)
    clock.sort()
    places, stamps = (np.array([row[k] for row in clock]) for k in range(2))
    kinds = {}
    for name, rows in found.items():
        at = np.array([place for place, _ in rows], np.int64)
        if name in times:
            time = times[name]
        elif clock:
            before = np.searchsorted(places, at)
            time = np.where(before > 0, stamps[np.maximum(before - 1, 0)], stamps[0])
        else:
            time = np.zeros(len(at))
        kinds[name] = Kept(at, time, [m for _, m in rows], name in times)
    return kinds


def is_binary(path: Path) -> bool:
    """Whether the log is as it was written on board, not made a text of."""
    with path.open("rb") as stream:
        return stream.read(2) == HEAD


def _of_binary(path: Path, types: Sequence[str]) -> Records:
    found: dict[str, list[tuple[int, Any]]] = {}
    kind = _reader_class()
    reader = kind.__new__(kind)  # to close what a failing start opened
    try:
        with silenced():
            reader.__init__(str(path), zero_time_base=True)
            holes = _has_holes(reader)
            for number, form in reader.formats.items():
                if struct.calcsize(form.msg_struct) != form.len - 3:  # none can be read
                    reader.counts[number] = 0
            while (message := reader.recv_match(type=list(types))) is not None:
                found.setdefault(message.get_type(), []).append((reader.offset, message))
            begins = _begins(reader)
    except Exception as error:  # pymavlink raises bare Exception on a torn format message
        raise InputError(path, "", f"not a readable DataFlash log ({one_line(error)})") from error
    finally:
        for name in ("data_map", "filehandle"):
            with contextlib.suppress(AttributeError, BufferError):  # not opened; still looked at by an error
                getattr(reader, name).close()
    return Records(_kept(found), holes or reader.lost > 0, begins)


def _begins(reader: Any) -> list[int]:
    """Offsets after the first at which the format of formats is given: there another log was appended."""
    own = FORMAT_OF_FORMATS
    return [int(at) for at in reader.offsets[own] if reader.data_map[at + 3] == own][1:]


def _has_holes(reader: Any) -> bool:
    """Whether bytes between messages belong to none, or more follow the last than a page of a card leaves."""
    formats = reader.formats
    ends = [int(at[-1]) + formats[n].len for n, at in enumerate(reader.offsets) if len(at) and n in formats]
    read = sum(reader.counts[n] * form.len for n, form in formats.items())
    return bool(read < max(ends, default=0) or reader.data_len - max(ends, default=0) >= TRAILING)


@functools.cache
def _reader_class() -> Any:
    from pymavlink import DFReader  # here and below: pymavlink and pyulog for binary logs alone

    class Reader(DFReader.DFReader_binary):
        """pymavlink looks for the next message it can read from each that it cannot, to the log's end: with
        a format that was damaged on the way that is the square of a log."""

        _deep = lost = 0

        def _parse_next(self) -> Any:
            self.lost += self._deep > 0
            if self.lost > MOST_LOST:
                raise ValueError(f"more than {MOST_LOST} messages make no sense")
            self._deep += 1
            try:
                return super()._parse_next()
            finally:
                self._deep -= 1

    return Reader
