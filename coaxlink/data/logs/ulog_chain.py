"""The chain of messages of a ULog, walked once before pyulog reads it: is it whole, is it one stretch, does
it describe no more than it can hold.

pyulog gives each topic by itself and no order between them. A stretch is made a ULog of its own instead: the
definitions, what was subscribed and set before, and the messages of the stretch.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from coaxlink.data.logs.stretches import ONBOARD_S, Stream, cuts
from coaxlink.errors import InputError

MAGIC = b"ULog\x01\x12\x35"
HEADER, KINDS = 16, frozenset(b"BFIMPQARDLCSO")  # of the file format
FLAGS, FORMAT, SUBSCRIBED, DATA, TEXT, TAGGED, DROPOUT, SYNC = b"BFADLCOS"
MOST_BYTES = 65_535  # of a message: its size has 16 bits
LEAST_FIELDS = 1 << 20  # that may be described whatever the size of the file: pyulog takes a second for them
DEEPEST = 32  # formats within another: PX4's own go two deep
PACED = frozenset(
    ("vehicle_acceleration", "vehicle_angular_velocity", "vehicle_attitude", "sensor_combined",
     "actuator_motors", "actuator_outputs", "vehicle_local_position")
)  # fmt: skip
_FIELD = re.compile(r"(\w+)(?:\[(\d+)\])? \w+")
_SIZES = {
    **{f"{sign}int{8 * size}_t": size for sign in ("", "u") for size in (1, 2, 4, 8)},
    **{"float": 4, "double": 8, "bool": 1, "char": 1},
}


@dataclass
class _Walk:
    """What the chain holds, in the order of the file."""

    torn: bool = False  # the chain breaks before the end: pyulog passes over some of that without a word
    data_at: int = 0  # where definitions end
    formats: dict[str, str] = field(default_factory=dict)
    subscribed: dict[int, str] = field(default_factory=dict)
    stamps: dict[int, list[tuple[int, int]]] = field(default_factory=dict)  # (place, us) of paced topics
    lasting: list[tuple[int, int]] = field(default_factory=list)  # from, to of what is true after it as well


@dataclass(frozen=True)
class Chain:
    """A file's stretches, each a ULog of its own, and whether it is damaged."""

    parts: tuple[bytes, ...]
    torn: bool


def chain(path: Path, data: bytes) -> Chain:
    """Of a file's bytes. Raises InputError for formats that no message can hold."""
    files = _starts(data) or [0]  # logs may be appended to one another
    parts: list[bytes] = []
    torn = False
    for start, stop in zip(files, [*files[1:], len(data)], strict=True):
        one = data[start:stop]
        walk = _walked(one)
        _refuse_too_large(path, walk, len(one))
        streams = [
            Stream(np.array([at for at, _ in rows]), np.array([us for _, us in rows]) / 1e6)
            for rows in walk.stamps.values()
        ]
        edges = [walk.data_at, *cuts(str(path), streams, ONBOARD_S), len(one)]
        parts += [_stretch(one, walk, first, last) for first, last in pairwise(edges)]
        torn |= walk.torn
    return Chain(tuple(parts), torn)


def _starts(data: bytes) -> list[int]:
    at, found = data.find(MAGIC), []
    while at >= 0:
        found.append(at)
        at = data.find(MAGIC, at + 1)
    return found


def _stretch(data: bytes, walk: _Walk, first: int, last: int) -> bytes:
    if first == walk.data_at and last == len(data):
        return data
    before = b"".join(data[a:b] for a, b in walk.lasting if walk.data_at <= a and b <= first)
    return data[: walk.data_at] + before + data[first:last]


def _walked(data: bytes) -> _Walk:
    """A last message that the end of the file cuts is no damage."""
    found = _Walk()
    sizes: dict[int, int] = {}  # of a topic's messages: always the same
    at = HEADER
    appended = False
    while at + 5 <= len(data):
        size, kind = int.from_bytes(data[at : at + 2], "little"), data[at + 2]
        body = at + 3
        if kind not in KINDS:
            found.torn = not appended
            break
        if kind == DATA:
            topic = data[body] | data[body + 1] << 8
            if sizes.setdefault(topic, size) != size:
                found.torn = not appended
                break
            if topic in found.stamps and size >= 10 and body + 10 <= len(data):
                found.stamps[topic].append((at, int.from_bytes(data[body + 2 : body + 10], "little")))
        elif kind == FLAGS:  # data were appended after a crash: the chain may break there
            appended = size >= 40 and any(data[at + 19 : at + 43])
        elif kind == FORMAT:
            name, _, fields = data[body : body + size].decode("ascii", "replace").partition(":")
            found.formats[name] = fields
        elif kind == SUBSCRIBED:
            topic = data[body + 1] | data[body + 2] << 8
            name = data[body + 3 : body + size].decode("ascii", "replace")
            found.subscribed[topic] = name
            if name in PACED and found.formats.get(name, "").startswith("uint64_t timestamp;"):
                found.stamps.setdefault(topic, [])
        if kind not in (DATA, TEXT, TAGGED, DROPOUT, SYNC):
            found.lasting.append((at, body + size))
        if not found.data_at and kind in (SUBSCRIBED, DATA, TEXT, TAGGED, DROPOUT, SYNC):
            found.data_at = at
        at = body + size
    found.data_at = found.data_at or min(at, len(data))
    return found


def _refuse_too_large(path: Path, walk: _Walk, length: int) -> None:
    """Raises InputError: formats may hold one another, and a few lines describe more than any memory has."""
    known: dict[str, tuple[int, int]] = {}  # bytes, fields
    fields = sum(_extent(path, name, walk.formats, known, ())[1] for name in walk.subscribed.values())
    if fields > max(length, LEAST_FIELDS):
        raise InputError(
            path, "", f"not a readable ULog file (it describes {fields} fields in {length} bytes)"
        )


def _extent(
    path: Path,
    name: str,
    formats: Mapping[str, str],
    known: dict[str, tuple[int, int]],
    within: tuple[str, ...],
) -> tuple[int, int]:
    """Bytes and fields of a format."""
    if name in known or name not in formats:
        return known.get(name, (1, 1))
    if name in within or len(within) > DEEPEST:
        raise InputError(path, f"format {name}", "is within itself: not a readable ULog file")
    size = count = 0
    for kind, times in _FIELD.findall(formats[name]):
        nested = kind not in _SIZES
        one = _extent(path, kind, formats, known, (*within, name)) if nested else (_SIZES[kind], 1)
        size += one[0] * int(times or 1)
        count += one[1] * int(times or 1)
        if size > MOST_BYTES:
            problem = f"describes more than the {MOST_BYTES} bytes of a message: not a readable ULog file"
            raise InputError(path, f"format {name}", problem)
    known[name] = size, count
    return known[name]
