"""The demo, end to end: identify, make tables, upload, fly them side by side, trace what a world hides."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
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
TABLES = ("standard", FITTED)
LIVE = f"live {LIVE_LAW}"
STEPS = 5  # of `run_demo`
AT_ONCE = 2  # flights: what two cores carry, a simulator taking most of one


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
    """Every step of the demo, files into `out`; `step` and `watch` show progress. Raises what they raise.

    The mixers fly where nothing is hidden, each from a full battery and under the same noise. The fitted
    table flies once more where something is, and what is found comes from that flight alone. Two fly at once.
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

    step("identifying the rotor pair from 121 stand points")
    identification = identify(read_stand_log(files.example("stand_eq17.csv")), "crm")
    model, rotor_file = identification.model, out / "rotor.toml"
    save_rotor_model(rotor_file, model)

    step("writing the standard and the fitted table")
    vehicle = Vehicle(airframe, model)
    reports = {law: tables.report_px4(vehicle, law) for law in TABLES}
    folders = {law: write_table(out, airframe, law, report, rotor_file) for law, report in reports.items()}

    step("uploading and flying: standard, fitted, the exact law live, and where something is hidden")
    with _Flights(watch) as fly:
        sim = Simulation(world, speed, out, fly.watch, tell)
        hiding = Simulation([*world, "--hidden-seed", str(seed)], speed, out, fly.watch, tell)
        there = fly.submit(fly_table, hiding, HIDDEN, folders[FITTED], longer)  # the longest begins
        by_live = fly.submit(fly_live, sim, vehicle, plan)
        by_table = {law: fly.submit(fly_table, sim, law, folder, plan) for law, folder in folders.items()}
        worths = px4_worths(vehicle)  # while they fly
        hidden, uploaded = there.result()
        refinement = refine(read_flight_log(hidden.log), airframe, model)
        off = errors_of_table(hidden, vehicle, reports[FITTED].params)
        live, demands, account = by_live.result()
        flown = {law: flight.result() for law, flight in by_table.items()}

    step("holding the flights against what was meant")
    errors = {law: errors_of_table(f, vehicle, reports[law].params) for law, (f, _) in flown.items()}
    errors[LIVE] = errors_of_live(live, vehicle, demands)
    uploads = {law: upload for law, (_, upload) in flown.items()} | {HIDDEN: uploaded}
    if refinement.model is not None:
        save_rotor_model(out / "rotor_refined.toml", refinement.model)
    step("done")
    return DemoResult(seed, identification, uploads, errors, off, account, refinement, worths)


class _Flights:
    """Flights in threads of their own, `AT_ONCE` of them; what ends the block early ends each of them."""

    def __init__(self, watch: Watch) -> None:
        self._watch, self._ended = watch, threading.Event()
        self._pool = ThreadPoolExecutor(AT_ONCE)
        self.submit = self._pool.submit

    def watch(self, segment: str, seconds: float) -> None:
        """Of a flight, at every set-point. Raises KeyboardInterrupt there when all shall end."""
        if self._ended.is_set():
            raise KeyboardInterrupt
        self._watch(segment, seconds)

    def __enter__(self) -> _Flights:
        return self

    def __exit__(self, why: object, *_: object) -> None:
        if why:
            self._ended.set()
        self._pool.shutdown(cancel_futures=True)
