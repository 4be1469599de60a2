"""`coaxlink reproduce`: the paper's tables and figures against what its own numbers give."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coaxlink.cli.shared.shell import JsonOption, console, say

if TYPE_CHECKING:
    from coaxlink.studies.paper import Ledger
    from coaxlink.studies.paper.tables import Flown

SPEED = 8.0  # of the simulator, times real time


def reproduce(
    no_fly: Annotated[bool, typer.Option("--no-fly", help="Leave Table 4's flights out.")] = False,
    pair: Annotated[
        Path | None,
        typer.Option(metavar="LOG", help="A real stand log of a close pair, for contradiction 11."),
    ] = None,
    markdown: Annotated[
        Path | None, typer.Option(metavar="FILE.md", help="Write the ledger as a page (docs/paper.md).")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(metavar="R.html", help="Write one self-contained page.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Recompute what the paper prints, and each place where it disagrees with itself."""
    from coaxlink import files
    from coaxlink.report.paper import markdown as page
    from coaxlink.report.paper import tables

    files.refuse_unwritable(json_file)
    files.refuse_unwritable(markdown)
    files.refuse_unwritable(report)
    ledger = build(fly_table_4=not no_fly, pair=pair)
    for table in tables(ledger):
        console().print(table)
    if markdown:
        files.write_atomic(markdown, page(ledger))
    if report:
        from coaxlink.report.made import Made
        from coaxlink.report.paper_page import paper_page

        names = (
            "x8_paper.toml",
            "rotor_paper.toml",
            "rotor_eq15.toml",
            "rotor_srm_paper.toml",
            "stand_eq17.csv",
        )
        sources = [*map(files.example, names), *([pair] if pair else [])]
        files.write_atomic(report, paper_page(ledger, Made.now(sources, "paper-x8")))
        say(f"wrote {report}")
    if json_file:
        files.write_json(json_file, ledger.to_json())


def build(*, fly_table_4: bool, pair: Path | None) -> Ledger:
    """All entries; flights take about a minute."""
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.data import read_stand_log
    from coaxlink.rotor import identify, load_rotor_model
    from coaxlink.studies.paper import Ledger, contradictions, equations, tables

    airframe = load_airframe(files.example("x8_paper.toml"))
    crm, rcrm, srm = (
        load_rotor_model(files.example(f"rotor_{name}.toml")) for name in ("paper", "eq15", "srm_paper")
    )
    say("identifying 121 points made with eq. 17")
    identified = identify(read_stand_log(files.example("stand_eq17.csv")), "crm")
    flights = _fly() if fly_table_4 else {}
    return Ledger(
        (
            tables.table_1(identified),
            tables.table_2(identified),
            tables.table_4(flights),
            tables.table_5(flights),
            tables.figure_4(identified),
            equations.figure_5(crm),
            equations.equation_15(airframe),
            equations.equation_16(airframe),
            equations.equation_18(),
            *contradictions.contradictions(airframe, crm, rcrm, srm, pair),
        )
    )


def _fly() -> dict[str, Flown]:
    """The paper's mixers and the mended ones on the eq. 17 plant, by the names of Table 4's columns."""
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.fly.trajectory import table_4_flight
    from coaxlink.mixer import make_law
    from coaxlink.rotor import load_rotor_model
    from coaxlink.studies import flights
    from coaxlink.studies.flight_errors import errors_of_live, errors_of_table
    from coaxlink.studies.paper import printed_laws
    from coaxlink.studies.paper.tables import Flown
    from coaxlink.tables import px4 as tables
    from coaxlink.vehicle import Vehicle

    airframe_file = files.example("x8_demo.toml")
    airframe, plan, world = load_airframe(airframe_file), table_4_flight(), ["--airframe", str(airframe_file)]
    vehicle = Vehicle(airframe, load_rotor_model(files.example("rotor_paper.toml")))
    columns = {"standard": ("standard", "srm_paper"), "reduced": ("reduced", "eq15")}
    if "fitted" in tables.TABLE_LAWS:
        columns["fitted table"] = ("fitted", "paper")
    errors = {}
    with tempfile.TemporaryDirectory() as name:
        out = Path(name)
        reports, folders = {}, {}
        for title, (law, rotor) in columns.items():
            file = files.example(f"rotor_{rotor}.toml")
            reports[title] = tables.report_px4(Vehicle(airframe, load_rotor_model(file)), law)
            folders[title] = flights.write_table(out, airframe, title, reports[title], file)
        say(f"flying {', '.join(columns)} as PX4 tables")
        sim = flights.Simulation(world, SPEED, out, tell=say)
        flown, _ = flights.fly_tables(sim, folders, plan)
        for title, flight in flown.items():
            errors[title] = errors_of_table(flight, vehicle, reports[title].params, as_paper=True)
        flown_live = {
            "coaxial": printed_laws(vehicle)["coaxial-printed"],
            "exact, live": make_law("exact", vehicle),
        }
        for title, law in flown_live.items():
            say(f"flying {law.name} live")
            live, demands, _ = flights.fly_live(sim, vehicle, plan, law)
            errors[title] = errors_of_live(live, vehicle, demands, as_paper=True)
    return {
        title: Flown(title, e.position_error_m, e.allocation.torque_error_Nm, e.allocation.thrust_error_N)
        for title, e in errors.items()
    }


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("reproduce", short_help="Recompute what the paper prints.")(reproduce)
