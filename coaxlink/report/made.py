"""How a page or a figure was made: command, vehicle, date, versions, commit, hashes of what went in."""

from __future__ import annotations

import hashlib
import platform
import shlex
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from coaxlink._version import __version__

LONG = 40  # characters of a file's name that a figure has room for
PATIENCE_S = 2.0  # for git, which may sit on a slow disk


@dataclass(frozen=True)
class Made:
    """What a reader needs to make it again; `files` are (name, SHA-256)."""

    command: str = ""
    vehicle: str = ""
    when: str = ""  # date and time, UTC
    commit: str = ""  # "" where coaxlink was installed without its repository
    files: tuple[tuple[str, str], ...] = ()

    @classmethod
    def now(cls, files: Iterable[str | Path] = (), vehicle: str = "") -> Made:
        """Of this command line, this moment, and these files (those that can be read)."""
        words = [Path(sys.argv[0]).name or "coaxlink", *sys.argv[1:]]
        command = shlex.join(words) if words[0] in ("coaxlink", "__main__.py") else ""
        stamp = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
        read = tuple((Path(f).name, digest) for f in files if (digest := _digest(Path(f))))
        return cls(command.replace("__main__.py", "coaxlink", 1), vehicle, stamp, _commit(), read)

    def line(self) -> str:
        """The stamp of a figure: vehicle, file, date, version and commit."""
        names = ", ".join(name if len(name) <= LONG else name[: LONG - 1] + "…" for name, _ in self.files[:3])
        more = f" and {len(self.files) - 3} more" if len(self.files) > 3 else ""
        code = f"coaxlink {__version__}" + (f" ({self.commit})" if self.commit else "")
        return " · ".join(part for part in (self.vehicle, names + more, self.when, code) if part)

    def versions(self) -> str:
        """Date and versions in one sentence."""
        import numpy

        commit = f", commit {self.commit}" if self.commit else ""
        code = (
            f"coaxlink {__version__}{commit}, Python {platform.python_version()}, numpy {numpy.__version__}"
        )
        return f"{self.when}; {code}; {platform.system()} {platform.machine()}."


def _digest(path: Path) -> str:
    """SHA-256 of a file, "" where there is none to read."""
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return ""


def _commit() -> str:
    """The repository's commit where coaxlink runs from one, marked where files differ from it."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return ""

    def git(*words: str) -> str:
        command = ["git", "-C", str(root), *words]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=True)
        return done.stdout.strip()

    try:
        changed = "-dirty" if git("status", "-s", "-uno") else ""
        return git("rev-list", "-n", "1", "HEAD")[:9] + changed
    except (OSError, subprocess.SubprocessError):
        return ""
