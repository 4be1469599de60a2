"""MAVLink's file transfer over a session: read, write, check, list; every request repeated until answered.

A client of our own, because files must travel in the session that is signed, counted and watched for arming;
a library brings a connection of its own. Writing goes to a side name, is checked by the board's CRC, and only
then takes the place of the old file.
"""

from __future__ import annotations

import random
import struct
import time
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import CheckFailed, LinkError
from coaxlink.link.session import Message, Session
from firmware_params.ardupilot.scripts import file_crc

_TERMINATE, _LIST, _OPEN_RO, _READ, _CREATE, _WRITE = 1, 3, 4, 5, 6, 7
_REMOVE, _MAKE_FOLDER, _RENAME, _CRC = 8, 9, 13, 14
_ACK, _NAK = 128, 129
_EOF, _EXISTS, _NOT_FOUND = 6, 8, 10
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
_HEAD = struct.Struct("<HBBBBBBI")  # number, session, code, size, request code, burst end, padding, offset
SIDE = ".new"


class FileError(CheckFailed):
    """The board refused a file request; `code` is MAVFTP's."""

    def __init__(self, what: str, code: int) -> None:
        self.code = code
        super().__init__(f"{what}: {_ERRORS.get(code, f'error {code}')} on board")


@dataclass(frozen=True)
class _Answer:
    session: int
    body: bytes


class Files:
    """The board's files; `retries` counts requests sent again."""

    def __init__(self, session: Session, *, timeout_s: float = 0.6, tries: int = 20) -> None:
        self._session = session
        self._timeout_s, self._tries = timeout_s, tries
        self._answer_s = 0.0  # how long an answer takes, smoothed; 0 until one came
        # a board answers a number it has just seen with what it said then, whoever asks
        self._number = random.randrange(65536)
        self.retries = 0

    def read(self, path: str) -> bytes | None:
        """A file, None when there is none. The size the board announces is not trusted: read to the end."""
        opened = self._maybe(_OPEN_RO, path.encode())
        if opened is None:
            return None
        data = b""
        try:
            while True:
                try:
                    part = self._request(
                        _READ, b"", session=opened.session, offset=len(data), size=_CHUNK
                    ).body
                except FileError as error:
                    if error.code == _EOF:
                        return data
                    raise
                if not part:
                    return data
                data += part
        finally:
            self._request(_TERMINATE, b"", session=opened.session)

    def write(self, path: str, data: bytes) -> None:
        """Put a file in place of the old one, once the board's CRC of it is right. Raises FileError."""
        side = path + SIDE
        self.remove(side)
        try:
            self.write_plain(side, data)
            if self.crc(side) != file_crc(data):
                raise CheckFailed(f"{path}: the board's checksum of what was written is wrong")
        except CheckFailed:
            self.remove(side)
            raise
        self.remove(path)
        self._request(_RENAME, side.encode() + b"\0" + path.encode())
        if self.crc(path) != file_crc(data):
            raise CheckFailed(f"{path}: the board's checksum is wrong after renaming")

    def write_plain(self, path: str, data: bytes) -> None:
        """Write straight to a name (@PARAM/param.pck and such have no other). Raises FileError."""
        session = self._request(_CREATE, path.encode()).session
        try:
            for offset in range(0, len(data), _CHUNK):
                self._request(_WRITE, data[offset : offset + _CHUNK], session=session, offset=offset)
        finally:
            self._request(_TERMINATE, b"", session=session)

    def crc(self, path: str) -> int | None:
        """The board's CRC32 of a file, None when there is none."""
        answer = self._maybe(_CRC, path.encode())
        return None if answer is None else int(struct.unpack("<I", answer.body[:4])[0])

    def remove(self, path: str) -> bool:
        """Remove a file; False when there was none."""
        return self._maybe(_REMOVE, path.encode()) is not None

    def make_folder(self, path: str) -> None:
        """Make a folder; one that is there already is fine."""
        try:
            self._request(_MAKE_FOLDER, path.encode())
        except FileError as error:
            if error.code not in (_EXISTS, 1, 2):  # ArduPilot says plainly "failed" for one that exists
                raise

    def listing(self, folder: str) -> list[str] | None:
        """Names of the files in a folder, None when there is no such folder."""
        names: list[str] = []
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
            names += [e[1:].split(b"\t")[0].decode(errors="replace") for e in entries if e[:1] == b"F"]

    # -- inside --------------------------------------------------------------------------------------------

    def _maybe(self, code: int, data: bytes) -> _Answer | None:
        try:
            return self._request(code, data)
        except FileError as error:
            if _missing(error):
                return None
            raise

    def _request(
        self, code: int, data: bytes, *, session: int = 0, offset: int = 0, size: int | None = None
    ) -> _Answer:
        self._number = (self._number + 1) % 65536
        number, target = self._number, self._session.identity
        head = _HEAD.pack(number, session, code, len(data) if size is None else size, 0, 0, 0, offset)
        message = mavlink.MAVLink_file_transfer_protocol_message(
            0, target.system, target.component, list((head + data).ljust(251, b"\0"))
        )

        def ours(answer: Message) -> bool:
            reply = _HEAD.unpack_from(bytes(answer.payload))
            return reply[0] == (number + 1) % 65536 and reply[4] == code and reply[2] in (_ACK, _NAK)

        wait_s = (
            min(max(4.0 * self._answer_s + 0.1, 0.15), self._timeout_s) if self._answer_s else self._timeout_s
        )
        started = time.monotonic()
        answer, again = self._session.exchange(
            message, ("FILE_TRANSFER_PROTOCOL",), ours, timeout_s=wait_s, tries=self._tries
        )
        self.retries += again
        if answer is not None and not again:
            took = time.monotonic() - started
            self._answer_s = 0.8 * self._answer_s + 0.2 * took if self._answer_s else took
        if answer is None:
            raise LinkError(self._session.address, f"no answer to a file request ({self._tries} tries)")
        payload = bytes(answer.payload)
        _, served, kind, length, _, _, _, _ = _HEAD.unpack_from(payload)
        body = payload[_HEAD.size : _HEAD.size + length]
        if kind == _NAK:
            code_given = body[0] if body else 1
            if code_given == 2 and len(body) > 1:  # the board's errno follows
                code_given = {_ERRNO_EXISTS: _EXISTS, _ERRNO_NONE: _NOT_FOUND}.get(body[1], 2)
            raise FileError(data.decode(errors="replace").replace("\0", " -> ") or "file request", code_given)
        return _Answer(served, body)


def _missing(error: FileError) -> bool:
    return error.code == _NOT_FOUND
