"""Log libraries print about damaged files, some from compiled code; stdout is for results: silence."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Send both output streams, down to their file descriptors, nowhere for a while."""
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
        sys.stderr.flush()
    with (
        Path(os.devnull).open("w", encoding="utf-8") as nowhere,
        contextlib.redirect_stdout(nowhere),
        contextlib.redirect_stderr(nowhere),
        contextlib.ExitStack() as back,
    ):
        for descriptor in (1, 2):
            with contextlib.suppress(OSError):  # closed by a daemon: nothing to silence
                copy = os.dup(descriptor)
                back.callback(os.close, copy)
                back.callback(os.dup2, copy, descriptor)
                os.dup2(nowhere.fileno(), descriptor)
        yield


def one_line(error: BaseException) -> str:
    """An error's text on one line, its type where it has none."""
    return " ".join(str(error).split())[:120] or type(error).__name__
