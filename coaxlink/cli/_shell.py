"""What every verb shares: one-line errors, exit codes, consoles, option types."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from coaxlink.errors import CoaxlinkError

JsonOption = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the result as one JSON object.")
]

INTERRUPTED = 130
PIPE_WIDTH = 140  # columns of text that no screen bounds


def run(app: typer.Typer, arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code; users see one line, never a traceback."""
    command = typer.main.get_command(app)
    try:
        outcome = command.main(args=list(arguments), prog_name="coaxlink", standalone_mode=False)
    except CoaxlinkError as error:
        say(f"coaxlink: {error}")
        return error.exit_code
    except (typer.Abort, KeyboardInterrupt):  # Ctrl-C at a question, or before the verb is there
        return interrupted()
    except BrokenPipeError:
        return 0
    except Exception as error:
        # typer's usage errors, whichever click they come from, know their own text and exit code
        if not hasattr(error, "format_message"):
            raise
        say(f"coaxlink: {error.format_message()}")
        return int(getattr(error, "exit_code", 2))
    if outcome == INTERRUPTED:  # typer turns Ctrl-C into this code
        return interrupted()
    return outcome if isinstance(outcome, int) else 0


def interrupted() -> int:
    """Say so, and the exit code of it."""
    say("coaxlink: interrupted")
    return INTERRUPTED


def say(text: str) -> None:
    """Talk, to stderr."""
    sys.stderr.write(f"{text}\n")


def console() -> Any:
    """Rich console for results (stdout); a pipe or file gets whole rows."""
    from rich.console import Console

    return Console(highlight=False, width=None if sys.stdout.isatty() else PIPE_WIDTH)


def talk() -> Any:
    """Rich console for progress and remarks (stderr)."""
    from rich.console import Console

    return Console(stderr=True, highlight=False)
