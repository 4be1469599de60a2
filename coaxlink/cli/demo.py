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
    from coaxlink.fly.trajectory import Plan
    from coaxlink.report.demo import DemoResult
    from coaxlink.tables.px4 import TableReport

LOGS = ("standard.tlog", "reduced.tlog", "fitted.tlog", "live_exact.tlog", "hidden.tlog")
RESIDUAL = ("residual.png", "residual.svg", "residual.pdf")
MADE = ("rotor.toml", "rotor_refined.toml", "tables", "backups", "report.html", *RESIDUAL, *LOGS)
STEPS = 8  # of the progress bar, beside the flights' own seconds


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
    from coaxlink.report.demo_page import write_report
    from coaxlink.report.made import Made

    with terminated_as_interrupted(), whole_or_before(out, MADE):
        result = run_demo(chosen, out, speed)
        made = Made.now((*(out / name for name in LOGS), out / "rotor.toml"), "demo-x8")
        page = write_report(out, result, made)
    _show(result)
    if json_file:
        files.write_json(json_file, result.to_json())
    say(f"report: {page}   again with the same hidden effect: coaxlink demo --seed {chosen}")


def run_demo(seed: int, out: Path, speed: float) -> DemoResult:
    """Every step with a progress display on stderr. Raises what the steps raise.

    The mixers fly where nothing is hidden, each from a full battery and under the same noise; then the fitted
    table flies once more where something is, and what is found there comes from that flight alone.
    """
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.cli import _demo as steps
    from coaxlink.data import read_flight_log, read_stand_log
    from coaxlink.fly.trajectory import mixer_flight, paper_flight
    from coaxlink.report.demo import DemoResult
    from coaxlink.residual import refine
    from coaxlink.rotor import identify, save_rotor_model
    from coaxlink.tables import px4 as tables
    from coaxlink.tables.worth import px4_worths
    from coaxlink.vehicle import Vehicle

    airframe_file = files.example("x8_demo.toml")
    airframe, plan, longer = load_airframe(airframe_file), mixer_flight(), paper_flight()
    world = ["--airframe", str(airframe_file), "--seed", str(seed)]
    hiding = [*world, "--hidden-seed", str(seed)]
    upload = upload_into(out)
    with _progress() as (step, watch):
        step("identifying the rotor pair from 121 stand points")
        identification = identify(read_stand_log(files.example("stand_eq17.csv")), "crm")
        model = identification.model
        save_rotor_model(out / "rotor.toml", model)

        step("writing the standard, the reduced and the fitted table")
        vehicle = Vehicle(airframe, model)
        reports = {law: tables.report_px4(vehicle, law) for law in steps.TABLES}
        folders = {
            law: write_table(out, airframe, law, report, out / "rotor.toml")
            for law, report in reports.items()
        }

        worths = px4_worths(vehicle)
        step("uploading and flying each table", plan)
        flown, uploads = steps.fly_fresh(world, speed, folders, upload, plan, out, watch)
        step("flying with the companion mixing live", plan)
        live, demands, account = steps.fly_live(world, speed, vehicle, plan, out, watch)

        step("flying the fitted table where something is hidden", longer)
        into = {steps.HIDDEN: folders[steps.FITTED]}
        flights, done = steps.fly_fresh(hiding, speed, into, upload, longer, out, watch)
        hidden, uploads = flights[steps.HIDDEN], uploads | done

        step("holding the flights against what was meant")
        errors = {
            law: steps.errors_of_table(flight, vehicle, reports[law].params, whole=True)
            for law, flight in flown.items()
        }
        errors[steps.LIVE] = steps.errors_of_live(live, vehicle, demands, whole=True)
        params = reports[steps.FITTED].params
        off = steps.errors_of_table(hidden, vehicle, params, whole=True)
        step("tracing the residual to what is hidden")
        refinement = refine(read_flight_log(hidden.log), airframe, model)
        if refinement.model is not None:
            save_rotor_model(out / "rotor_refined.toml", refinement.model)
        step("done")
    return DemoResult(seed, identification, uploads, errors, off, account, refinement, worths)


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
        from coaxlink.mavlink import connect
        from coaxlink.uploading.journal import Journal
        from coaxlink.uploading.plan import load_plan
        from coaxlink.uploading.worker import Uploader

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
def _progress() -> Iterator[tuple[Any, Watch]]:
    """A bar of the steps and a bar of the flight under way; plain lines where stderr is no terminal."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    screen = talk()
    with Progress(
        TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn(), console=screen
    ) as progress:
        whole = progress.add_task("coaxlink demo", total=STEPS)
        flight = progress.add_task("", visible=False)

        def step(text: str, plan: Plan | None = None) -> None:
            progress.update(whole, description=text, advance=1)
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
    app.command("demo")(demo)
