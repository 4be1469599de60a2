"""`coaxlink health`: is every rotor still what the model says? Exit 1 when the vehicle should stay down."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coaxlink.cli.shared.flight_logs import SystemOfLogOption, read_flights_of
from coaxlink.cli.shared.shell import JsonOption, console, say, say_vehicle, talk

if TYPE_CHECKING:
    from coaxlink.health.judge import Health
    from coaxlink.report.made import Made


def health(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...",
            help="Flight logs of one vehicle, oldest first; or a folder of logs, a folder a vehicle in it.",
        ),
    ],
    airframe: Annotated[
        Path | None, typer.Option(metavar="AIRFRAME.toml", help="The vehicle (default: the shipped X8).")
    ] = None,
    rotor: Annotated[
        Path | None, typer.Option(metavar="ROTOR.toml", help="Its rotors (default: the airframe's).")
    ] = None,
    system: SystemOfLogOption = None,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="H.png", help="Draw every rotor over the flights (.png, .svg, .pdf)."),
    ] = None,
    report: Annotated[
        Path | None, typer.Option(metavar="R.html", help="Write one self-contained page.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Judge every rotor over one flight or many: sound, watch or ground it, with its probability."""
    from coaxlink import files
    from coaxlink.cli.shared.fleet import folder_of
    from coaxlink.errors import CheckFailed, InputError
    from coaxlink.report.health import (
        figure,
        health_page,
        health_table,
        remarks,
        suspects_named,
        verdict_line,
    )
    from coaxlink.report.pictures.figures import format_of, write_figure

    for output in (plot, report, json):
        files.refuse_unwritable(output)
    if plot:
        format_of(plot)
    if not logs:
        raise InputError("health", "LOG...", "flight logs are expected, oldest first")
    folder = folder_of(logs[0]) if len(logs) == 1 else None
    if folder is not None:
        _fleet(folder, airframe, rotor, system, plot or report, json)
        return
    result = _judged(logs, airframe, rotor, system)
    if (plot or report) and not result.flights:
        say("no picture and no page: nothing was judged")
    elif plot or report:
        made = _made(logs, airframe, rotor)
        if plot:
            write_figure(plot, figure(result, made.line()))
        if report:
            files.write_atomic(report, health_page(result, made))
    if json:
        files.write_json(json, result.as_json())
    screen = console()
    screen.print(verdict_line(result))
    if result.flights:
        screen.print(health_table(result))
    say_vehicle(airframe)
    for line in remarks(result):
        say(f"- {line}")
    if result.reasons:
        raise CheckFailed(verdict_line(result))
    if result.verdict == "ground it":
        raise CheckFailed(f"ground it: look at {suspects_named(result)} before the next flight")


def _made(logs: Sequence[Path], airframe: Path | None, rotor: Path | None) -> Made:
    """How a picture or a page is made: this command line, its files, the vehicle."""
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.report.made import Made

    body = load_airframe(airframe or files.example("x8_paper.toml"))
    return Made.now([f for f in (*logs, body.source, rotor or body.rotor_model) if f is not None], body.name)


def _judged(logs: Sequence[Path], airframe: Path | None, rotor: Path | None, system: int | None) -> Health:
    """One vehicle's flights, oldest first. Raises InputError."""
    from coaxlink import files
    from coaxlink.health.premises import judged
    from coaxlink.vehicle import load_vehicle

    vehicle = load_vehicle(airframe or files.example("x8_paper.toml"), rotor)
    with talk().status("reading") as status:
        read = read_flights_of(logs, system, status.update)
        status.update("judging")
        return judged(read, [Path(log.source).name for log in read], vehicle)


def _fleet(
    folder: str,
    airframe: Path | None,
    rotor: Path | None,
    system: int | None,
    plot: Path | None,
    json: Path | None,
) -> None:
    """Every vehicle of a folder over its flights, by the dates in their paths as `refine FOLDER` has them."""
    from coaxlink import files
    from coaxlink.errors import CheckFailed, InputError
    from coaxlink.report.health import verdict_line
    from coaxlink.studies.fleet import find_logs

    if plot:
        raise InputError(folder, "", "a picture or a page is of one vehicle: name its logs")
    vehicles: dict[str, list[Path]] = {}
    for log in find_logs(folder):
        vehicles.setdefault(log.vehicle, []).append(Path(log.address))
    found, problems = {}, {}
    screen = console()
    for name, logs in vehicles.items():
        beside = logs[0].parent / "airframe.toml"
        try:
            found[name] = _judged(logs, beside if beside.is_file() else airframe, rotor, system)
        except InputError as error:
            problems[name] = str(error)
            say(f"says nothing: {name}: {error}")
            continue
        screen.print(f"{name}, {len(logs)} flights: {verdict_line(found[name])}")
    if json:
        written = {name: result.as_json() for name, result in found.items()}
        files.write_json(json, {"kind": "fleet", "vehicles": written, "problems": problems})
    if not found:
        raise InputError(folder, "", "no vehicle's flights can be judged")
    grounded = [name for name, result in found.items() if result.verdict == "ground it"]
    if grounded:
        raise CheckFailed(f"ground {', '.join(grounded)}")
    unjudged = [name for name, result in found.items() if result.reasons]
    if unjudged:
        raise CheckFailed(f"not judged: {', '.join(unjudged)}")
