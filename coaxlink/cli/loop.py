"""`coaxlink loop`: fly, find what the model lacks, put it into the mixer, fly again."""

from __future__ import annotations

import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink.cli._shell import JsonOption, console, say, talk

if TYPE_CHECKING:
    from coaxlink.report.loop import LoopResult


def loop(
    truth: Annotated[
        Path | None,
        typer.Option(metavar="TRUTH.toml", help="What is true of the world; else drawn and hidden."),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the hidden effect and the noise.")] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where tables, logs and the report go.")] = Path(
        "loop"
    ),
    speed: Annotated[float, typer.Option(min=0.1, max=50, help="Simulator speed, times real time.")] = 8.0,
    live: Annotated[
        bool | None,
        typer.Option("--live/--table", help="How both flights are mixed; else by what the effects need."),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Fly, refine, re-table, fly again: the flight's allocation error before and after."""
    from coaxlink import files
    from coaxlink.cli._loop import run_loop
    from coaxlink.report.loop import write_report

    files.refuse_unwritable(json)
    if truth is not None:
        files.read_toml(truth)  # before anything is flown
    chosen = secrets.randbelow(1_000_000) if seed is None else seed
    with _whole_or_nothing(out) as work, _progress() as (tell, watch):
        result = run_loop(truth, chosen, work, speed, live, tell, watch)
        tell("drawing the report")
        result = replace(
            result, log_before=str(out / result.log_before), log_after=str(out / result.log_after)
        )
        write_report(work / "report.html", result)
    if json is not None:
        files.write_json(json, result.to_json())
    _show(result)
    say(f"report: {out / 'report.html'}   the same world again: --seed {chosen}")


def _show(result: LoopResult) -> None:
    from coaxlink.report.loop import lines, table
    from coaxlink.report.refine import tables, verdict

    screen = console()
    screen.print(verdict(result.refinement))
    for shown in tables(result.refinement):
        screen.print(shown)
    screen.print(table(result))
    for line in lines(result):
        screen.print(line)


@contextmanager
def _whole_or_nothing(out: Path) -> Iterator[Path]:
    """A folder beside `out` whose files move there when the block ends well, and vanish when it does not.

    Raises InputError when that place cannot be written.
    """
    from coaxlink.errors import InputError

    try:
        out.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(dir=out, prefix=".unfinished-"))
    except OSError as error:
        raise InputError(out, "", f"cannot be written ({error.strerror})") from error
    try:
        yield work
        for made in sorted(work.iterdir()):
            place = out / made.name
            if place.is_dir():
                shutil.rmtree(place)
            made.replace(place)
    finally:
        shutil.rmtree(work, ignore_errors=True)
        if not any(out.iterdir()):
            out.rmdir()


@contextmanager
def _progress() -> Iterator[tuple[Any, Any]]:
    """(tell, watch): a status line on a terminal, a line a step elsewhere."""
    screen = talk()
    with screen.status("coaxlink loop") as status:
        current = ""

        def tell(text: str) -> None:
            nonlocal current
            current = text
            status.update(text)
            if not screen.is_terminal:
                say(text)

        def watch(segment: str, seconds: float) -> None:
            status.update(f"{current}: {segment}, {seconds:.0f} s")

        yield tell, watch


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("loop")(loop)
