"""Who holds a local port or a serial line, as far as Linux lets us see: the process that has it open.

/proc/net/udp, udp6, tcp and tcp6 (proc(5)): local address in field 2, state in field 4, inode in field 10.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

SHOWN = 120  # characters of a command line
LISTENING = "0A"  # TCP_LISTEN of the kernel's tcp_states.h
UNKNOWN = "another program"


def holder_of(port: int, kind: str, proc: Path = Path("/proc")) -> str:
    """The process that has local port `port` of `kind` (udp, tcp): "process 12 (mix ...)".

    "another program" where the system does not say: other users' processes, other systems.
    """
    with contextlib.suppress(OSError):
        return _process_with({f"socket:[{inode}]" for inode in _inodes(port, kind, proc)}, proc) or UNKNOWN
    return UNKNOWN


def holder_of_line(device: str, proc: Path = Path("/proc")) -> str:
    """The other process that has a serial line open, "" where none is seen.

    Two readers share a line's bytes between them: neither gets a message. The ends of pseudo terminals
    (/dev/pts) may be held open by whoever made them.
    """
    with contextlib.suppress(OSError):
        line = str(Path(device).resolve(strict=True))
        return "" if line.startswith("/dev/pts/") else _process_with({line}, proc, but=os.getpid())
    return ""


def _process_with(wanted: set[str], proc: Path, but: int = 0) -> str:
    for entry in sorted(proc.iterdir() if wanted else ()):
        if entry.name.isdecimal() and int(entry.name) != but and _has_open(entry, wanted):
            return f"process {entry.name} ({_command(entry)})"
    return ""


def _inodes(port: int, kind: str, proc: Path) -> Iterator[str]:
    for table in (proc / "net" / kind, proc / "net" / f"{kind}6"):
        with contextlib.suppress(OSError):
            for line in table.read_text("ascii", "replace").splitlines()[1:]:
                fields = line.split()
                here = len(fields) > 9 and fields[1].endswith(f":{port:04X}")
                if here and (kind == "udp" or fields[3] == LISTENING):
                    yield fields[9]


def _has_open(process: Path, wanted: set[str]) -> bool:
    with contextlib.suppress(OSError):  # another user's, or gone by now
        for number in (process / "fd").iterdir():
            with contextlib.suppress(OSError):
                if str(number.readlink()) in wanted:
                    return True
    return False


def _command(process: Path) -> str:
    """What it was started as, on one printable line: a process names itself as it likes."""
    try:
        words = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode("utf-8", "replace").strip()
    except OSError:
        words = ""
    shown = "".join(c if c.isprintable() else "?" for c in words[: SHOWN + 1])
    return (f"{shown[:SHOWN]}..." if len(shown) > SHOWN else shown) or "no name"
