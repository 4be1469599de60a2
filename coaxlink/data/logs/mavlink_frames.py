"""The frames of a tlog, MAVLink 1 and 2, signed or not, and the fields of all messages of a kind at once.

A frame is believed by its checksum; fields and their order on the wire are those of pymavlink's dialect.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from fastcrc.crc16 import mcrf4xx
from numpy.typing import NDArray

from coaxlink import files
from coaxlink.errors import InputError
from firmware_params import bounded

STAMP = 8  # bytes of the recorder's clock before each frame
LONGEST_FRAME = STAMP + 10 + 255 + 2 + 13  # stamp, header, payload, checksum, signature
V1, V2 = 0xFE, 0xFD
SIGNED, SIGNATURE = 0x01, 13
TYPES = {
    "char": "S", "float": "<f4", "double": "<f8", "uint8_t": "u1", "int8_t": "i1", "uint16_t": "<u2",
    "int16_t": "<i2", "uint32_t": "<u4", "int32_t": "<i4", "uint64_t": "<u8", "int64_t": "<i8",
}  # fmt: skip

Sender = tuple[int, int]  # system, component


@dataclass(frozen=True)
class Rows:
    """All messages of one kind from one sender."""

    at: NDArray[np.int64]  # (n,) number of the frame in the file, increasing
    fields: NDArray[Any]  # (n,) structured, as on the wire

    def columns(self) -> dict[str, NDArray[np.float64]]:
        """Each field (n,) or (n, k)."""
        names = self.fields.dtype.names or ()
        return {name: self.fields[name].astype(float) for name in names}

    def has(self, field: str) -> bool:
        """Whether messages of this kind hold it."""
        return field in (self.fields.dtype.names or ())

    def rows(self, index: NDArray[np.int64]) -> Rows:
        """Those of an index array."""
        return Rows(self.at[index], self.fields[index])

    def between(self, first: int, last: int) -> Rows:
        """Those of the frames `first` to `last`."""
        rows = slice(*np.searchsorted(self.at, [first, last + 1]))
        return Rows(self.at[rows], self.fields[rows])


@dataclass(frozen=True)
class Heard:
    """What a tlog holds of the kinds that were asked for."""

    rows: dict[Sender, dict[str, Rows]]  # senders in the order in which they are first heard
    garbled: int  # frames of these kinds whose checksum is wrong
    left: int  # bytes that are in no frame
    clock_us: NDArray[np.int64]  # (frames,) the recorder's clock of every frame of the file


@dataclass(frozen=True)
class _Kind:
    name: str
    seed: bytes  # of the checksum
    layout: np.dtype[Any]
    found: dict[Sender, tuple[list[int], list[bytes]]] = field(
        default_factory=lambda: defaultdict(lambda: ([], []))
    )


def stamped_frames(path: Path) -> Iterator[tuple[int, bytes]]:
    """(recorder's clock in us since 1970, frame) of a tlog in order; a torn last frame is left out, damage is
    skipped. Raises InputError when there is more damage than log."""
    data = files.read_bytes(path, bounded.LOG)
    for start, end in _frames(data, path):
        yield int.from_bytes(data[start - STAMP : start], "big"), data[start:end]


def heard(path: Path, names: Collection[str]) -> Heard:
    """All messages of these names. Raises InputError when there is more damage than log."""
    data = files.read_bytes(path, bounded.LOG)
    kinds = _kinds(names)
    senders: dict[Sender, None] = {}
    garbled, left = 0, len(data)
    clock: list[bytes] = []
    for at, (start, end) in enumerate(_frames(data, path)):
        left -= STAMP + end - start
        clock.append(data[start - STAMP : start])
        if data[start] == V2:
            head, who = start + 10, start + 5
            number = data[start + 7] | data[start + 8] << 8 | data[start + 9] << 16
        else:
            head, who, number = start + 6, start + 3, data[start + 5]
        kind = kinds.get(number)
        if kind is None:
            continue
        stop = head + data[start + 1]
        if mcrf4xx(data[start + 1 : stop] + kind.seed) != data[stop] | data[stop + 1] << 8:
            garbled += 1  # on its way
            continue
        sender = data[who], data[who + 1]
        senders[sender] = None
        numbers, payloads = kind.found[sender]
        numbers.append(at)
        # zeros at the end are not sent; what is longer has fields that were added later
        size = kind.layout.itemsize
        payloads.append(data[head : min(stop, head + size)].ljust(size, b"\0"))
    rows: dict[Sender, dict[str, Rows]] = {sender: {} for sender in senders}
    for kind in kinds.values():
        for sender, (numbers, payloads) in kind.found.items():
            fields = np.frombuffer(b"".join(payloads), kind.layout)
            rows[sender][kind.name] = Rows(np.array(numbers), fields)
    return Heard(rows, garbled, left, np.frombuffer(b"".join(clock), ">i8").astype(np.int64))


def _frames(data: bytes, path: Path) -> Iterator[tuple[int, int]]:
    """(first byte, byte after the last) of each whole frame, as `stamped_frames`."""
    at = skipped = first = 0
    length = len(data)
    size = _frame_size(data, STAMP) if length > 2 * STAMP else 0
    while at + 2 * STAMP < length:
        start = at + STAMP
        end = start + size
        # a frame is believed when another, or the end, follows it: its first byte alone says little
        more = end + STAMP < length
        following = _frame_size(data, end + STAMP) if size and more else 0
        if size and (following or not more):
            if end <= length:
                yield start, end
            at, size = end, following
            continue
        if not skipped:
            first = start
        at, skipped = at + 1, skipped + 1
        if 2 * skipped > length:
            raise InputError(path, f"byte {first}", "a MAVLink frame is expected after each time stamp")
        size = _frame_size(data, at + STAMP) if at + STAMP < length else 0


def _frame_size(data: bytes, at: int) -> int:
    """Bytes of the frame that starts here, 0 if none does."""
    if data[at] == V2 and at + 3 <= len(data):
        return 12 + data[at + 1] + (SIGNATURE if data[at + 2] & SIGNED else 0)
    return 8 + data[at + 1] if data[at] == V1 and at + 2 <= len(data) else 0


def message_numbers(names: Collection[str]) -> frozenset[int]:
    """Of these messages."""
    return frozenset(_kinds(names))


def _kinds(names: Collection[str]) -> dict[int, _Kind]:
    """By number, as pymavlink has them and the ESCs' messages that it has not."""
    from pymavlink.dialects.v20 import common

    from firmware_params.ardupilot import messages as _esc_telemetry  # noqa: F401  registers it
    from firmware_params.px4 import messages as _esc_status  # noqa: F401  registers ESC_STATUS

    return {
        number: _Kind(message.msgname, bytes([message.crc_extra]), _layout(message))
        for number, message in common.mavlink_map.items()
        if message.msgname in names
    }


def _layout(message: Any) -> np.dtype[Any]:
    """The payload of one message."""
    types = dict(zip(message.fieldnames, message.fieldtypes, strict=True))
    wire = zip(message.ordered_fieldnames, message.array_lengths, strict=True)
    fields: list[Any] = []
    for name, count in wire:
        kind = TYPES[types[name]]
        fields.append((name, f"S{count}") if kind == "S" else (name, kind, (count,) if count else ()))
    return np.dtype(fields)
