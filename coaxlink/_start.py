"""What the `coaxlink` command loads first: from here on Ctrl-C is one line, also while modules load.

Until a verb begins there is nothing to put back, and the process just ends. An exception would not do: where
the interpreter ignores exceptions (it takes an object away) it prints a traceback and goes on. From then on
an interrupt is Python's own exception, but not inside an import: half a module would stay behind. So it waits
until no import is under way.
"""

from __future__ import annotations

import _signal as signal  # type: ignore[import-not-found]  # the module without its enums: there at once
import os

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

INTERRUPTED = 130
AGAIN_S = 0.02  # an import that goes on is asked again after this
_IMPORT = "importlib._bootstrap"


def _leave(number: int, frame: FrameType | None) -> None:
    """Nothing has been begun, or all is done: one line and out."""
    os.write(2, b"coaxlink: interrupted\n")
    os._exit(INTERRUPTED)


def _interrupts_go_to(handler: Callable[[int, FrameType | None], None]) -> None:
    """Where this is the main thread; a program that runs a verb in another one keeps its own handlers."""
    try:
        signal.signal(signal.SIGINT, handler)
    except ValueError:
        return


# not where SIGINT is ignored (nohup, a script's background job) or somebody else's
if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    _interrupts_go_to(_leave)


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


def begin() -> None:
    """A verb begins: from here on an interrupt is an exception, for what has to be put back."""
    if signal.getsignal(signal.SIGINT) is _leave:
        import threading  # noqa: F401 - not first inside the handler

        _interrupts_go_to(_after_imports)


def main() -> None:
    """The command; ends with SystemExit."""
    from coaxlink.threads import ONE_THREAD

    for name in ONE_THREAD:
        os.environ.setdefault(name, "1")  # who has set it means it
    from coaxlink.cli import main as command

    try:
        command()
    except KeyboardInterrupt:  # between the verbs' own nets
        _leave(signal.SIGINT, None)
    finally:
        if signal.getsignal(signal.SIGINT) is _after_imports:
            signal.signal(signal.SIGINT, _leave)  # nothing is under way any more
