"""Ctrl-C from the first moment: one line until something begins that must be put back, an exception from then
on.

Until then (a vehicle is on the line, a file is being written, processes run) the process just ends, in the
middle of an import or of a long call too. An exception would not do: where the interpreter ignores exceptions
(it takes an object away) it prints a traceback and goes on. From then on an interrupt is Python's own
exception, but not inside an import: half a module would stay behind. So it waits until none is under way.
"""

from __future__ import annotations

import _signal as signal  # type: ignore[import-not-found]  # the module without its enums: there at once
import os

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

INTERRUPTED = 130  # exit code after Ctrl-C, as shells have it: 128 + SIGINT
AGAIN_S = 0.02  # an import that goes on is asked again after this
_IMPORT = "importlib._bootstrap"


def leave(number: int, frame: FrameType | None) -> None:
    """Nothing has been begun, or all is done: one line and out."""
    if os.isatty(2):
        os.write(2, b"\r\x1b[2K\x1b[?25h")  # a status line goes, the cursor comes back
    os.write(2, b"coaxlink: interrupted\n")
    os._exit(INTERRUPTED)


def drop() -> None:
    """Out after an interrupt that was answered: an interpreter that takes its objects down takes a second."""
    import contextlib
    import sys

    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, OSError, ValueError):  # closed, or nobody reads it
            stream.flush()
    os._exit(INTERRUPTED)


def _go_to(handler: Callable[[int, FrameType | None], None]) -> None:
    """Where this is the main thread; a program that runs a verb in another one keeps its own handlers."""
    try:
        signal.signal(signal.SIGINT, handler)
    except ValueError:
        return


def _after_imports(number: int, frame: FrameType | None) -> None:
    """As Python's own handler, once no import is under way."""
    import threading

    while frame is not None:
        if frame.f_globals.get("__name__") == _IMPORT:
            again = threading.Timer(AGAIN_S, os.kill, (os.getpid(), signal.SIGINT))
            again.daemon = True
            again.start()
            return
        frame = frame.f_back
    raise KeyboardInterrupt


def end_at_once() -> None:
    """For a process that has begun nothing yet; not where SIGINT is ignored (nohup) or somebody else's."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        _go_to(leave)


def begin() -> None:
    """Something begins that has to be put back: from here on an interrupt is an exception."""
    if signal.getsignal(signal.SIGINT) is leave:
        import threading  # noqa: F401 - not first inside the handler

        _go_to(_after_imports)


def end() -> None:
    """Nothing is under way any more."""
    if signal.getsignal(signal.SIGINT) is _after_imports:
        signal.signal(signal.SIGINT, leave)
