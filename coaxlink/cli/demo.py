"""`coaxlink demo`: the main job, end to end, on the embedded simulator."""

from __future__ import annotations

import secrets
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink.cli._shell import JsonOption, console, say, talk
from coaxlink.cli._whole import terminated_as_interrupted, whole_or_before

if TYPE_CHECKING:
    from coaxlink.airframe import Airframe
    from coaxlink.cli._demo import Watch
    from coaxlink.link.tables import TableReport
    from coaxlink.link.trajectory import Plan
    from coaxlink.report.demo import DemoResult

LOGS = ("standard.tlog", "reduced.tlog", "fitted.tlog", "live_exact.tlog")
MADE = ("rotor.toml", "rotor_refined.toml", "tables", "backups", "report.html", "residual.png", *LOGS)
STEPS = 7  # of the progress bar, beside the flights' own seconds


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
    """Identify, make tables, upload, fly, find what the model lacks, add it: all on the simulator."""
    from coaxlink import files

    files.refuse_unwritable(json_file)
    chosen = secrets.randbelow(1_000_000) if seed is None else seed
    from coaxlink.report.demo import write_report

    with terminated_as_interrupted(), whole_or_before(out, MADE):
        result = run_demo(chosen, out, speed)
        page = write_report(out, result)
    _show(result)
    if json_file:
        files.write_json(json_file, result.to_json())
    say(f"report: {page}   again with the same hidden effect: coaxlink demo --seed {chosen}")


def run_demo(seed: int, out: Path, speed: float) -> DemoResult:
    """Every step with a progress display on stderr. Raises what the steps raise."""
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.cli import _demo as steps
    from coaxlink.data import read_flight_log, read_stand_log
    from coaxlink.link import tables
    from coaxlink.link.trajectory import paper_flight
    from coaxlink.report.demo import DemoResult
    from coaxlink.residual import refine
    from coaxlink.rotor import identify, save_rotor_model

    airframe_file = files.example("x8_demo.toml")
    airframe, plan = load_airframe(airframe_file), paper_flight()
    world = ["--airframe", str(airframe_file), "--hidden-seed", str(seed), "--seed", str(seed)]
    with _progress(plan) as (step, watch):
        step("identifying the rotor pair from 121 stand points")
        identification = identify(read_stand_log(files.example("stand_eq17.csv")), "crm")
        model = identification.model
        save_rotor_model(out / "rotor.toml", model)

        step("writing the standard, the reduced and the fitted table")
        reports = {law: tables.report_px4(airframe, model, law) for law in steps.TABLES}
        folders = {
            law: write_table(out, airframe, law, report, out / "rotor.toml")
            for law, report in reports.items()
        }

        step("uploading and flying each table")
        flown, uploads = steps.fly_tables(world, speed, folders, upload_into(out), plan, out, watch)
        step("flying with the companion mixing live")
        live, demands, account = steps.fly_live(world, speed, airframe, model, plan, out, watch)

        step("holding the flights against what was meant")
        errors = {
            law: steps.errors_of_table(flown[law], airframe, model, reports[law].params) for law in flown
        }
        errors[steps.LIVE] = steps.errors_of_live(live, airframe, model, demands)
        step("tracing the residual of all flights")
        logs = [read_flight_log(flight.log) for flight in (*flown.values(), live)]
        refinement = refine(logs, airframe, model)
        if refinement.model is not None:
            save_rotor_model(out / "rotor_refined.toml", refinement.model)
        step("done")
    return DemoResult(seed, identification, uploads, errors, account, refinement)


def write_table(out: Path, airframe: Airframe, name: str, report: TableReport, rotor_file: Path) -> Path:
    """Write a PX4 table to OUT/tables/NAME and return that folder."""
    from coaxlink.cli.table import write_px4

    folder = out / "tables" / name
    write_px4(folder, airframe, rotor_file, report)
    return folder


def upload_into(out: Path) -> Callable[[str, Path], dict[str, Any]]:
    """An upload that keeps its backups in OUT/backups and raises unless the table is verified."""

    def upload(address: str, folder: Path) -> dict[str, Any]:
        from coaxlink.errors import CheckFailed
        from coaxlink.link import connect
        from coaxlink.link.journal import Journal
        from coaxlink.link.plan import load_plan
        from coaxlink.link.upload import Uploader

        # a simulated board is gone with its flight: nothing of it belongs into the user's own journal
        with tempfile.TemporaryDirectory() as place, connect(address) as session:
            journal = Journal(session.identity, Path(place))
            uploader = Uploader(session, backup_folder=out / "backups", journal=journal)
            outcome = uploader.upload(load_plan(folder))
        if outcome.result != "verified":
            raise outcome.error or CheckFailed(f"upload of {folder}: {outcome.result} ({outcome.reason})")
        return outcome.to_json()

    return upload


@contextmanager
def _progress(plan: Plan) -> Iterator[tuple[Any, Watch]]:
    """A bar of the steps and a bar of the flight under way; plain lines where stderr is no terminal."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    screen = talk()
    with Progress(
        TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=screen
    ) as progress:
        whole = progress.add_task("coaxlink demo", total=STEPS)
        flight = progress.add_task("", total=plan.duration_s, visible=False)

        def step(text: str) -> None:
            progress.update(whole, description=text, advance=1)
            progress.update(flight, visible=False)
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
    app.command("demo")(demo)
