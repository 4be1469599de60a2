"""Completion is made for the shell that asks for it; where none is found, one line says so."""

from __future__ import annotations

from collections.abc import Sequence

from coaxlink.errors import InputError

OPTIONS = ("--install-completion", "--show-completion")
SHELLS = ("bash", "zsh", "fish", "powershell", "pwsh")  # what typer completes for


def require_shell(arguments: Sequence[str]) -> None:
    """Nothing to say where no completion is asked for. Raises InputError outside these shells."""
    if not arguments or arguments[0] not in OPTIONS:
        return
    import shellingham  # typer's own way

    try:
        found = f"found {shellingham.detect_shell()[0]}"
    except shellingham.ShellDetectionFailure:
        found = "found none"
    if found.removeprefix("found ") not in SHELLS:
        raise InputError(arguments[0], "", f"one of {', '.join(SHELLS)} is expected to start it, {found}")
