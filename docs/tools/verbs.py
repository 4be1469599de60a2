"""The reference of verbs, from the command line's own parser."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

import typer

from coaxlink import errors
from coaxlink.cli import build_app

HEAD = """# Verbs

Made from the command line's own parser (`docs/tools/verbs.py`): what stands here is what `coaxlink VERB --help` says.
Results go to stdout, talk goes to stderr. `--json FILE` writes one JSON object, whole or not at all.

| exit code | means |
|---|---|
| 0 | done |
"""
TAIL = """| 70 | a fault of coaxlink's own |
| 130 | interrupted |
"""


def command() -> Any:
    """The whole command line as click sees it."""
    return typer.main.get_command(build_app())


def page() -> str:
    """Markdown: a heading a verb, a table of its arguments and options."""
    parts = [HEAD + "".join(_codes()) + TAIL]
    parts += [_verb(name, verb) for name, verb in sorted(command().commands.items())]
    return "\n".join(parts)


def _codes() -> Iterator[str]:
    """A row an exception: its code, the first line of its docstring."""
    for _, kind in sorted(
        inspect.getmembers(errors, inspect.isclass), key=lambda m: getattr(m[1], "exit_code", 0)
    ):
        if issubclass(kind, errors.CoaxlinkError) and kind is not errors.CoaxlinkError:
            first = (kind.__doc__ or "").splitlines()[0].rstrip(".")
            yield f"| {kind.exit_code} | {first} |\n"


def _verb(name: str, verb: Any) -> str:
    context = verb.make_context(name, [], resilient_parsing=True)
    usage = " ".join(verb.collect_usage_pieces(context))
    records = [one.get_help_record(context) for one in verb.get_params(context)]
    rows = [f"| `{_cell(names)}` | {_cell(_plain(says))} |" for names, says in filter(None, records)]
    table = "\n".join(("| option | what it does |", "|---|---|", *rows))
    text = inspect.cleandoc(verb.help or "")
    return f"## {name}\n\n{_plain(text)}\n\n```text\ncoaxlink {name} {usage}\n```\n\n{table}\n"


def _plain(text: str) -> str:
    """Help text is no Markdown: its brackets and stars are its own."""
    return text.replace("<", "&lt;").replace("*", "\\*").replace("[", "\\[")


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")
