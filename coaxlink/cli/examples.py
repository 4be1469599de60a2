"""`coaxlink examples`: the files that come with coaxlink, listed and copied."""

from __future__ import annotations

import re
import sys
import tomllib
from itertools import takewhile
from pathlib import Path
from typing import Annotated

import typer

from coaxlink.cli.shared.shell import console, say
from coaxlink.errors import InputError
from coaxlink.report.terminal import table

_WHAT = {
    ".csv": "A stand log of the paper's pair, 121 points.",
    ".ipynb": "Stand log to table and back, a notebook with pictures.",
    ".json": "JSON schema of {} files, for editors.",
}
_REPORTED_OF_ALL = "What is true of"  # the line that every truth begins with


def examples(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME...]", help="What to copy, vehicles with their rotor models; nothing lists them."
        ),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where copies go.")] = Path(),
    everything: Annotated[bool, typer.Option("--all", help="Copy all of them.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace files that are there.")] = False,
) -> None:
    """List the shipped vehicles, rotor models, stand log and truths, or copy some of them."""
    from coaxlink import files

    shipped = {path.name: path for path in files.examples()}
    if not names and not everything:
        _list(shipped)
        return
    wanted = list(shipped) if everything else list(names or ())
    for name in wanted:  # all of them are known to be there before the first is written
        if name not in shipped:
            raise InputError(name, "", "no such example; coaxlink examples lists them")
        if (out / name).exists() and not force:
            raise InputError(out / name, "", "is there already; --force replaces it")
    needed = [rotor for name in wanted if (rotor := _rotor_of(shipped[name])) in shipped]
    # one's own rotor model of that name stays: nobody asked for the shipped one
    wanted += [rotor for rotor in dict.fromkeys(needed) if rotor not in wanted and not (out / rotor).exists()]
    for name in wanted:
        files.write_atomic(out / name, shipped[name].read_bytes())
        say(f"wrote {out / name}")


def _list(shipped: dict[str, Path]) -> None:
    if not sys.stdout.isatty():
        for name, path in shipped.items():  # a line each, for grep
            sys.stdout.write(f"{name:<30}  {_about(path)}".rstrip() + "\n")
        return
    rows = [(name, _about(path)) for name, path in shipped.items()]
    console().print(table("", ("file", "what it is"), rows, left=2))


def _rotor_of(path: Path) -> str:
    """The rotor model that a shipped vehicle names, "" where it names none."""
    if path.suffix != ".toml":
        return ""
    return str(tomllib.loads(path.read_text(encoding="utf-8")).get("rotor_model", ""))


def _about(path: Path) -> str:
    """The first sentences of its first comment, or of a script's docstring."""
    if path.suffix == ".py":
        return path.read_text(encoding="utf-8").partition('"""')[2].partition('"""')[0].partition("\n")[0]
    if path.suffix != ".toml":
        return _WHAT.get(path.suffix, "").format(path.name.partition(".")[0])
    lines = list(takewhile(lambda line: line.startswith("#"), path.read_text(encoding="utf-8").splitlines()))
    sentences = [line.removeprefix("#").strip() for line in lines]
    sentences = sentences[1:] if sentences and sentences[0].startswith(_REPORTED_OF_ALL) else sentences
    # a sentence ends where the next begins: "18.5 x 6.3 in" and "eq. 17" go on
    return re.split(r"(?<=\.) (?=[A-Z])", " ".join(sentences))[0]
