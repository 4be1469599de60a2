"""Completion is made for the shell that asks for it; where none is found, one line says so. And the values
that options complete to."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from coaxlink.errors import InputError

OPTIONS = ("--install-completion", "--show-completion")
SHELLS = ("bash", "zsh", "fish", "powershell", "pwsh")  # what typer completes for


def one_of(*values: str) -> Callable[[str], list[str]]:
    """What typer asks for the values of an option."""

    def complete(incomplete: str) -> list[str]:
        return [value for value in values if value.startswith(incomplete)]

    return complete


def laws(incomplete: str) -> list[str]:
    """Names of the laws that allocate and mix."""
    from coaxlink.mixer.registry import LAWS

    return one_of(*LAWS)(incomplete)


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
