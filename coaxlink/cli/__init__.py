"""The verbs, a module each. stdout is data, stderr is talk, exit codes are fixed (see coaxlink.errors).

A verb is the function of its module's name, and has its line in `shared.verbs`. Its module is loaded when it
is called; what is slow it imports inside its functions, so that `VERB --help` and the live path start fast.
"""

from __future__ import annotations

import contextlib
import functools
import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from coaxlink import _interrupts
from coaxlink.cli.shared.shell import interrupted, run
from coaxlink.cli.shared.verbs import Verbs

# verbs that have nothing to put back before they are on a line, write a file or start processes
READERS = (
    "airframe", "allocate", "bridge", "compare", "demo", "examples", "health", "identify", "init", "loop",
    "refine", "report", "reproduce", "table",
)  # fmt: skip


@functools.cache
def build_app() -> typer.Typer:
    """The command line with every verb."""
    app = typer.Typer(
        cls=Verbs,
        help="Make the lower rotors of coaxial multirotors pull their weight.",
        no_args_is_help=True,
        invoke_without_command=True,  # --version needs none
        subcommand_metavar="VERB [ARGS]...",
        add_completion=True,
        context_settings={"help_option_names": ["-h", "--help"]},
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )
    app.callback()(_options)
    return app


def _options(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and leave.")] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", help="With --version: the system and all packages, for a report.")
    ] = False,
) -> None:
    if version:
        from coaxlink.cli.shared.about import lines

        sys.stdout.write("".join(f"{line}\n" for line in lines(verbose=verbose)))
        raise typer.Exit
    if context.invoked_subcommand is None:
        context.fail("Missing command.")
    if context.invoked_subcommand not in READERS:
        _interrupts.begin()


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of the `coaxlink` command."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, ValueError):  # not a text file of ours
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    try:
        app = build_app()
    except KeyboardInterrupt:
        sys.exit(interrupted())
    sys.exit(run(app, sys.argv[1:] if arguments is None else list(arguments)))
