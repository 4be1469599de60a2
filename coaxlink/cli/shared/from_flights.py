"""`coaxlink identify FLIGHT... --airframe A --rotor PRIOR`: a prior's coefficients updated by flights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from coaxlink.cli.shared.flight_logs import read_flights_of
from coaxlink.cli.shared.shell import console, say, talk

AirframeOption = Annotated[
    Path | None, typer.Option(metavar="AIRFRAME.toml", help="With flight logs: the weighed vehicle.")
]
PriorOption = Annotated[
    Path | None, typer.Option("--rotor", metavar="PRIOR.toml", help="With flight logs: the model so far.")
]


def identify_from_flights(
    logs: Sequence[Path],
    airframe: Path | None,
    rotor: Path | None,
    system: int | None,
    out: Path | None,
    json: Path | None,
    plan: Path | None,
) -> None:
    """Print prior beside posterior, with `plan` the flight that would tell most; write them.

    Raises InputError, for a vehicle that can fly no plan after all else is printed and written.
    """
    from coaxlink import files
    from coaxlink.channels.flight import flown
    from coaxlink.data.samples import PREMISES
    from coaxlink.errors import CheckFailed, InputError
    from coaxlink.instruments.flight.inputs import checked
    from coaxlink.premises import unseen
    from coaxlink.premises.answer import as_json
    from coaxlink.report.coefficients import coefficient_table, hover_table, words
    from coaxlink.residual.refine import vehicle_differs
    from coaxlink.rotor.model import save_rotor_model
    from coaxlink.rotor_update.coefficients import coefficients_from_flights
    from coaxlink.rotor_update.next_flight import next_flight
    from coaxlink.rotor_update.premises import flown_by, update_hangs_on
    from coaxlink.vehicle import load_vehicle

    if airframe is None:
        raise InputError("--rotor", "", "is the prior of flight logs: name the vehicle with --airframe")
    for output in (out, json, plan):
        files.refuse_unwritable(output)
    vehicle = load_vehicle(airframe, rotor)
    with talk().status("reading") as status:
        read = read_flights_of(logs, system, status.update)
        status.update("is this the vehicle?")
        if not vehicle_differs(read, vehicle.declared):
            read = flown(read, vehicle.declared, vehicle.rotors)
        inputs = checked(read, vehicle.declared)
        if reasons := flown_by(inputs, vehicle):
            if json:
                files.write_json(json, as_json(reasons))
            raise CheckFailed("; ".join(reason.line() for reason in reasons))
        status.update("updating")
        update = coefficients_from_flights(inputs.logs, vehicle.declared, vehicle.rotors)
        status.update("moving what nobody measured")
        lacks = update_hangs_on(update, inputs.logs, vehicle)
        planned, problem = None, None
        if plan:
            status.update("planning the next flight")
            try:
                planned = next_flight(update, vehicle.declared)
            except InputError as error:  # a model that flies nothing has no plan, but coefficients
                problem = error
    screen = console()
    screen.print(coefficient_table(update, planned))
    screen.print(hover_table(update))
    granted = dict.fromkeys(PREMISES[p] for log in read for p in log.premises)
    granted |= dict.fromkeys(
        (
            "no rotor is taken for a weak one: coaxlink health says whether one is",
            *unseen(read),
            *(s.line() for s in inputs.suspects),
        )
    )
    for line in (*granted, *words(update), *(planned.words() if planned else ())):
        say(f"- {line}")
    if json:
        planned_json = {"next": planned.as_json()} if planned else {}
        files.write_json(json, update.as_json() | planned_json | {"premises": list(granted)} | as_json(lacks))
    if lacks:
        raise CheckFailed(f"{'; '.join(reason.line() for reason in lacks)}; no model was written")
    if out:
        save_rotor_model(out, update.model)
        say(f"wrote {out}")
    if problem:
        raise problem
    if plan and planned:
        files.write_toml(plan, planned.document())
        say(f"wrote {plan}")
    say(
        f"next: coaxlink table {airframe} --rotor {out or 'ROTOR.toml'} --firmware px4 --out DIR "
        "makes a table of it; the file is the prior of the next flights"
    )
    if plan:
        say(f"with that on board: coaxlink fly --plan {plan} --connect URL flies the plan")
    else:
        say("--next PLAN.toml plans the most informative flight")
