"""The verbs, a module each. stdout is data, stderr is talk, exit codes are fixed (see coaxlink.errors).

A verb module defines `register(app)`; it imports what is slow inside its functions, so that
`coaxlink --help` and the live path start fast.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import pkgutil
import sys
from collections.abc import Sequence
from typing import Annotated

import typer

import coaxlink
from coaxlink import _interrupts
from coaxlink.cli.shared.shell import interrupted, run


@functools.cache
def build_app() -> typer.Typer:
    """The command line with every verb found in this package."""
    app = typer.Typer(
        help="Make the lower rotors of coaxial multirotors pull their weight.",
        no_args_is_help=True,
        add_completion=True,
        context_settings={"help_option_names": ["-h", "--help"]},
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )
    app.callback()(_options)
    for module in pkgutil.iter_modules(__path__):
        if not module.ispkg:  # what verbs share
            importlib.import_module(f"{__name__}.{module.name}").register(app)
    return app


def _version(requested: bool) -> None:
    if requested:
        sys.stdout.write(f"coaxlink {coaxlink.__version__}\n")
        raise typer.Exit


def _options(
    version: Annotated[
        bool,
        # eager: it is an answer of its own, no verb need follow
        typer.Option("--version", help="Print the version and leave.", callback=_version, is_eager=True),
    ] = False,
) -> None:
    _interrupts.begin()  # the line is understood as far as the verb


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
