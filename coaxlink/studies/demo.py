"""The demo, end to end: identify, make tables, upload, fly them side by side, trace what a world hides."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coaxlink.studies.flight import Tell, Watch
from coaxlink.studies.flights import LIVE_LAW, Simulation, fly_live, fly_table, write_table

if TYPE_CHECKING:
    from coaxlink.residual.result import Refinement
    from coaxlink.rotor.identification import Identification
    from coaxlink.studies.flight_errors import FlightErrors
    from coaxlink.tables.worth import Worths

FITTED, HIDDEN = "fitted", "hidden"
TABLES = ("standard", "reduced", FITTED)
LIVE = f"live {LIVE_LAW}"
STEPS = 8  # of `run_demo`


@dataclass(frozen=True)
class DemoResult:
    """All that the demo did."""

    seed: int
    identification: Identification
    uploads: dict[str, dict[str, Any]]
    flights: dict[str, FlightErrors]  # the mixers, where nothing is hidden
    hidden: FlightErrors  # the fitted table, where something is
    live: dict[str, Any]  # the live mixer's own account
    refinement: Refinement
    worths: Worths  # of every table, by the identified rotors


def run_demo(seed: int, out: Path, speed: float, step: Tell, watch: Watch, tell: Tell) -> DemoResult:
    """Every step of the demo, files into `out`; `step` and `watch` show the progress. Raises what they raise.

    The mixers fly where nothing is hidden, each from a full battery and under the same noise; then the fitted
    table flies once more where something is, and what is found there comes from that flight alone.
    """
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.data import read_flight_log, read_stand_log
    from coaxlink.fly.trajectory import mixer_flight, paper_flight
    from coaxlink.residual import refine
    from coaxlink.rotor import identify, save_rotor_model
    from coaxlink.studies.flight_errors import errors_of_live, errors_of_table
    from coaxlink.tables import px4 as tables
    from coaxlink.tables.worth import px4_worths
    from coaxlink.vehicle import Vehicle

    airframe_file = files.example("x8_demo.toml")
    airframe, plan, longer = load_airframe(airframe_file), mixer_flight(), paper_flight()
    world = ["--airframe", str(airframe_file), "--seed", str(seed)]
    sim = Simulation(world, speed, out, watch, tell)
    hiding = Simulation([*world, "--hidden-seed", str(seed)], speed, out, watch, tell)

    step("identifying the rotor pair from 121 stand points")
    identification = identify(read_stand_log(files.example("stand_eq17.csv")), "crm")
    model, rotor_file = identification.model, out / "rotor.toml"
    save_rotor_model(rotor_file, model)

    step("writing the standard, the reduced and the fitted table")
    vehicle = Vehicle(airframe, model)
    reports = {law: tables.report_px4(vehicle, law) for law in TABLES}
    folders = {law: write_table(out, airframe, law, report, rotor_file) for law, report in reports.items()}

    worths = px4_worths(vehicle)
    uploads: dict[str, dict[str, Any]] = {}
    flown = {}
    step("uploading and flying each table")
    for law, folder in folders.items():
        flown[law], uploads[law] = fly_table(sim, law, folder, plan)
    step("flying with the companion mixing live")
    live, demands, account = fly_live(sim, vehicle, plan)

    step("flying the fitted table where something is hidden")
    hidden, uploads[HIDDEN] = fly_table(hiding, HIDDEN, folders[FITTED], longer)

    step("holding the flights against what was meant")
    errors = {law: errors_of_table(flight, vehicle, reports[law].params) for law, flight in flown.items()}
    errors[LIVE] = errors_of_live(live, vehicle, demands)
    off = errors_of_table(hidden, vehicle, reports[FITTED].params)
    step("tracing the residual to what is hidden")
    refinement = refine(read_flight_log(hidden.log), airframe, model)
    if refinement.model is not None:
        save_rotor_model(out / "rotor_refined.toml", refinement.model)
    step("done")
    return DemoResult(seed, identification, uploads, errors, off, account, refinement, worths)
