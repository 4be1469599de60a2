"""`coaxlink report`: a flight log, or two beside one another, as one page to look at."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from coaxlink.cli.shared.flight_logs import SystemOfLogOption, refuse_stand_log
from coaxlink.cli.shared.shell import say, talk


def report(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG [LOG]", help="One flight log, or two.")],
    airframe: Annotated[
        Path | None, typer.Option(metavar="AIRFRAME.toml", help="The vehicle: thrust, split and wrench too.")
    ] = None,
    rotor: Annotated[
        Path | None, typer.Option(metavar="ROTOR.toml", help="Its rotors (default: the airframe's).")
    ] = None,
    system: SystemOfLogOption = None,
    out: Annotated[
        Path | None, typer.Option(metavar="R.html", help="The page (default: LOG.html in this folder).")
    ] = None,
) -> None:
    """Draw a flight: every rotor, every pair against its ideal, wrench, vibration, battery, events."""
    from coaxlink import files
    from coaxlink.errors import InputError
    from coaxlink.report.flight_charts import flight_charts
    from coaxlink.report.flight_page import flight_page
    from coaxlink.report.made import Made
    from coaxlink.vehicle import load_vehicle

    if not 1 <= len(logs) <= 2:
        raise InputError("report", "LOG", f"one log or two are expected, found {len(logs)}")
    if rotor and not airframe:
        raise InputError("--rotor", str(rotor), "--airframe is expected with it")
    page = out or Path(f"{logs[0].stem}.html")
    files.refuse_unwritable(page)
    vehicle = load_vehicle(airframe, rotor) if airframe else None
    flights = []
    with talk().status("reading") as status:
        for log in logs:
            status.update(f"reading {log.name}")
            refuse_stand_log(log)
            flights += flight_charts(log, vehicle, system)
    made = Made.now(
        [f for f in (*logs, airframe, rotor) if f is not None], vehicle.airframe.name if vehicle else ""
    )
    files.write_atomic(page, flight_page(flights, made))
    for flight in flights:
        typer.echo(f"{flight.source}, {flight.seconds:.0f} s. {flight.answer}")
    for line in dict.fromkeys(words for flight in flights for words in flight.provenance):
        say(f"- {line}")
    say(f"wrote {page}")
    if vehicle is None:
        say(f"next: coaxlink report {' '.join(map(str, logs))} --airframe X8.toml")
    else:
        rotors = f" --rotor {rotor}" if rotor else ""
        say(f"next: coaxlink refine {logs[0]} --airframe {airframe}{rotors} says why thrust or torque is off")
