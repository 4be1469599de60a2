"""`coaxlink loop`: fly, find what the model lacks, put it into the mixer, fly again."""

from __future__ import annotations

import secrets
from pathlib import Path
from typing import Annotated

import typer

from coaxlink.cli.shared.progress import progress
from coaxlink.cli.shared.shell import JsonOption, console, say
from coaxlink.studies.result_folder import complete_or_unchanged, terminated_as_interrupted

FLIGHTS = ("before", "after", "live_before", "live_after")
MADE = (
    *("rotor.toml", "rotor_refined.toml", "tables", "backups", "report.html"),
    *(f"{name}.tlog" for name in FLIGHTS),
)


def loop(
    truth: Annotated[
        Path | None,
        typer.Option(metavar="TRUTH.toml", help="Effects of the simulated vehicle; else drawn at random."),
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
    """Fly, refine, re-table, fly again: the flight's allocation error before and after.

    In the simulator, on the demo's vehicle. What the flight's data do not demand is not put into the mixer;
    then nothing changes, and that is reported. How to do the same with an aircraft: docs/loop.md.
    """
    from coaxlink import files
    from coaxlink.report import loop as report
    from coaxlink.report import refine
    from coaxlink.report.made import Made
    from coaxlink.studies.loop import run_loop

    files.refuse_unwritable(json)
    if truth is not None:
        _refuse_untrue(truth)
    chosen = secrets.randbelow(1_000_000) if seed is None else seed
    page = out / "report.html"
    with terminated_as_interrupted(), complete_or_unchanged(out, MADE), progress("coaxlink loop") as bar:
        result = run_loop(truth, chosen, out, speed, live=live, tell=bar.step, watch=bar.watch)
        bar.step("drawing the report")
        flown = [result.log_before, result.log_after]
        sources: list[str | Path] = [*([truth] if truth else []), *flown, out / "rotor.toml"]
        files.write_atomic(page, report.page(result, Made.now(sources, "demo-x8")))
    if json is not None:
        files.write_json(json, result.to_json())
    screen = console()
    screen.print(refine.verdict(result.refinement))
    for shown in (*refine.tables(result.refinement), report.table_of(result), *report.lines(result)):
        screen.print(shown)
    say(f"report: {page}   the same simulated vehicle again: --seed {chosen}")


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
