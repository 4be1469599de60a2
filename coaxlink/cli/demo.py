"""`coaxlink demo`: the main job, end to end, on the embedded simulator."""

from __future__ import annotations

import secrets
from pathlib import Path
from typing import Annotated

import typer

from coaxlink.cli.shared.progress import progress
from coaxlink.cli.shared.shell import JsonOption, console, say
from coaxlink.studies.result_folder import complete_or_unchanged, terminated_as_interrupted

LOGS = ("standard.tlog", "fitted.tlog", "live_exact.tlog", "hidden.tlog")
MADE = ("rotor.toml", "rotor_refined.toml", "tables", "backups", "report.html", "demo.png", *LOGS)


def demo(
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Draws the effect that the last flight has and the model lacks."),
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Where models, tables, logs and report go.")
    ] = Path("demo"),
    speed: Annotated[float, typer.Option(min=0.1, max=50, help="Simulator speed, times real time.")] = 8.0,
    json_file: JsonOption = None,
) -> None:
    """Identify, make tables, upload, fly them side by side; find an effect that no model has: simulated."""
    from coaxlink import files

    files.refuse_unwritable(json_file)
    from coaxlink.report.demo import to_json, write_report
    from coaxlink.report.demo_words import answer, read_on
    from coaxlink.report.made import Made
    from coaxlink.studies.demo import STEPS, run_demo

    chosen = secrets.randbelow(1_000_000) if seed is None else seed
    with terminated_as_interrupted(), complete_or_unchanged(out, MADE):
        with progress("coaxlink demo", STEPS) as bar:
            result = run_demo(chosen, out, speed, bar.step, bar.watch, say)
        made = Made.now((*(out / name for name in LOGS), out / "rotor.toml"), "demo-x8")
        page = write_report(out, result, made)
    if json_file:
        files.write_json(json_file, to_json(result))
    screen = console()
    for line in answer(result):
        screen.print(line)
    screen.print()
    for line in read_on(page, out):
        screen.print(line, soft_wrap=True)
    say(f"again with the same hidden effect: coaxlink demo --seed {chosen}")
