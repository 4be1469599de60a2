"""`coaxlink health`: is every rotor still what the model says? Exit 1 when the vehicle should stay down."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from coaxlink.cli._shell import JsonOption, console, say, talk


def health(
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="Flight logs of one vehicle, oldest first.")
    ],
    airframe: Annotated[
        Path | None, typer.Option(metavar="AIRFRAME.toml", help="The vehicle (default: the shipped X8).")
    ] = None,
    rotor: Annotated[
        Path | None, typer.Option(metavar="ROTOR.toml", help="Its rotors (default: the airframe's).")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(metavar="H.png", help="Draw every rotor over the flights.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Judge every rotor over one flight or many: sound, watch or ground it, with its probability."""
    from coaxlink import files
    from coaxlink.data import is_flight_log, read_flight_log
    from coaxlink.errors import CheckFailed, InputError
    from coaxlink.health.columns import reduced
    from coaxlink.health.judge import judge
    from coaxlink.report.health import health_table, picture, remarks, verdict_line
    from coaxlink.residual.channels.flight import flight_frame
    from coaxlink.vehicle import load_vehicle

    for place in (plot, json):
        files.refuse_unwritable(place)
    if not logs:
        raise InputError("health", "LOG...", "flight logs are expected, oldest first")
    vehicle = load_vehicle(airframe or files.example("x8_paper.toml"), rotor)
    body = vehicle.declared
    flights = []
    with talk().status("reading") as status:
        for path in logs:
            status.update(f"reading {path.name}")
            if not is_flight_log(path):
                raise InputError(path, "", "a flight log is expected, found a stand's: identify takes it")
            flights.append(reduced(flight_frame([read_flight_log(path)], body, vehicle.rotors)))
        status.update("judging")
        names = [path.name for path in logs]
        result = judge(flights, names, [r.number for r in body.rotors], body.pairs)
    if plot:
        files.write_atomic(plot, picture(result))
    if json:
        files.write_json(json, result.as_json())
    screen = console()
    screen.print(health_table(result))
    screen.print(verdict_line(result))
    for line in remarks(result):
        say(f"- {line}")
    if result.verdict == "ground it":
        raise CheckFailed(f"ground it: look at rotor {result.suspects[0].number} before the next flight")


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("health")(health)
