"""`coaxlink campaign`: thousands of flights from one file, their rows, and what they say."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coaxlink.cli.shared.progress import progress
from coaxlink.cli.shared.shell import JsonOption, SchedulerOption, WorkersOption, console, say

if TYPE_CHECKING:
    from coaxlink.studies.campaign.spec import Spec
    from coaxlink.studies.engine import Machine

DRAWS = 4  # of a task: a second of work or so


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
    from coaxlink.studies.campaign.flights import known_effects
    from coaxlink.studies.campaign.spec import read_spec
    from coaxlink.studies.engine import Machine

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
    _fly(spec, folder, Machine(workers, scheduler))
    _tell(spec, file, folder, json)


def _fly(spec: Spec, folder: Path, machine: Machine) -> None:
    from contextlib import closing

    from coaxlink.studies.campaign.flights import Payload, code_hash, columns, fly_cells
    from coaxlink.studies.campaign.rows import Dataset
    from coaxlink.studies.engine import run

    payload = Payload(spec, code_hash())
    decides = {"campaign": spec.name, "digest": spec.digest, "seed": spec.seed, "code": payload.code}
    size = len(spec.laws) * DRAWS
    with Dataset(folder, columns(spec), spec.cells, decides) as dataset:
        for aside in dataset.put_aside:
            say(f"not the rows that were written, their cells are flown again: {aside}")
        if dataset.done:
            say(f"{dataset.done} of {spec.cells} are there already")
        try:
            with (
                progress("flights", spec.cells, dataset.done) as bar,
                closing(run(fly_cells, payload, dataset.missing(), machine, size)) as tasks,
            ):
                for rows in tasks:
                    dataset.add(rows)
                    bar.at(dataset.done)
        except KeyboardInterrupt:
            say(f"stopped at {dataset.done} of {spec.cells}; the same command goes on from there")
            raise


def _tell(spec: Spec, file: Path, folder: Path, json: Path | None) -> None:
    """The summary on the screen, as JSON, and as a page beside the rows."""
    from coaxlink import files
    from coaxlink.report import campaign as report
    from coaxlink.report.made import Made
    from coaxlink.report.terminal import table
    from coaxlink.studies.campaign.rows import MANIFEST, columns_of
    from coaxlink.studies.campaign.summary import summarise

    columns = columns_of(folder)
    replay = f"coaxlink campaign {file} --out {folder} --replay"
    summary = summarise(spec, columns, replay, files.read_json(folder / MANIFEST))
    for path in filter(None, (folder / "summary.json", json)):
        files.write_json(path, summary.to_json())
    files.write_atomic(folder / "report.html", report.page(summary, columns, Made.now([file])))
    screen = console()
    for line in report.sentences(summary):
        screen.print(line)
    for heads, rows in (
        (report.spread_heads(summary), report.spread_rows(summary)),
        # the command that flies one again stands below, once and in one piece
        (report.worst_heads(summary)[:-1], [row[:-1] for row in report.worst_rows(summary)]),
    ):
        if rows:
            screen.print(table("", heads, rows))
    say(f"one flight again, with its log: {replay} CELL")
    say(f"wrote {folder / 'report.html'}, {folder / 'summary.json'}; rows: {folder / 'rows' / '*.parquet'}")


def _replay(spec: Spec, number: int, folder: Path, json: Path | None) -> None:
    """One cell again: its row on the screen, its flight log and what it flew as files."""
    from coaxlink import files
    from coaxlink.studies.campaign.flights import Payload, code_hash, fly_cell, fly_cells
    from coaxlink.studies.campaign.spec import cell

    cell_folder = folder / f"cell-{number:09d}"
    files.refuse_unwritable(cell_folder / "flight.csv")
    fly_cell(spec, cell(spec, number), cell_folder / "flight.csv", cell_folder)
    (row,) = fly_cells(Payload(spec, code_hash()), [number])
    screen = console()
    for name, value in row.items():
        if value is not None and value != "":
            screen.print(f"{name:28s} {value:.6g}" if isinstance(value, float) else f"{name:28s} {value}")
    if json is not None:
        files.write_json(json, row)
    say(f"wrote {cell_folder}: airframe.toml, its rotors, truth.toml, flight.csv")
    say(f"next: coaxlink refine {cell_folder / 'flight.csv'} --airframe {cell_folder / 'airframe.toml'}")
