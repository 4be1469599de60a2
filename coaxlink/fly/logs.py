"""The autopilot's log of a flight, down through MAVSDK, and held against the card by its CRC32."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from coaxlink import files
from coaxlink.errors import CheckFailed, InputError
from coaxlink.fly.bridge import Bridge

STALLED_S = 30.0  # without progress; a radio at 57600 baud still moves
SETTLES = 10  # looks at a file that the autopilot may still write
FOLDERS = ("/fs/microsd/log", "/APM/LOGS", "/logs")
DIFFERS = "differs"
Progress = Callable[[float], None]


@dataclass(frozen=True)
class Fetched:
    """A log that came down."""

    path: Path
    size: int
    sha256: str
    crc: str  # "same" as on the card, or why that is not known


class Logs:
    """The logs on board of one vehicle; MAVSDK's plugin remembers which entries it listed."""

    def __init__(self, bridge: Bridge) -> None:
        from mavsdk.plugins.log_files import LogFiles

        self.bridge, self._plugin = bridge, LogFiles(bridge.system)

    def entries(self) -> list[Any] | None:
        """What is on board, None where no logs are served."""
        from mavsdk.plugins.log_files import LogFilesError, LogFilesResult

        try:
            return list(self._plugin.get_entries())
        except LogFilesError as error:
            return [] if error.result == LogFilesResult.NO_LOGFILES else None

    def fetch(self, folder: Path, before: list[Any] | None, progress: Progress) -> Fetched:
        """The log that was written since `before`. Raises CheckFailed where there is none or it stalls."""
        from mavsdk.plugins.log_files import LogFilesResult

        entry = self._newest(before)
        ending = "bin" if self.bridge.session.identity.is_ardupilot else "ulg"
        path, part = folder / f"flight.{ending}", folder / f"part.{ending}"
        part.unlink(missing_ok=True)
        done = threading.Event()
        results: list[Any] = []
        moved = [time.monotonic()]

        def heard(result: Any, data: Any, *_: Any) -> None:
            moved[0] = time.monotonic()
            if result == LogFilesResult.NEXT:
                progress(float(data.progress))
                return
            results.append(result)
            done.set()

        self._plugin.download_log_file_async(entry, str(part), heard)
        while not done.wait(0.5):
            if time.monotonic() - moved[0] > STALLED_S:
                self._plugin.cancel_download_log_file()
                raise CheckFailed(f"the log stopped coming for {STALLED_S:.0f} s")
        if results[0] != LogFilesResult.SUCCESS:
            raise CheckFailed(f"the log did not come down ({results[0].name})")
        size = part.stat().st_size
        crc = _compared(self.bridge, part, size)
        if crc == DIFFERS:
            raise CheckFailed(f"{part}: its CRC32 differs from the card's")
        part.replace(path)
        return Fetched(path, size, files.sha256(path), crc)

    def _newest(self, before: list[Any] | None) -> Any:
        """The newest entry, once its size stands still."""
        known = {e.id: e.size_bytes for e in before or ()}
        last: Any = None
        for _ in range(SETTLES):
            found = self.entries()
            if not found:
                raise CheckFailed("the autopilot serves no log")
            new = [e for e in found if known.get(e.id, 0) != e.size_bytes and e.size_bytes > 0]
            if not new:
                raise CheckFailed("the autopilot wrote no new log")
            entry = max(new, key=lambda e: e.id)
            if last is not None and (last.id, last.size_bytes) == (entry.id, entry.size_bytes):
                return entry
            last = entry
            time.sleep(0.2)
        return last


def _compared(bridge: Bridge, path: Path, size: int) -> str:
    """Whether the card's own CRC32 of a file of this size is that of `path`."""
    from mavsdk.exceptions import MavsdkError
    from mavsdk.plugins.ftp import Ftp

    ftp = Ftp(bridge.system)
    for root in FOLDERS:
        try:
            for place in _files(ftp, root, size, 2):
                return "same" if ftp.are_files_identical(str(path), place) else DIFFERS
        except MavsdkError:
            continue
    return "not known: no file of this size is listed"


def _files(ftp: Any, folder: str, size: int, depth: int) -> list[str]:
    listed = ftp.list_directory(folder).entries
    found = [f"{folder}/{e.name}" for e in listed if e.size_bytes == size and not _is_folder(e)]
    for e in listed if depth else ():
        if _is_folder(e):
            found += _files(ftp, f"{folder}/{e.name}", size, depth - 1)
    return found


def _is_folder(entry: Any) -> bool:
    return "DIR" in str(getattr(entry.entry_type, "name", entry.entry_type)).upper()


def readable(path: Path) -> str | None:
    """Why a flight log cannot be refined, None when it can."""
    from coaxlink.data import read_flight_log

    try:
        read_flight_log(path)
    except InputError as error:
        return str(error)
    return None
