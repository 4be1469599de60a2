"""Who holds a local port or a serial line, as far as the system lets us see: the process that has it open."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any

SHOWN = 120  # characters of a command line
UNKNOWN = "another program"


def holder_of(port: int, kind: str) -> str:
    """The process that has local port `port` of `kind` (udp, tcp): "process 12 (mix ...)".

    "another program" where the system does not say: other users' processes, macOS without root.
    """
    import psutil

    with contextlib.suppress(psutil.Error, OSError):
        for held in psutil.net_connections(kind):
            here = held.laddr and held.laddr.port == port
            if here and held.pid and (kind == "udp" or held.status == psutil.CONN_LISTEN):
                return _named(psutil.Process(held.pid))
    return UNKNOWN


def holder_of_line(device: str) -> str:
    """The other process that has a serial line open, "" where none is seen; on Windows the port itself is
    refused.

    Two readers share a line's bytes between them: neither gets a message. The ends of pseudo terminals
    (/dev/pts) may be held open by whoever made them.
    """
    import psutil

    if os.name == "nt" or (line := os.path.realpath(device)).startswith("/dev/pts/"):
        return ""
    for process in psutil.process_iter() if Path(line).exists() else ():
        with contextlib.suppress(psutil.Error, OSError):  # another user's, or gone by now
            if process.pid != os.getpid() and line in _open_files(process):
                return _named(process)
    return ""


def _open_files(process: Any) -> set[str]:
    """Paths that a process has open, devices among them: psutil has those on macOS, on Linux regular files
    alone."""
    import psutil

    if not psutil.LINUX:
        return {opened.path for opened in process.open_files()}
    return {str(link.readlink()) for link in Path(f"/proc/{process.pid}/fd").iterdir()}


def _named(process: Any) -> str:
    """What it was started as, on one printable line: a process names itself as it likes."""
    import psutil

    words = ""
    with contextlib.suppress(psutil.Error):
        words = " ".join(process.cmdline()).strip()
    shown = "".join(c if c.isprintable() else "?" for c in words[: SHOWN + 1])
    shown = (f"{shown[:SHOWN]}..." if len(shown) > SHOWN else shown) or "no name"
    return f"process {process.pid} ({shown})"
