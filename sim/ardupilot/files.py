"""ArduPilot's file system over MAVLink (MAVFTP): a small tree in memory, and @PARAM/param.pck."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field

from sim.ardupilot.store import Store

ACK, NAK = 128, 129
TERMINATE, RESET, LIST, OPEN_RO, READ, CREATE, WRITE = 1, 2, 3, 4, 5, 6, 7
REMOVE, MAKE_DIRECTORY, OPEN_WO, TRUNCATE, RENAME, CRC32, BURST = 8, 9, 11, 12, 13, 14, 15
FAIL, NO_SESSION, EOF, UNKNOWN, EXISTS, NOT_FOUND = 1, 4, 6, 7, 8, 10
CHUNK = 239
PARAMS = "@PARAM/param.pck"
FULL = 512 * 1024  # bytes the card holds


class Files:
    """Paths and bytes. `/APM/scripts` of a board and `scripts` of a simulation are one folder."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.folders: set[str] = {""}

    @staticmethod
    def clean(path: str) -> str:
        """One name for one place."""
        return path.strip("/").removeprefix("APM/") if path.strip("/") != "APM" else ""

    def used(self) -> int:
        """Bytes on the card."""
        return sum(len(data) for data in self.files.values())

    def listing(self, folder: str) -> list[str] | None:
        """Entries as ListDirectory words them, or None without such a folder."""
        here = self.clean(folder)
        if here not in self.folders:
            return None
        lead = f"{here}/" if here else ""
        names = [
            f for f in self.folders if f and f.startswith(lead) and "/" not in f[len(lead) :] and f != here
        ]
        out = [f"D{f[len(lead) :]}" for f in sorted(names)]
        for path in sorted(self.files):
            if path.startswith(lead) and "/" not in path[len(lead) :]:
                out.append(f"F{path[len(lead) :]}\t{len(self.files[path])}")
        return out


@dataclass
class _Session:
    path: str
    writing: bool
    data: bytearray = field(default_factory=bytearray)


class Server:
    """Answers FILE_TRANSFER_PROTOCOL payloads of one peer; `reply` sends a payload of 251 bytes."""

    def __init__(self, files: Files, store: Store, reply: Callable[[bytes], None]) -> None:
        self._files, self._store, self._reply = files, store, reply
        self._session: _Session | None = None
        self._last: tuple[int, bytes] | None = None

    def hear(self, payload: bytes) -> None:
        """One request. A repeated one gets the answer it had: the first may have been lost."""
        number, session, code, size, _, _, _, offset = struct.unpack_from("<HBBBBBBI", payload)
        data = payload[12 : 12 + size]
        if self._last is not None and self._last[0] == number and code != BURST:
            self._reply(self._last[1])
            return
        if code == BURST:
            self._burst(number, session, offset, size or CHUNK)
            return
        ok, body, at = self._do(code, offset, size, data)
        answer = self._pack(number + 1, session, ACK if ok else NAK, code, body, at)
        self._last = (number, answer)
        self._reply(answer)

    def _pack(
        self, number: int, session: int, code: int, request: int, body: bytes, offset: int, done: int = 0
    ) -> bytes:
        head = struct.pack("<HBBBBBBI", number & 0xFFFF, session, code, len(body), request, done, 0, offset)
        return (head + body).ljust(251, b"\0")

    def _do(self, code: int, offset: int, size: int, data: bytes) -> tuple[bool, bytes, int]:
        path = data.split(b"\0")[0].decode(errors="replace")
        if code in (RESET, TERMINATE):
            return self._close()
        if code == LIST:
            return self._list(path, offset)
        if code in (OPEN_RO, CREATE, OPEN_WO):
            return self._open(code, path)
        if code == READ:
            return self._read(offset, size)
        if code == WRITE:
            return self._write(offset, data)
        if code == REMOVE:
            gone = self._files.files.pop(self._files.clean(path), None)
            return (True, b"", 0) if gone is not None else (False, bytes([NOT_FOUND]), 0)
        if code == MAKE_DIRECTORY:
            place = self._files.clean(path)
            if place in self._files.folders:
                return False, bytes([EXISTS]), 0
            self._files.folders.add(place)
            return True, b"", 0
        if code == RENAME:
            old, _, new = data.partition(b"\0")
            content = self._files.files.pop(self._files.clean(old.decode()), None)
            if content is None:
                return False, bytes([NOT_FOUND]), 0
            self._files.files[self._files.clean(new.strip(b"\0").decode())] = content
            return True, b"", 0
        if code == CRC32:
            content = self._content(path)
            if content is None:
                return False, bytes([NOT_FOUND]), 0
            return True, struct.pack("<I", zlib.crc32(content, 0xFFFFFFFF) ^ 0xFFFFFFFF), 0
        return False, bytes([UNKNOWN]), 0

    def _content(self, path: str) -> bytes | None:
        if path.lstrip("/").startswith(PARAMS):
            return self._store.packed()
        return self._files.files.get(self._files.clean(path))

    def _list(self, path: str, offset: int) -> tuple[bool, bytes, int]:
        entries = self._files.listing(path)
        if entries is None:
            return False, bytes([NOT_FOUND]), 0
        body = b""
        for entry in entries[offset:]:
            if len(body) + len(entry) + 1 > CHUNK:
                break
            body += entry.encode() + b"\0"
        return (True, body, offset) if body else (False, bytes([EOF]), 0)

    def _open(self, code: int, path: str) -> tuple[bool, bytes, int]:
        content = self._content(path)
        if code == OPEN_RO:
            if content is None:
                return False, bytes([NOT_FOUND]), 0
            self._session = _Session(path, False, bytearray(content))
            # the packed file is made while it is read: its size is a guess, and too large
            size = len(content) + (1000 if path.lstrip("/").startswith(PARAMS) else 0)
            return True, struct.pack("<I", size), 0
        folder = self._files.clean(path).rpartition("/")[0]
        if not path.lstrip("/").startswith(PARAMS) and folder not in self._files.folders:
            return False, bytes([FAIL]), 0
        start = bytearray(content or b"") if code == OPEN_WO else bytearray()
        self._session = _Session(path, True, start)
        self._keep()
        return True, struct.pack("<I", 0), 0

    def _read(self, offset: int, size: int) -> tuple[bool, bytes, int]:
        if self._session is None:
            return False, bytes([NO_SESSION]), 0
        body = bytes(self._session.data[offset : offset + min(size, CHUNK)])
        return (True, body, offset) if body else (False, bytes([EOF]), 0)

    def _write(self, offset: int, data: bytes) -> tuple[bool, bytes, int]:
        s = self._session
        if s is None or not s.writing:
            return False, bytes([NO_SESSION]), 0
        if self._files.used() + len(data) > FULL:
            return False, bytes([FAIL]), 0
        if len(s.data) < offset:
            s.data.extend(bytes(offset - len(s.data)))
        s.data[offset : offset + len(data)] = data
        self._keep()
        return True, b"", offset

    def _keep(self) -> None:
        s = self._session
        if s is not None and s.writing and not s.path.lstrip("/").startswith(PARAMS):
            self._files.files[self._files.clean(s.path)] = bytes(s.data)

    def _close(self) -> tuple[bool, bytes, int]:
        s, self._session = self._session, None
        if s is not None and s.writing and s.path.lstrip("/").startswith(PARAMS):
            taken = self._store.unpack(bytes(s.data))
            return (True, b"", 0) if taken else (False, bytes([FAIL]), 0)
        return True, b"", 0

    def _burst(self, number: int, session: int, offset: int, size: int) -> None:
        """A run of chunks; the last says so, or the end of file does."""
        if self._session is None:
            self._reply(self._pack(number + 1, session, NAK, BURST, bytes([NO_SESSION]), 0))
            return
        for k in range(40):
            body = bytes(self._session.data[offset : offset + min(size, CHUNK)])
            if not body:
                self._reply(self._pack(number + 1 + k, session, NAK, BURST, bytes([EOF]), offset))
                return
            self._reply(self._pack(number + 1 + k, session, ACK, BURST, body, offset, int(k == 39)))
            offset += len(body)
