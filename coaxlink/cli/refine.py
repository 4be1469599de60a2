"""`coaxlink refine`: measured data against a model: residual, effect, error before and after."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coaxlink.cli.shared.fleet import folder_of
from coaxlink.cli.shared.flight_logs import SystemOfLogOption, named_vehicle, read_flights_of
from coaxlink.cli.shared.next import after_refine
from coaxlink.cli.shared.shell import (
    JsonOption,
    SchedulerOption,
    WorkersOption,
    console,
    say,
    talk,
)
from coaxlink.cli.shared.stand import (
    ColumnsOption,
    PolesOption,
    SheetOption,
    StandOptions,
    UpperOption,
    read_stand,
)

if TYPE_CHECKING:
    from coaxlink.airframe import Airframe
    from coaxlink.report.made import Made
    from coaxlink.residual import Refinement


def refine(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...", help="Stand or flight logs, all of one kind; or one folder of a fleet's."
        ),
    ],
    airframe: Annotated[
        Path | None, typer.Option(metavar="AIRFRAME.toml", help="Of flight logs: the vehicle.")
    ] = None,
    rotor: Annotated[
        Path | None,
        typer.Option(
            metavar="ROTOR.toml",
            help="Model to hold against (default: the airframe's; for a stand log a model fitted to it).",
        ),
    ] = None,
    system: SystemOfLogOption = None,
    out: Annotated[
        Path | None, typer.Option(metavar="ROTOR.toml", help="Write the model with the effects added.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(metavar="R.html", help="Write one self-contained page.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write the pictures as PNG, SVG and PDF.")
    ] = None,
    plan: Annotated[
        Path | None,
        typer.Option(metavar="PLAN.toml", help="Write the run that would separate ambiguous effects."),
    ] = None,
    columns: ColumnsOption = None,
    upper: UpperOption = None,
    poles: PolesOption = None,
    sheet: SheetOption = None,
    workers: WorkersOption = 0,
    scheduler: SchedulerOption = None,
    json: JsonOption = None,
) -> None:
    """Find what the model lacks in measured data, name it, and report the error before and after."""
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.data import is_flight_log
    from coaxlink.errors import CheckFailed, InputError
    from coaxlink.report.refine import remarks, tables, verdict
    from coaxlink.residual import refine as run
    from coaxlink.residual import refine_stand as run_stand
    from coaxlink.rotor import save_rotor_model
    from coaxlink.vehicle import load_rotors

    for output in (out, report, plan, json):
        files.refuse_unwritable(output)
    folder = folder_of(logs[0])
    if folder is not None:
        if system is not None:
            raise InputError(
                "--system", "", "is of single logs: a fleet's folder holds a vehicle's logs each"
            )
        _fleet(folder, len(logs), out or plan, airframe, rotor, (workers, scheduler), report, json)
        return
    kinds = [is_flight_log(path) for path in logs]
    if any(kinds) != all(kinds):
        raise InputError(
            logs[kinds.index(False)], "", "a stand log among flight logs: refine one kind at a time"
        )
    flight = all(kinds)
    if system is not None and not flight:
        raise InputError("--system", "", "is of a flight log, found a stand's")
    if airframe is not None and not flight:
        wanted = f"coaxlink refine {logs[0].name} without --airframe, or coaxlink identify, takes it"
        raise InputError(logs[0], "", f"a stand log, and --airframe is of a flight: {wanted}")
    body = load_airframe(named_vehicle(airframe, logs[0], system)) if flight else None
    model_file = rotor or (body.rotor_model if body else None)
    if body is not None and model_file is None:
        raise InputError(body.source or "airframe", "rotor_model", "missing: name a rotor file with --rotor")
    model = load_rotors(model_file) if model_file else None
    with talk().status("reading") as status:
        if not flight:
            # trusted: refine says what is suspect
            how = StandOptions(columns, upper, poles, sheet=sheet, trust_units=True)
            samples = read_stand(logs, how, status.update)
        else:
            samples = read_flights_of(logs, system, status.update)
        if body is not None and model is not None:
            result = run(samples, body, model, progress=status.update)
        else:
            result = run_stand(samples, model, progress=status.update)
        drawn, figures = None, {}
        if report is not None or plot is not None:
            status.update("drawing")
            made = _made([*logs, airframe, model_file], body)
        if report is not None:
            from coaxlink.report.page import page

            drawn = page(result, made=made)
        if plot is not None and result.series is not None:
            from coaxlink.report.pictures.residual_plots import errors_figure, overview_figure

            figures = {
                "residual": overview_figure(result, made.line()),
                "errors": errors_figure(result, made.line()),
            }
    if report is not None and drawn is not None:
        files.write_atomic(report, drawn)
    if plot is not None:
        from coaxlink.report.pictures.figures import write_figures

        write_figures(plot, figures)
    if out is not None and result.model is not None:
        save_rotor_model(out, result.model)
    if plan is not None:
        _write_plan(plan, result)
    if json is not None:
        files.write_json(json, result.to_json())
    screen = console()
    screen.print(verdict(result))
    for table in tables(result):
        screen.print(table)
    for remark in remarks(result):
        say(remark)
    if result.reasons:
        raise CheckFailed(f"{verdict(result)}; no model was changed")
    say(after_refine(result, out, flight, airframe))


def _made(sources: list[Path | None], body: Airframe | None) -> Made:
    """How the page is made: this command line, its files, the vehicle of a flight."""
    from coaxlink.report.made import Made

    return Made.now([path for path in sources if path is not None], body.name if body else "")


def _fleet(
    folder: str,
    count: int,
    single: Path | None,
    airframe: Path | None,
    rotor: Path | None,
    where: tuple[int, str | None],
    report: Path | None,
    json: Path | None,
) -> None:
    """Every log of a fleet by itself, and each vehicle over time. Raises InputError."""
    from coaxlink.cli.shared.fleet import tell_fleet
    from coaxlink.errors import InputError
    from coaxlink.studies.fleet import RefineLog

    if count > 1:
        raise InputError(folder, "", "a fleet is one folder, with a folder a vehicle in it")
    if single is not None:
        raise InputError(
            single, "", "a fleet has no one model: refine a vehicle's own logs for --out or --plan"
        )
    analyse = RefineLog(airframe, rotor)
    tell_fleet(folder, analyse, *where, report, json)


def _write_plan(path: Path, result: Refinement) -> None:
    """The first doubt's experiment, for `coaxlink sim --stand OUT.csv --schedule` or a real stand."""
    import tomli_w

    from coaxlink import files

    experiments = [a.experiment for a in result.ambiguous if a.experiment is not None]
    if not experiments:
        say(f"{path}: not written, " + ("no plan was found" if result.ambiguous else "nothing is ambiguous"))
        return
    head = "".join(f"# {line}\n" for line in experiments[0].text.split("; "))
    files.write_atomic(path, head + tomli_w.dumps(experiments[0].document()))
    say(f"{path}: {experiments[0].text}")
