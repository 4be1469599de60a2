"""The whole ledger: every claim recomputed, Table 4 flown where that is wanted."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from coaxlink import _interrupts
from coaxlink.studies.flight import Tell, silent

if TYPE_CHECKING:
    from coaxlink.studies.paper.ledger import Ledger
    from coaxlink.studies.paper.tables import MixerErrors

SPEED = 8.0  # of the simulator, times real time


def recompute(*, fly_table_4: bool, pair: Path | None, tell: Tell = silent) -> Ledger:
    """All claims; flights take about a minute."""
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.data import read_stand_log
    from coaxlink.rotor import identify, load_rotor_model
    from coaxlink.studies.paper import Ledger, contradictions, equations, tables

    airframe = load_airframe(files.example("x8_paper.toml"))
    crm, rcrm, srm = (
        load_rotor_model(files.example(f"rotor_{name}.toml")) for name in ("paper", "eq15", "srm_paper")
    )
    tell("identifying 121 points made with eq. 17")
    identified = identify(read_stand_log(files.example("stand_eq17.csv")), "crm")
    flights = _fly(tell) if fly_table_4 else {}
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


def _fly(tell: Tell) -> dict[str, MixerErrors]:
    """The paper's mixers and the mended ones on the eq. 17 plant, by the names of Table 4's columns."""
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.fly.trajectory import table_4_flight
    from coaxlink.mixer import make_law
    from coaxlink.rotor import load_rotor_model
    from coaxlink.studies import flights
    from coaxlink.studies.flight_errors import errors_of_live, errors_of_table
    from coaxlink.studies.paper import printed_laws
    from coaxlink.studies.paper.tables import MixerErrors
    from coaxlink.tables import px4 as tables
    from coaxlink.vehicle import Vehicle

    airframe_file = files.example("x8_demo.toml")
    airframe, plan, world = load_airframe(airframe_file), table_4_flight(), ["--airframe", str(airframe_file)]
    vehicle = Vehicle(airframe, load_rotor_model(files.example("rotor_paper.toml")))
    columns = {  # law and rotor model of each
        "standard": ("standard", "srm_paper"),
        "reduced": ("reduced", "eq15"),
        "fitted table": ("fitted", "paper"),
    }
    errors = {}
    _interrupts.begin()
    with tempfile.TemporaryDirectory() as name:
        out = Path(name)
        reports, folders = {}, {}
        for title, (law, rotor) in columns.items():
            file = files.example(f"rotor_{rotor}.toml")
            reports[title] = tables.report_px4(Vehicle(airframe, load_rotor_model(file)), law)
            folders[title] = flights.write_table(out, airframe, title, reports[title], file)
        tell(f"flying {', '.join(columns)} as PX4 tables")
        sim = flights.Simulation(world, SPEED, out, tell=tell)
        flown, _ = flights.fly_tables(sim, folders, plan)
        for title, flight in flown.items():
            errors[title] = errors_of_table(flight, vehicle, reports[title].params, as_paper=True)
        algorithm_1, exact = printed_laws(vehicle)["coaxial-printed"], make_law("exact", vehicle)
        for title, flies in (("coaxial", algorithm_1), ("exact, live", exact)):
            tell(f"flying {flies.name} live")
            live, demands, _ = flights.fly_live(sim, vehicle, plan, flies)
            errors[title] = errors_of_live(live, vehicle, demands, as_paper=True)
    return {
        title: MixerErrors(
            title, e.position_error_m, e.allocation.torque_error_Nm, e.allocation.thrust_error_N
        )
        for title, e in errors.items()
    }
