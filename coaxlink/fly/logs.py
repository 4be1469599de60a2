"""The autopilot's log of a flight, down through MAVSDK, and held against the card by its CRC32.

MAVSDK runs on the session's line, while a log is listed or fetched: what the vehicle sends goes to both, what
MAVSDK sends goes out through the session. So the line stays ours: one peer, recorded, any address.
"""

from __future__ import annotations

import importlib.util
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from coaxlink import files
from coaxlink.errors import CheckFailed, InputError, LinkError
from coaxlink.mavlink import Session
from coaxlink.mavlink.ftp import Files
from firmware_params.ardupilot.scripts import file_crc

FOUND_S = 30.0  # of wall time: heartbeats come once a second of its time, and a simulation may be slow
STALLED_S = 30.0  # without progress; a radio at 57600 baud still moves
SETTLED_S = 1.5  # wall time without growth; ArduPilot's buffer goes to the card every second
SETTLES_S = 60.0  # ArduPilot writes 15 s of its own time more after disarming; a simulation may be slow
CRC_S = 30.0  # of wall time: a board reads a long log at a megabyte a second and more
FOLDERS = ("/fs/microsd/log", "/log", "/APM/LOGS", "/logs")  # boards and simulations of PX4, of ArduPilot
DIFFERS = "differs"
Progress = Callable[[float, int], None]  # share of the log that is here, its bytes


@dataclass(frozen=True)
class Fetched:
    """A log that came down."""

    path: Path
    size: int
    sha256: str
    crc: str  # "same" as on the card, or why that is not known


def _downloads() -> bool:
    """Whether the MAVSDK here is one that runs on a line of ours. Raises ModuleNotFoundError without one."""
    import mavsdk

    return importlib.util.find_spec(f"{mavsdk.__name__}.plugins") is not None


@contextmanager
def _plugin(session: Session) -> Iterator[Any]:
    """MAVSDK's plugin of log files on a session; afterwards nothing of MAVSDK sends any more.

    Raises LinkError when MAVSDK finds no autopilot.
    """
    from mavsdk.logging import log_subscribe
    from mavsdk.mavsdk import Configuration, Mavsdk
    from mavsdk.plugins.log_files import LogFiles

    log_subscribe(lambda *_: True)  # it writes to stdout, which is for results
    sdk = Mavsdk(Configuration.create_manual(*session.source, False))
    sdk.add_any_connection("raw://")
    sdk.subscribe_raw_bytes_to_be_sent(lambda data: session.send_bytes(bytes(data)))

    def hear(message: Any) -> None:
        sdk.pass_received_raw_bytes(bytes(message.get_msgbuf()))

    leave = session.subscribe(hear, whole_system=True)
    try:
        system = sdk.first_autopilot(timeout_s=FOUND_S)
        if system is None:
            raise LinkError(session.address, f"MAVSDK found no autopilot within {FOUND_S:.0f} s")
        yield LogFiles(system)
    finally:
        leave()
        sdk.destroy()


class Logs:
    """The logs on board of one vehicle. On a signed link none are served: MAVSDK's frames are not signed.

    Nor by MAVSDK 3, all that macOS 13 and 14 have: another interface, and no line of ours.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._served = not session.signed and _downloads()

    def entries(self) -> list[Any] | None:
        """What is on board, None where no logs are served."""
        if not self._served:
            return None
        with _plugin(self._session) as plugin:
            return _entries(plugin)

    def fetch(self, folder: Path, before: list[Any] | None, progress: Progress) -> Fetched:
        """The log that was written since `before`. Raises CheckFailed where there is none or it stalls."""
        if not self._served:
            raise CheckFailed("this line, or this MAVSDK, brings none down")
        with _plugin(self._session) as plugin:
            return self._fetched(plugin, folder, before, progress)

    def _fetched(self, plugin: Any, folder: Path, before: list[Any] | None, progress: Progress) -> Fetched:
        from mavsdk.plugins.log_files import LogFilesResult

        entry = _newest(plugin, before)
        ending = "bin" if self._session.identity.is_ardupilot else "ulg"
        path, part = folder / f"flight.{ending}", folder / f"part.{ending}"
        part.unlink(missing_ok=True)
        done = threading.Event()
        results: list[Any] = []
        moved = [time.monotonic()]

        def heard(result: Any, data: Any, *_: Any) -> None:
            moved[0] = time.monotonic()
            if result == LogFilesResult.NEXT:
                progress(float(data.progress), int(entry.size_bytes))
                return
            results.append(result)
            done.set()

        plugin.download_log_file_async(entry, str(part), heard)
        while not done.wait(0.5):
            if time.monotonic() - moved[0] > STALLED_S:
                plugin.cancel_download_log_file()
                raise CheckFailed(f"the log stopped coming for {STALLED_S:.0f} s")
        if results[0] != LogFilesResult.SUCCESS:
            raise CheckFailed(f"the log did not come down ({results[0].name})")
        size = part.stat().st_size
        crc = _compared(self._session, part, size)
        if crc == DIFFERS:
            raise CheckFailed(f"{part}: its CRC32 differs from the card's")
        part.replace(path)
        return Fetched(path, size, files.sha256(path), crc)


def _entries(plugin: Any) -> list[Any] | None:
    from mavsdk.plugins.log_files import LogFilesError, LogFilesResult

    try:
        return list(plugin.get_entries())
    except LogFilesError as error:
        return [] if error.result == LogFilesResult.NO_LOGFILES else None


def _newest(plugin: Any, before: list[Any] | None) -> Any:
    """The entry that is new or has grown, once its size stands still.

    PX4 numbers logs anew at every listing, in the order of the card's folders: a number is no name.
    """
    last: Any = None
    began = grew = time.monotonic()
    while True:
        found = _entries(plugin)
        if not found:
            raise CheckFailed("the autopilot serves no log")
        known = Counter((e.date, e.size_bytes) for e in before or ())
        new = []
        for entry in found:
            key = (entry.date, entry.size_bytes)
            if known[key]:
                known[key] -= 1
            elif entry.size_bytes > 0:
                new.append(entry)
        if not new:
            raise CheckFailed("the autopilot wrote no new log")
        newest, now = max(new, key=lambda e: (e.date, e.id)), time.monotonic()
        if last is None or last.size_bytes != newest.size_bytes:
            grew = now
        if now - grew > SETTLED_S or now - began > SETTLES_S:
            return newest
        last = newest
        time.sleep(0.5)


def _compared(session: Session, path: Path, size: int) -> str:
    """Whether the card's own CRC32 of a file of this size is that of `path`.

    By requests of ours: MAVSDK lists folders with their times, which ArduPilot's MAVFTP does not know.
    """
    listed = Files(session)
    slow = Files(session, timeout_s=CRC_S)
    ours = file_crc(path.read_bytes())
    try:
        places = [place for root in FOLDERS for place in _places(listed, root, size, 2)]
        if not places:
            return "not known: no file of this size is listed"
        return "same" if any(slow.crc(place) == ours for place in places) else DIFFERS
    except (CheckFailed, LinkError) as error:
        return f"not known: {error}"


def _places(board: Files, folder: str, size: int, depth: int) -> list[str]:
    entries = board.entries(folder) or []
    found = [f"{folder}/{name}" for name, bytes_ in entries if bytes_ == size]
    for name, bytes_ in entries if depth else ():
        if bytes_ is None:
            found += _places(board, f"{folder}/{name}", size, depth - 1)
    return found


def readable(path: Path) -> str | None:
    """Why a flight log cannot be refined, None when it can."""
    from coaxlink.data import read_flights

    try:
        read_flights(path)
    except InputError as error:
        return str(error)
    return None
