"""MAVLink's file transfer over a session: read, write, check, list; every request repeated until answered.

A client of our own, because files must travel in the session that is signed, counted and watched for arming:
MAVSDK's brings a connection of its own (and no signing), pymavlink's mavftp.py is GPL. Writing goes to a side
name, is checked by the board's CRC, and only then takes the place of the old file.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import CheckFailed, LinkError, SafetyRefusal
from coaxlink.mavlink.clock import Clock
from coaxlink.mavlink.request_window import Asker
from coaxlink.mavlink.session import Message, Session
from firmware_params.ardupilot.scripts import file_crc
from firmware_params.plain import name_problem

_TERMINATE, _LIST, _OPEN_RO, _READ, _CREATE, _WRITE = 1, 3, 4, 5, 6, 7
_REMOVE, _MAKE_FOLDER, _RENAME, _CRC = 8, 9, 13, 14
_ACK, _NAK = 128, 129
_NO_SESSION, _EOF, _EXISTS, _NOT_FOUND = 4, 6, 8, 10
_ERRORS = {
    1: "failed",
    2: "failed in its file system",
    3: "wrong size",
    4: "no such session",
    5: "no session free",
    6: "end of file",
    7: "unknown request",
    8: "exists already",
    9: "protected",
    10: "not found",
}
_ERRNO_EXISTS, _ERRNO_NONE = 17, 2
_CHUNK = 239
_WINDOW = 4  # a board keeps no more than five requests waiting
_ANSWER = "FILE_TRANSFER_PROTOCOL"
_HEAD = struct.Struct("<HBBBBBBI")  # number, session, code, size, request code, burst end, padding, offset
_WRITES = (_CREATE, _WRITE, _REMOVE, _MAKE_FOLDER, _RENAME)
SIDE = ".new"
_MADE = "@"  # names of files that the board makes and takes as they are closed (@PARAM/param.pck)
_TIMES, _LATE_S = 3, 0.3
MOST_BYTES = 4 << 20  # of a file read whole; all parameters and their metadata have 0.2 MB
MOST_NAMES = 2000  # of a folder; a card of scripts has some ten, a full one of logs some hundred

Result = TypeVar("Result")


class FileError(CheckFailed):
    """The board refused a file request; `code` is MAVFTP's."""

    def __init__(self, what: str, code: int) -> None:
        self.code = code
        super().__init__(f"{what}: {_ERRORS.get(code, f'error {code}')} on board")


class _Spoiled(CheckFailed):
    """What is on board is not what was sent."""


@dataclass(frozen=True)
class _Order:
    """A request without its number."""

    code: int
    data: bytes
    session: int = 0
    offset: int = 0
    size: int | None = None  # to be read; else that of the data


@dataclass(frozen=True)
class _Answer:
    session: int
    body: bytes


class Files:
    """The board's files."""

    def __init__(self, session: Session, *, timeout_s: float = 0.6) -> None:
        self._session = session
        self._asker = Asker(session, timeout_s=timeout_s, window=_WINDOW)
        # a board answers a number it has just seen with what it reported then, whoever asks
        self._number = random.randrange(65536)
        self._guard: Callable[[], None] | None = None

    @contextmanager
    def guarded(self, guard: Callable[[], None]) -> Iterator[None]:
        """Inside, `guard` is called before each request that changes the board; it may raise to stop."""
        self._guard = guard
        try:
            yield
        finally:
            self._guard = None

    @property
    def clock(self) -> Clock:
        """The session's."""
        return self._session.clock

    @property
    def retries(self) -> int:
        """Requests sent again."""
        return self._asker.retries

    def read(self, path: str) -> bytes | None:
        """A file, None when there is none. The size the board announces is not trusted: read to the end.

        Raises CheckFailed for one that goes on after MOST_BYTES.
        """

        def once() -> bytes | None:
            opened = self._maybe(_OPEN_RO, path.encode())
            if opened is None:
                return None
            try:
                return self._read_on(path, opened)
            finally:
                self._request(_TERMINATE, b"", session=opened.session)

        return self._again(once)

    def write(self, path: str, data: bytes) -> None:
        """Put a file in place of the old one, once the board's CRC of it is right. Raises FileError.

        A request that the line doubled and held up may undo a later one (a board knows only the last), and a
        restart ends a transfer: both show, and then all is done again.
        """
        self._again(lambda: self._write_once(path, data))

    def _write_once(self, path: str, data: bytes) -> None:
        side = path + SIDE
        self.remove(side)
        try:
            self.write_plain(side, data)
            if self.crc(side) != file_crc(data):
                raise _Spoiled(f"{path}: the board's checksum of what was written is wrong")
        except CheckFailed:
            self.remove(side)
            raise
        self.remove(path)
        self._request(_RENAME, side.encode() + b"\0" + path.encode())
        if self.crc(path) != file_crc(data):
            raise _Spoiled(f"{path}: the board's checksum is wrong after renaming")

    def write_plain(self, path: str, data: bytes) -> None:
        """Write straight to a name (@PARAM/param.pck and such have no other). Raises FileError."""
        session = self._request(_CREATE, path.encode()).session
        made, closes = path.startswith(_MADE), True
        try:
            self._write_chunks(path, data, session)
            if made and self._guard:
                self._guard()
        except SafetyRefusal:
            closes = not made  # closing is what makes a board take such a file
            raise
        finally:
            if closes:
                self._request(_TERMINATE, b"", session=session)

    def _write_chunks(self, path: str, data: bytes, session: int) -> None:
        orders = {
            offset: _Order(_WRITE, data[offset : offset + _CHUNK], session, offset)
            for offset in range(0, len(data), _CHUNK)
        }
        for answer in self._window(path, orders).values():
            if isinstance(answer, FileError):
                raise answer

    def crc(self, path: str) -> int | None:
        """The board's CRC32 of a file, None when there is none."""
        answer = self._maybe(_CRC, path.encode())
        if answer is None:
            return None
        if len(answer.body) < 4:
            raise CheckFailed(f"{path}: the board's checksum has {len(answer.body)} bytes, 4 are expected")
        return int(struct.unpack("<I", answer.body[:4])[0])

    def remove(self, path: str) -> bool:
        """Remove a file; False when there was none."""
        return self._maybe(_REMOVE, path.encode()) is not None

    def make_folder(self, path: str) -> None:
        """Make a folder; one that is there already is fine."""
        try:
            self._request(_MAKE_FOLDER, path.encode())
        except FileError as error:
            if error.code not in (_EXISTS, _NOT_FOUND, 1, 2):  # who needs it looks whether it is there
                raise

    def listing(self, folder: str) -> list[str] | None:
        """Names of the files in a folder, None when there is no such folder. Raises as `entries`."""
        found = self.entries(folder)
        return None if found is None else [name for name, size in found if size is not None]

    def entries(self, folder: str) -> list[tuple[str, int | None]] | None:
        """Names in a folder and bytes, None for a folder's; None when there is no such folder.

        Raises CheckFailed for a listing without an end and for names that would leave the folder.
        """
        names: list[tuple[str, int | None]] = []
        blocks: set[bytes] = set()
        count = 0
        while True:
            try:
                body = self._request(_LIST, folder.encode(), offset=count).body
            except FileError as error:
                if error.code == _EOF:
                    return names
                if _missing(error):
                    return None if not count else names
                raise
            entries = [entry for entry in body.split(b"\0") if entry]
            if not entries:
                return names
            count += len(entries)
            if count > MOST_NAMES or (body in blocks and entries != [b"S"] * len(entries)):
                raise CheckFailed(f"{folder}: the board's listing has no end ({count} names so far)")
            blocks.add(body)
            for entry in entries:
                kind, (name, _, size) = entry[:1], entry[1:].decode(errors="replace").partition("\t")
                if kind not in (b"F", b"D") or (kind == b"D" and name in (".", "..")):
                    continue
                if "/" in name or name in ("", ".", "..") or name_problem(name, _CHUNK):
                    raise CheckFailed(f"{folder}: the board lists '{name}', which is no name of a file")
                names.append((name, (int(size) if size.isdecimal() else 0) if kind == b"F" else None))

    # -- inside --------------------------------------------------------------------------------------------

    def _again(self, work: Callable[[], Result]) -> Result:
        """Do it up to three times; what a fault of the file system refused stays refused."""
        for _ in range(_TIMES - 1):
            try:
                return work()
            except (_Spoiled, FileError) as error:
                if isinstance(error, FileError) and error.code not in (_NO_SESSION, _NOT_FOUND):
                    raise
                self.clock.sleep(_LATE_S)  # until what is under way has come
        return work()

    def _maybe(self, code: int, data: bytes) -> _Answer | None:
        try:
            return self._request(code, data)
        except FileError as error:
            if _missing(error):
                return None
            raise

    def _read_on(self, path: str, opened: _Answer) -> bytes:
        """The rest of an open file, a window of chunks at a time, up to the first that is short."""
        data = b""
        ahead = 1  # most files that are read are small, and a chunk past the end costs a request as well
        while True:
            orders = {
                offset: _Order(_READ, b"", opened.session, offset, _CHUNK)
                for offset in range(len(data), len(data) + ahead * _CHUNK, _CHUNK)
            }
            answers = self._window(path, orders)
            for offset in orders:
                answer = answers[offset]
                if isinstance(answer, FileError):
                    if answer.code == _EOF:
                        return data
                    raise answer
                data += answer.body
                if len(answer.body) < _CHUNK:
                    return data
            if len(data) > MOST_BYTES:
                raise CheckFailed(f"{path}: the board's file has no end ({len(data)} bytes so far)")
            ahead = min(2 * ahead, 8 * _WINDOW)

    def _window(self, path: str, orders: Mapping[int, _Order]) -> dict[int, _Answer | FileError]:
        """Several requests at once, by any key. Raises LinkError."""
        answers: dict[int, _Answer | FileError] = {}
        keys: dict[int, int] = {}  # request number -> key
        requests: dict[int, Callable[[], Message]] = {}
        for key, order in orders.items():
            number, message = self._message(order)
            keys[number] = key
            requests[key] = _guarded(self._guard if order.code in _WRITES else None, message)

        def settle(message: Message) -> int | None:
            payload = bytes(message.payload)
            reply = _HEAD.unpack_from(payload)
            key = keys.get((reply[0] - 1) % 65536)
            if key is None or reply[4] != orders[key].code or reply[2] not in (_ACK, _NAK):
                return None
            answers[key] = _answer(payload, path)
            return key

        if self._asker.gather(requests, (_ANSWER,), settle):
            raise LinkError(self._session.address, f"{path}: no answer to a file request")
        return answers

    def _message(self, order: _Order) -> tuple[int, Message]:
        self._number = (self._number + 1) % 65536
        target = self._session.identity
        size = len(order.data) if order.size is None else order.size
        head = _HEAD.pack(self._number, order.session, order.code, size, 0, 0, 0, order.offset)
        payload = list((head + order.data).ljust(251, b"\0"))
        message = mavlink.MAVLink_file_transfer_protocol_message(0, target.system, target.component, payload)
        return self._number, message

    def _request(self, code: int, data: bytes, *, session: int = 0, offset: int = 0) -> _Answer:
        what = data.decode(errors="replace").replace("\0", " -> ") or "file request"
        answer = self._window(what, {0: _Order(code, data, session, offset)})[0]
        if isinstance(answer, FileError):
            raise answer
        return answer


def _answer(payload: bytes, what: str) -> _Answer | FileError:
    _, served, kind, length, _, _, _, _ = _HEAD.unpack_from(payload)
    body = payload[_HEAD.size : _HEAD.size + length]
    if kind == _ACK:
        return _Answer(served, body)
    code = body[0] if body else 1
    if code == 2 and len(body) > 1:  # the board's errno follows
        code = {_ERRNO_EXISTS: _EXISTS, _ERRNO_NONE: _NOT_FOUND}.get(body[1], 2)
    return FileError(what, code)


def _guarded(guard: Callable[[], None] | None, message: Message) -> Callable[[], Message]:
    def request() -> Message:
        if guard:
            guard()
        return message

    return request


def _missing(error: FileError) -> bool:
    return error.code == _NOT_FOUND
