"""`coaxlink campaign`: thousands of flights from one file, their rows, and what they say."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink.cli.shared.shell import JsonOption, SchedulerOption, WorkersOption, console, say

if TYPE_CHECKING:
    from coaxlink.studies.campaign.spec import Spec


def campaign(
    file: Annotated[Path, typer.Argument(metavar="FILE.toml", help="What is varied, and which laws fly it.")],
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Rows and report; else campaign-NAME here.")
    ] = None,
    workers: WorkersOption = 0,
    scheduler: SchedulerOption = None,
    replay: Annotated[
        int | None, typer.Option(metavar="CELL", min=0, help="Fly this one again: its row, log and files.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be flown, and leave.")] = False,
    json: JsonOption = None,
) -> None:
    """Fly a campaign in the simulated world; stopped, it goes on where it was."""
    from coaxlink import files
    from coaxlink.absent import refuse_windows
    from coaxlink.errors import InputError
    from coaxlink.studies.campaign.spec import read_spec
    from coaxlink.studies.campaign_cells import known_effects

    refuse_windows("campaign")
    files.refuse_unwritable(json)
    spec = read_spec(file, known_effects())
    folder = out or Path(f"campaign-{spec.name}")
    if replay is not None:
        if replay >= spec.cells:
            raise InputError("--replay", str(replay), f"a cell from 0 to {spec.cells - 1} is expected")
        _replay(spec, replay, folder, json)
        return
    plain = f"{spec.cells} flights of {spec.seconds:g} s: {spec.draws} draws x {', '.join(spec.laws)}"
    if dry_run:
        console().print(f"{plain}; varied: {', '.join(n for n, q in spec.quantities.items() if q.varies)}")
        return
    say(f"{plain}; rows to {folder / 'rows'}")
    _fly(spec, folder, workers, scheduler)
    _tell(spec, file, folder, json)


def _fly(spec: Spec, folder: Path, workers: int, scheduler: str | None) -> None:
    import contextlib

    from coaxlink.studies.campaign.dataset import Dataset
    from coaxlink.studies.campaign.engine import Machine, run
    from coaxlink.studies.campaign.progress import Progress
    from coaxlink.studies.campaign_cells import Payload, code_hash, columns, fly_cells

    payload = Payload(spec, code_hash())
    decides = {"campaign": spec.name, "digest": spec.digest, "seed": spec.seed, "code": payload.code}
    with Dataset(folder, columns(spec), spec.cells, decides) as dataset:
        if dataset.done:
            say(f"{dataset.done} of {spec.cells} are there already")
        progress = Progress(spec.cells, dataset.done, "flights", _write, sys.stderr.isatty())
        machine = Machine(workers, scheduler)
        try:
            tasks = run(fly_cells, payload, dataset.missing(), machine, len(spec.laws))
            with contextlib.closing(tasks):
                for done in tasks:
                    dataset.add(done.rows)
                    progress.at(dataset.done)
        except KeyboardInterrupt:
            dataset.flush()
            say(f"\nstopped at {dataset.done} of {spec.cells}; the same command goes on from there")
            raise
        progress.end(dataset.done)


def _tell(spec: Spec, file: Path, folder: Path, json: Path | None) -> None:
    """The summary on the screen, as JSON, and as a page beside the rows."""
    from rich.table import Table

    from coaxlink import files
    from coaxlink.report import campaign as report
    from coaxlink.report.made import Made
    from coaxlink.studies.campaign.dataset import MANIFEST, columns_of
    from coaxlink.studies.campaign.summary import summarise

    columns = columns_of(folder)
    replay = f"coaxlink campaign {file} --out {folder} --replay"
    summary = summarise(spec, columns, replay, files.read_json(folder / MANIFEST))
    files.write_json(folder / "summary.json", summary.to_json())
    files.write_atomic(folder / "report.html", report.page(summary, columns, Made.now([file])))
    if json is not None:
        files.write_json(json, summary.to_json())
    screen = console()
    for line in report.sentences(summary):
        screen.print(line)
    for heads, rows in (
        (("figure", *summary.laws), report.spread_rows(summary)),
        (report.SENSITIVITY_HEADS, report.sensitivity_rows(summary)),
        # the command that flies one again stands below, once and in one piece
        (report.WORST_HEADS[:-1], [row[:-1] for row in report.worst_rows(summary)]),
    ):
        if rows:
            table = Table(*heads, box=None)
            for row in rows:
                table.add_row(*row)
            screen.print(table)
    say(f"one flight again, with its log: {replay} CELL")
    say(f"wrote {folder / 'report.html'}, {folder / 'summary.json'}; rows: {folder / 'rows' / '*.parquet'}")


def _replay(spec: Spec, number: int, folder: Path, json: Path | None) -> None:
    """One cell again: its row on the screen, its flight log and what it flew as files."""
    from coaxlink import files
    from coaxlink.studies.campaign.cells import cell
    from coaxlink.studies.campaign_cells import Payload, code_hash, columns, fly_cell, fly_cells

    cell_folder = folder / f"cell-{number:09d}"
    files.refuse_unwritable(cell_folder / "flight.csv")
    one = cell(spec, number)
    fly_cell(spec, one, cell_folder / "flight.csv", cell_folder)
    rows = fly_cells(Payload(spec, code_hash()), [number])
    row: dict[str, Any] = {name: rows[name][0] for name in columns(spec)}
    screen = console()
    for name, value in row.items():
        if value is not None and value != "":
            screen.print(f"{name:28s} {value:.6g}" if isinstance(value, float) else f"{name:28s} {value}")
    if json is not None:
        files.write_json(json, row)
    say(f"wrote {cell_folder}: airframe.toml, its rotors, truth.toml, flight.csv")
    say(f"next: coaxlink refine {cell_folder / 'flight.csv'} --airframe {cell_folder / 'airframe.toml'}")


def _write(text: str) -> None:
    sys.stderr.write(text)
    sys.stderr.flush()


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("campaign", short_help="Fly a campaign of simulated flights; stopped, it goes on.")(campaign)
