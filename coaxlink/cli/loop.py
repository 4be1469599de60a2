"""`coaxlink loop`: fly, find what the model lacks, put it into the mixer, fly again."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink.cli.shared.shell import JsonOption, console, say, talk
from coaxlink.studies.result_folder import complete_or_unchanged, terminated_as_interrupted

if TYPE_CHECKING:
    from coaxlink.studies.loop import LoopResult

FLIGHTS = ("before", "after", "separating", "live_before", "live_after")
MADE = (
    *("rotor.toml", "rotor_refined.toml", "tables", "backups", "report.html"),
    *(f"{name}.tlog" for name in FLIGHTS),
)


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
    separate: Annotated[
        bool,
        typer.Option("--separate", help="Where it is ambiguous, first fly what would separate the rivals."),
    ] = False,
    json: JsonOption = None,
) -> None:
    """Fly, refine, re-table, fly again: the flight's allocation error before and after.

    In the simulator, on the demo's vehicle. What the flight's data do not demand is not put into the mixer;
    then nothing changes, and that is said. How to do the same with an aircraft: docs/loop.md.
    """
    from coaxlink import files
    from coaxlink.report.loop import write_report
    from coaxlink.report.made import Made
    from coaxlink.studies.loop import run_loop

    files.refuse_unwritable(json)
    if truth is not None:
        _refuse_untrue(truth)
    chosen = secrets.randbelow(1_000_000) if seed is None else seed
    with terminated_as_interrupted(), complete_or_unchanged(out, MADE), _progress() as (tell, watch):
        result = run_loop(truth, chosen, out, speed, live=live, separate=separate, tell=tell, watch=watch)
        tell("drawing the report")
        flown = [log for log in (result.log_before, result.log_after, result.log_separating) if log]
        world = [truth] if truth is not None else []
        write_report(out / "report.html", result, Made.now([*world, *flown, out / "rotor.toml"], "demo-x8"))
    if json is not None:
        files.write_json(json, result.to_json())
    _show(result)
    say(f"report: {out / 'report.html'}   the same world again: --seed {chosen}")


def _refuse_untrue(truth: Path) -> None:
    """Raise InputError on a truth file that no world can be made of, before anything is flown.

    Nothing else is made of it here: only the simulator knows what it says.
    """
    from coaxlink import files
    from coaxlink.cli.sim import world_errors
    from sim.truth import read_truth

    files.read_toml(truth)
    with world_errors():
        read_truth(truth)


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
    app.command("loop", short_help="Fly, refine, make a new table, fly again.")(loop)
