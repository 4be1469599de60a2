"""What every verb shares: one-line errors, exit codes, consoles, option types."""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import shutil
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, TextIO

import typer

from coaxlink._interrupts import INTERRUPTED
from coaxlink.absent import absent
from coaxlink.cli.shared.completion import require_shell
from coaxlink.cli.shared.options import by_option
from coaxlink.errors import CoaxlinkError, InputError
from firmware_params.plain import plain_lines

JsonOption = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the result as one JSON object.")
]
WorkersOption = Annotated[
    int, typer.Option("--workers", min=0, help="Processes on this machine; 0: one a processor.")
]
SchedulerOption = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="A Dask scheduler, as tcp://HOST:8786, instead."),
]

FAULT = 70  # EX_SOFTWARE of sysexits.h: the fault is coaxlink's own, not the input's
# a disk or a pipe's end takes no more: the user's to mend
FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF}
NOTHING = 1e-6  # N, N m: what solvers leave of an error that is none
PIPE_WIDTH = 140  # columns of text that no screen bounds


def run(app: typer.Typer, arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code; users see one line, never a traceback."""
    if not _standard_streams():
        say("coaxlink: standard output is closed, and the result goes there: give it a file or /dev/null")
        return InputError.exit_code
    code = _run(app, arguments)
    if problem := _unwritten():
        say(f"coaxlink: {problem}")
        return code or InputError.exit_code
    return code


def _standard_streams() -> bool:
    """Whether stdout is open; closed stdin and stderr become empty ones, no file takes their place."""
    nothing = Path(os.devnull)
    if sys.stdin is None:
        sys.stdin = nothing.open(encoding="utf-8")
    if sys.stderr is None:
        sys.stderr = nothing.open("w", encoding="utf-8")
    return sys.stdout is not None


def _unwritten() -> str:
    """Why the last of what was printed does not go out (a full disk), "" when it does; it is dropped then."""
    problem = ""
    for name, stream in (("standard output", sys.stdout), ("standard error", sys.stderr)):
        try:
            stream.flush()
        except BrokenPipeError:
            _drop(stream)  # whoever read it has seen enough
        except OSError as error:
            problem = problem or f"{name} cannot be written ({error.strerror})"
            _drop(stream)
    return problem


def _drop(stream: TextIO) -> None:
    with contextlib.suppress(OSError, ValueError):
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, stream.fileno())
        os.close(nothing)
        stream.flush()


@functools.lru_cache(maxsize=1)
def _command(app: typer.Typer) -> Any:
    """The command line as click has it, once a process."""
    return typer.main.get_command(app)


def _run(app: typer.Typer, arguments: Sequence[str]) -> int:
    command = _command(app)
    try:
        require_shell(arguments)
        outcome = command.main(args=list(arguments), prog_name="coaxlink", standalone_mode=False)
    except CoaxlinkError as error:
        say(f"coaxlink: {error}")
        if text := getattr(error, "map", ""):
            head = "# the columns as they are understood: mend it, and give it as --columns"
            console().print(f"{head}\n{text}", markup=False, highlight=False, soft_wrap=True)
        return error.exit_code
    except (typer.Abort, KeyboardInterrupt):  # Ctrl-C at a question, or before the verb is there
        return interrupted()
    except BrokenPipeError:
        return 0
    except ImportError as error:
        missing = absent(error, next((a for a in arguments if not a.startswith("-")), "coaxlink"))
        if missing is None:
            return fault(error)
        say(f"coaxlink: {missing}")
        return missing.exit_code
    except Exception as error:
        if isinstance(error, OSError) and error.errno in FULL:
            what = error.filename or "an output"
            say(f"coaxlink: {_unwritten() or f'{what} cannot be written ({error.strerror})'}")
            return InputError.exit_code
        if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
            say(f"coaxlink: '{str(error.filename)[:40]}...': too long for the name of a file on this system")
            return InputError.exit_code
        # typer's usage errors, whichever click they come from, know their own text and exit code
        if not hasattr(error, "format_message"):
            return fault(error)
        help_shown = type(error).__name__ == "NoArgsIsHelpError"  # the help itself, which is no complaint
        say(error.format_message() if help_shown else f"coaxlink: {error.format_message()}")
        return int(getattr(error, "exit_code", 2))
    if outcome == INTERRUPTED:  # typer turns Ctrl-C into this code
        return interrupted()
    return outcome if isinstance(outcome, int) else 0


def interrupted() -> int:
    """Say so, and the exit code of it."""
    say("coaxlink: interrupted")
    return INTERRUPTED


def fault(error: Exception) -> int:
    """The last net: one line for what nobody foresaw, all of it in a file, and the exit code of it."""
    import tempfile
    import traceback

    what = f"{type(error).__name__}: {str(error).partition(chr(10))[0][:200]}"
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="coaxlink-fault-", suffix=".txt", delete=False, encoding="utf-8", errors="replace"
        ) as file:
            file.write("".join(traceback.format_exception(error)))
        where = f"; details in {file.name}"
    except OSError:
        where = ""
    say(f"coaxlink: this is a fault of coaxlink, please report it: {what}{where}")
    return FAULT


def say_vehicle(airframe: Path | None) -> None:
    """Which vehicle a flight was held against, where the user named none."""
    if airframe is None:
        say("no --airframe: held against the shipped x8_paper.toml, the paper's X8 of 20 kg; name your own")


def say(text: str) -> None:
    """Talk, to stderr, options by their names; nothing in it moves the cursor or colours the screen.

    A remark ("- ...") is broken between words where a screen is narrower; a line to copy never.
    """
    lines = plain_lines(by_option(text))
    if lines.startswith("- ") and sys.stderr.isatty():
        wide = shutil.get_terminal_size().columns
        lines = textwrap.fill(
            lines, wide, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
        )
    with contextlib.suppress(OSError):  # a full disk: the exit code still says it
        sys.stderr.write(f"{lines}\n")


def figure(value: float, digits: int = 3) -> str:
    """Significant digits of a force or torque error (N, N m); "0" where only a solver's rounding is left."""
    return f"{value:.{digits}g}" if abs(value) >= NOTHING else "0"


def console() -> Any:
    """Rich console for results (stdout); a pipe or file gets whole rows unless COLUMNS is set."""
    from coaxlink.cli.shared.console import PlainConsole

    bounded = sys.stdout.isatty() or os.environ.get("COLUMNS", "").isdigit()
    return PlainConsole(width=None if bounded else PIPE_WIDTH)


def talk() -> Any:
    """Rich console for progress and remarks (stderr)."""
    from coaxlink.cli.shared.console import PlainConsole

    return PlainConsole(stderr=True)
