"""The autopilots' file systems over MAVLink (MAVFTP): a small tree in memory, and one server a peer.

What differs between firmwares is said once, in `Manners`; what a path means beyond bytes on a card
(ArduPilot's packed parameters) a subclass of `Files` says.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field

ACK, NAK = 128, 129
NOTHING, TERMINATE, RESET, LIST, OPEN_RO, READ, CREATE, WRITE = range(8)
REMOVE, MAKE_DIRECTORY, REMOVE_DIRECTORY, OPEN_WO, TRUNCATE, RENAME, CRC32, BURST = range(8, 16)
FAIL, FAIL_ERRNO, SIZE, NO_SESSION, NONE_FREE, EOF, UNKNOWN, EXISTS, PROTECTED, NOT_FOUND = range(1, 11)
NOT_EMPTY = bytes([FAIL_ERRNO, 39])
CHUNK = 239
RUN = 40  # chunks of a burst
FULL = 512 * 1024  # bytes the card has for what peers write
LOGS = ("log/", "logs/")

Answer = tuple[bool, bytes, int]  # done, body, offset


@dataclass(frozen=True)
class Manners:
    """How a firmware serves files."""

    one_session: bool = False  # a second open file is refused until the first is closed
    counts_written: bool = False  # a write is answered by the bytes taken
    empty_folder_ends: bool = True  # an empty folder is answered as its end, else as a list of nothing
    unknown: int = UNKNOWN  # what a request is answered that it does not know


class CardFiles:
    """Paths and bytes. The card may go by several names: `homes`, each a path that means its root."""

    def __init__(self, *homes: str, protected: tuple[str, ...] = ()) -> None:
        self._homes, self._protected = homes, protected
        self.files: dict[str, bytes | bytearray] = {}
        self.folders: set[str] = {""}

    def clean(self, path: str) -> str:
        """One name for one place."""
        name = "/".join(part for part in path.split("/") if part not in ("", "."))
        for home in self._homes:
            if name == home or name.startswith(home + "/"):
                return name[len(home) + 1 :]
        return name

    def make(self, folder: str) -> None:
        """A folder, with those it lies in."""
        parts = folder.split("/")
        self.folders |= {"/".join(parts[: n + 1]) for n in range(len(parts))}

    def writable(self, path: str) -> bool:
        """Whether a peer may change what is there."""
        name = path.lstrip("/")
        return ".." not in name.split("/") and not name.startswith(self._protected)

    def read(self, path: str) -> bytes | None:
        """What is there now, or None."""
        found = self.files.get(self.clean(path))
        return None if found is None else bytes(found)

    def announced(self, path: str, size: int) -> int:
        """The size that an opened file is reported to have."""
        return size

    def begin(self, path: str, data: bytes) -> bool:
        """A peer opens `path` for writing, with this in it; False without its folder."""
        name = self.clean(path)
        if name.rpartition("/")[0] not in self.folders or name in self.folders:
            return False
        self.files[name] = data
        return True

    def keep(self, path: str, data: bytes) -> bool:
        """What is written so far; False when the card is full."""
        name = self.clean(path)
        used = sum(len(d) for p, d in self.files.items() if p != name and not p.startswith(LOGS))
        if used + len(data) > FULL:
            return False
        self.files[name] = data
        return True

    def end(self, path: str, data: bytes) -> bool:
        """The peer is done; False when what it wrote cannot be used."""
        return True

    def listing(self, folder: str) -> list[str] | None:
        """Entries as ListDirectory words them, or None without such a folder."""
        here = self.clean(folder)
        if here not in self.folders:
            return None
        lead = f"{here}/" if here else ""
        inside = [p for p in self.folders if p.startswith(lead) and "/" not in p[len(lead) :]]
        out = [f"D{p[len(lead) :]}" for p in sorted(inside) if p not in (here, "")]
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

    def __init__(self, files: CardFiles, manners: Manners, reply: Callable[[bytes], None]) -> None:
        self._files, self._manners, self._reply = files, manners, reply
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
        ok, body, at = (False, bytes([SIZE]), 0) if size > CHUNK else self._do(code, offset, size, data)
        answer = self._pack(number + 1, session, ACK if ok else NAK, code, body, at)
        self._last = (number, answer)
        self._reply(answer)

    def _pack(
        self, number: int, session: int, code: int, request: int, body: bytes, offset: int, done: int = 0
    ) -> bytes:
        head = struct.pack("<HBBBBBBI", number & 0xFFFF, session, code, len(body), request, done, 0, offset)
        return (head + body).ljust(251, b"\0")

    def _do(self, code: int, offset: int, size: int, data: bytes) -> Answer:
        path = data.split(b"\0")[0].decode(errors="replace")
        if code == NOTHING:
            return True, b"", 0
        if code in (RESET, TERMINATE):
            return self._close(code)
        if code == LIST:
            return self._list(path, offset)
        if code in (OPEN_RO, CREATE, OPEN_WO):
            return self._open(code, path)
        if code == READ:
            return self._read(offset, size)
        if code == WRITE:
            return self._write(offset, data)
        if code == CRC32:
            content = self._files.read(path)
            if content is None:
                return False, bytes([NOT_FOUND]), 0
            return True, struct.pack("<I", zlib.crc32(content, 0xFFFFFFFF) ^ 0xFFFFFFFF), 0
        return self._change(code, path, offset, data)

    def _change(self, code: int, path: str, size: int, data: bytes) -> Answer:
        """What moves, makes and removes."""
        f, name = self._files, self._files.clean(path)
        if code not in (REMOVE, MAKE_DIRECTORY, REMOVE_DIRECTORY, TRUNCATE, RENAME):
            return False, bytes([self._manners.unknown]), 0
        target = data.partition(b"\0")[2].strip(b"\0").decode(errors="replace")
        if not f.writable(path) or (code == RENAME and not f.writable(target)):
            return False, bytes([PROTECTED]), 0
        new = f.clean(target)
        if code == MAKE_DIRECTORY:
            if name in f.folders or name in f.files:
                return False, bytes([EXISTS]), 0
            if name.rpartition("/")[0] not in f.folders:
                return False, bytes([NOT_FOUND]), 0
            f.folders.add(name)
        elif code == REMOVE_DIRECTORY:
            if name not in f.folders or not name:
                return False, bytes([NOT_FOUND]), 0
            if f.listing(name):
                return False, NOT_EMPTY, 0
            f.folders.discard(name)
        elif name not in f.files:
            return False, bytes([NOT_FOUND]), 0
        elif code == REMOVE:
            del f.files[name]
        elif code == TRUNCATE:
            f.files[name] = bytes(f.files[name][:size]).ljust(min(size, FULL), b"\0")
        else:
            if new.rpartition("/")[0] not in f.folders or new in f.folders:
                return False, bytes([NOT_FOUND]), 0
            f.files[new] = f.files.pop(name)
        return True, b"", 0

    def _list(self, path: str, offset: int) -> Answer:
        entries = self._files.listing(path)
        if entries is None:
            return False, bytes([NOT_FOUND]), 0
        body = b""
        for entry in entries[offset:]:
            if len(body) + len(entry.encode()) + 1 > CHUNK:
                break
            body += entry.encode() + b"\0"
        ends = not body and (offset > 0 or self._manners.empty_folder_ends)
        return (False, bytes([EOF]), 0) if ends else (True, body, offset)

    def _open(self, code: int, path: str) -> Answer:
        f = self._files
        if self._session is not None and self._manners.one_session:
            return False, bytes([NONE_FREE]), 0
        content = f.read(path)
        if code == OPEN_RO:
            if content is None:
                return False, bytes([NOT_FOUND]), 0
            self._session = _Session(path, False, bytearray(content))
            return True, struct.pack("<I", f.announced(path, len(content))), 0
        if not f.writable(path):
            return False, bytes([PROTECTED]), 0
        start = (content or b"") if code == OPEN_WO else b""
        if not f.begin(path, start):
            return False, bytes([NOT_FOUND if self._manners.one_session else FAIL]), 0
        self._session = _Session(path, True, bytearray(start))
        return True, struct.pack("<I", 0), 0

    def _read(self, offset: int, size: int) -> Answer:
        if self._session is None:
            return False, bytes([NO_SESSION]), 0
        body = bytes(self._session.data[offset : offset + min(size, CHUNK)])
        return (True, body, offset) if body else (False, bytes([EOF]), 0)

    def _write(self, offset: int, data: bytes) -> Answer:
        s = self._session
        if s is None or not s.writing:
            return False, bytes([NO_SESSION]), 0
        if offset > FULL:
            return False, bytes([FAIL]), 0
        if len(s.data) < offset:
            s.data.extend(bytes(offset - len(s.data)))
        s.data[offset : offset + len(data)] = data
        if not self._files.keep(s.path, bytes(s.data)):
            return False, bytes([FAIL]), 0
        return True, struct.pack("<I", len(data)) if self._manners.counts_written else b"", offset

    def _close(self, code: int) -> Answer:
        s, self._session = self._session, None
        if s is None and code == TERMINATE and self._manners.one_session:
            return False, bytes([NO_SESSION]), 0
        if s is not None and s.writing and not self._files.end(s.path, bytes(s.data)):
            return False, bytes([FAIL]), 0
        return True, b"", 0

    def _burst(self, number: int, session: int, offset: int, size: int) -> None:
        """A run of chunks; the last says so, or the end of file does."""
        if self._session is None:
            self._reply(self._pack(number + 1, session, NAK, BURST, bytes([NO_SESSION]), 0))
            return
        for k in range(RUN):
            body = bytes(self._session.data[offset : offset + min(size, CHUNK)])
            if not body:
                self._reply(self._pack(number + 1 + k, session, NAK, BURST, bytes([EOF]), offset))
                return
            self._reply(self._pack(number + 1 + k, session, ACK, BURST, body, offset, int(k == RUN - 1)))
            offset += len(body)
