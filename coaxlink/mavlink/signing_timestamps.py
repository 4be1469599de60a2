"""The timestamps of signing on disk, never behind what was sent or believed, however the process ends.

They are written ahead in steps of AHEAD: what the file says has not been reached yet. One that was killed
begins again where its file ends, so nothing it sent or heard can be played back; on a clean end the file
says what really was. A vehicle raises its clock to ours with our first message, as MAVLink has it.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

from coaxlink import files
from coaxlink.errors import InputError
from coaxlink.mavlink.locks import lock, unlock

Stream = tuple[int, int, int]  # link, system, component
TICKS = 100_000  # a second, in signing's 10 us
# three kills in a row stay within the minute that a vehicle lets a new sender be behind
AHEAD = 20 * TICKS
_RETRY_S = 1.0
_MOST = 1 << 48  # a timestamp has six bytes, until 2104
END = _MOST - 3600 * TICKS  # none from here on is used: what is written ahead of it still has its six bytes


class Book:
    """The file of one key. Several processes may use it at a time: the highest of each counts."""

    def __init__(self, path: Path) -> None:
        """Raises InputError when the file is damaged or cannot be written."""
        self.path = path
        self.sent, self.heard = 0, dict[Stream, int]()
        self.trouble = ""  # why it could not be written ahead; a session in flight goes on
        self._writing = threading.Lock()
        self._wanted, self._closed = threading.Event(), False
        self._next = (0, dict[Stream, int]())
        self._tried_s = 0.0
        self._users = self._open(".users")
        lock(self._users, shared=True)  # goes with the process, however it ends
        try:
            self.sent, self.heard = self._read()
        except BaseException:
            os.close(self._users)
            raise
        threading.Thread(target=self._keep_up, name="coaxlink-signing", daemon=True).start()

    def cover(self, sent: int, heard: Mapping[Stream, int]) -> None:
        """Called before these are used: returns when the file is ahead of them.

        Mostly it is, and half a step before it is not, another thread writes it on.
        """
        if sent < self.sent and all(at < self.heard.get(stream, 0) for stream, at in heard.items()):
            left = [self.sent - sent, *(self.heard[stream] - at for stream, at in heard.items())]
            if min(left) < AHEAD // 2:
                self._next = (sent, dict(heard))
                self._wanted.set()
            return
        if self.trouble and time.monotonic() < self._tried_s + _RETRY_S:
            return
        self._ahead(sent, heard)

    def begin(self, sent: int) -> None:
        """Raises InputError when nothing can be kept."""
        self._ahead(sent, {})
        if self.trouble:
            raise InputError(self.path, "", self.trouble)

    def leave(self) -> None:
        """Nothing was sent or believed: the file stays as it is."""
        if not self._closed:
            self._closed = True
            self._wanted.set()
            os.close(self._users)

    def close(self, sent: int, heard: Mapping[Stream, int]) -> None:
        """Keep what really was, if nobody else uses the key just now. Raises InputError."""
        if self._closed:
            return
        self._closed = True
        self._wanted.set()
        with self._writing:
            try:
                unlock(self._users)
                with contextlib.suppress(BlockingIOError):
                    lock(self._users, wait=False)
                    files.write_json(self.path, _document(sent, {**self.heard, **heard}))
            finally:
                os.close(self._users)

    def _ahead(self, sent: int, heard: Mapping[Stream, int]) -> None:
        with self._writing:
            if self._closed:
                return
            self._tried_s = time.monotonic()
            most = sent + AHEAD, {s: at + AHEAD for s, at in heard.items()}
            try:
                with self._alone():
                    there = self._read()
                    merged = {**self.heard, **there[1]}
                    for stream, at in most[1].items():
                        merged[stream] = max(at, merged.get(stream, 0))
                    total = max(most[0], there[0])
                    files.write_json(self.path, _document(total, merged))
            except InputError as error:
                self.trouble = f"signing's timestamps cannot be stored: {error.problem}"
                return
            self.sent, self.heard, self.trouble = total, merged, ""

    def _keep_up(self) -> None:
        while not self._closed:
            self._wanted.wait()
            self._wanted.clear()
            if not self._closed:
                self._ahead(*self._next)

    def _read(self) -> tuple[int, dict[Stream, int]]:
        if not self.path.exists():
            return 0, {}
        raw = files.read_json(self.path)
        try:
            found = {(int(a), int(b), int(c)): int(last) for a, b, c, last in raw["streams"]}
            sent = int(raw["timestamp"])
            if not all(0 <= stamp < _MOST for stamp in (sent, *found.values())):
                raise ValueError
            return sent, found
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
            problem = (
                f"damaged ({type(error).__name__}); without it replays cannot be detected: "
                "take a new key, or remove it where nobody can have recorded this line"
            )
            raise InputError(self.path, "", problem) from error

    def _open(self, ending: str) -> int:
        path = self.path.with_suffix(ending)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            return os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        except OSError as error:
            raise InputError(path, "", f"cannot be written ({error.strerror})") from error

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        handle = self._open(".lock")
        try:
            lock(handle)
            yield
        finally:
            os.close(handle)


def _document(sent: int, heard: Mapping[Stream, int]) -> dict[str, object]:
    return {"timestamp": sent, "streams": [[*stream, last] for stream, last in heard.items()]}
