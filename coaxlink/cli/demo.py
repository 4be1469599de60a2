"""`coaxlink demo`: the main job, end to end, on the embedded simulator."""

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
    from coaxlink.fly.trajectory import Plan
    from coaxlink.studies.demo import DemoResult
    from coaxlink.studies.flight import Watch

LOGS = ("standard.tlog", "reduced.tlog", "fitted.tlog", "live_exact.tlog", "hidden.tlog")
RESIDUAL = ("residual.png", "residual.svg", "residual.pdf")
MADE = ("rotor.toml", "rotor_refined.toml", "tables", "backups", "report.html", *RESIDUAL, *LOGS)


def demo(
    seed: Annotated[
        int | None, typer.Option(min=0, help="Which effect the world hides; drawn at random if not given.")
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Where models, tables, logs and report go.")
    ] = Path("demo"),
    speed: Annotated[float, typer.Option(min=0.1, max=50, help="Simulator speed, times real time.")] = 8.0,
    json_file: JsonOption = None,
) -> None:
    """Identify, make tables, upload, fly them side by side; then find what a world hides: all simulated."""
    from coaxlink import files

    files.refuse_unwritable(json_file)
    chosen = secrets.randbelow(1_000_000) if seed is None else seed
    from coaxlink.report.demo import to_json
    from coaxlink.report.demo_page import write_report
    from coaxlink.report.made import Made
    from coaxlink.studies.demo import run_demo

    with terminated_as_interrupted(), complete_or_unchanged(out, MADE):
        with _progress() as (step, watch):
            result = run_demo(chosen, out, speed, step, watch, say)
        made = Made.now((*(out / name for name in LOGS), out / "rotor.toml"), "demo-x8")
        page = write_report(out, result, made)
    _show(result)
    if json_file:
        files.write_json(json_file, to_json(result))
    say(f"report: {page}   again with the same hidden effect: coaxlink demo --seed {chosen}")


@contextmanager
def _progress() -> Iterator[tuple[Any, Watch]]:
    """A bar of the steps and a bar of the flight under way; plain lines where stderr is no terminal."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from coaxlink.studies.demo import STEPS

    screen = talk()
    with Progress(
        TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn(), console=screen
    ) as progress:
        bar = progress.add_task("coaxlink demo", total=STEPS)
        flight = progress.add_task("", visible=False)

        def step(text: str, plan: Plan | None = None) -> None:
            progress.update(bar, description=text, advance=1)
            progress.update(flight, visible=False, total=plan.duration_s if plan else None)
            if not screen.is_terminal:
                say(text)

        def watch(segment: str, seconds: float) -> None:
            progress.update(flight, visible=True, completed=seconds, description=f"  {segment}")

        yield step, watch


def _show(result: DemoResult) -> None:
    from coaxlink.report.demo import tables as demo_tables
    from coaxlink.report.identify import tables as identify_tables

    screen = console()
    for table in (*identify_tables(result.identification), *demo_tables(result)):
        screen.print(table)


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("demo", short_help="Identify, make tables, upload and fly them side by side.")(demo)
