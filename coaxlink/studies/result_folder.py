"""A folder of results that is complete or as it was before: Ctrl-C and errors leave no half of one."""

from __future__ import annotations

import shutil
import signal
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from coaxlink import _interrupts
from coaxlink.errors import InputError


@contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """SIGTERM ends the block as Ctrl-C does: what was begun is put right, and children are ended."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def complete_or_unchanged(out: Path, names: Sequence[str]) -> Iterator[None]:
    """Files and folders `names` of `out` may be made inside the block; when it fails they are as before.

    Earlier ones are put aside meanwhile. Other files in `out` are not touched, and a folder that was not
    there goes again. Raises InputError when the place cannot be written.
    """
    was_there = out.is_dir()
    try:
        _interrupts.begin()
        out.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(dir=out, prefix=".before-"))
        for name in names:
            if (out / name).exists():
                (out / name).replace(aside / name)
    except OSError as error:
        raise InputError(out, "", f"cannot be written ({error.strerror})") from error
    try:
        yield
    except BaseException:
        for name in names:
            _remove(out / name)
            if (aside / name).exists():
                (aside / name).replace(out / name)
        aside.rmdir()
        if not was_there and not any(out.iterdir()):
            out.rmdir()
        raise
    _remove(aside)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
