"""`coaxlink identify FLIGHT... --airframe A --rotor PRIOR`: a prior's coefficients updated by flights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from coaxlink.cli.shared.shell import console, say, talk

AirframeOption = Annotated[
    Path | None, typer.Option(metavar="AIRFRAME.toml", help="With flight logs: the weighed vehicle.")
]
PriorOption = Annotated[
    Path | None, typer.Option("--rotor", metavar="PRIOR.toml", help="With flight logs: the model so far.")
]


def identify_from_flights(
    logs: Sequence[Path], airframe: Path | None, rotor: Path | None, out: Path | None, json: Path | None
) -> None:
    """Print prior beside posterior and write the model. Raises InputError."""
    from coaxlink import files
    from coaxlink.data import is_flight_log, read_flight_log
    from coaxlink.errors import InputError
    from coaxlink.health.coefficients import coefficients_from_flights
    from coaxlink.report.coefficients import coefficient_table, hover_table, words
    from coaxlink.rotor.model import save_rotor_model
    from coaxlink.vehicle import load_vehicle

    if airframe is None:
        raise InputError("--rotor", "", "is the prior of flight logs: name the vehicle with --airframe")
    for path in logs:
        if not is_flight_log(path):
            raise InputError(path, "", "a flight log is expected with --airframe, found a stand's")
    for output in (out, json):
        files.refuse_unwritable(output)
    vehicle = load_vehicle(airframe, rotor)
    with talk().status("reading") as status:
        read = []
        for path in logs:
            status.update(f"reading {path.name}")
            read.append(read_flight_log(path))
        status.update("updating")
        update = coefficients_from_flights(read, vehicle.declared, vehicle.rotors)
    screen = console()
    screen.print(coefficient_table(update))
    screen.print(hover_table(update))
    for line in words(update):
        say(f"- {line}")
    if out:
        save_rotor_model(out, update.model)
        say(f"wrote {out}")
    if json:
        files.write_json(json, update.as_json())
    say(
        "next: coaxlink table AIRFRAME.toml --rotor ROTOR.toml makes a table of it; "
        "the file is the prior of the next flights"
    )
