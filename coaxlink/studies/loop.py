"""The closed loop: fly, refine, compensate, fly again."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coaxlink.studies import flight_errors, flights
from coaxlink.studies.flight import RecordedFlight, Tell, Watch, silent
from coaxlink.studies.flight_errors import FlightErrors

if TYPE_CHECKING:
    from coaxlink.data import Samples
    from coaxlink.fly.trajectory import FlightPlan
    from coaxlink.residual.result import Refinement
    from coaxlink.rotor import RotorModel
    from coaxlink.tables.px4 import TableReport
    from coaxlink.vehicle import Vehicle

LAW = "fitted"
DEMANDS_HZ = 250.0  # of the vehicle's own time
ENOUGH = 0.99  # of them answered, for a flight to be that of the mixer
OTHER_NOISE = 100_003  # added to the seed for each further flight
SAGS = "coaxlink loop --live and coaxlink mix follow it as it sags"
OUTCOMES = {  # what was put into the mixer, in words
    "compensated": "put into the mixer: {done}",
    "not_compensable": "nothing could be put into the mixer: what was found is not for a mixer to take away",
    "nothing_found": "nothing found, nothing changed: rotor file and table stay as they are",
    "suspect_data": "nothing changed: the data contradict themselves, and no mixer may follow a biased "
    "sensor; put it right and fly again",
    "ambiguous": "nothing changed: the data do not say which effect it is",
    "unexplained": "nothing changed: no known effect explains the residual",
}


def outcome_of(refinement: Refinement, done: Mapping[str, str]) -> str:
    """What came of it, a key of OUTCOMES; `done` are the effects that were compensated."""
    if refinement.suspect_data:
        return "suspect_data"
    if refinement.effects:
        return "compensated" if done else "not_compensable"
    if refinement.ambiguous:
        return "ambiguous"
    return "unexplained" if refinement.unexplained else "nothing_found"


@dataclass(frozen=True)
class LoopResult:
    """All that the loop did."""

    seed: int
    way: str  # table or live: how both flights were mixed
    before: FlightErrors
    after: FlightErrors
    log_before: str
    log_after: str
    refinement: Refinement
    compensated: Mapping[str, str]  # effect -> what was done
    not_compensated: Mapping[str, str]  # effect -> why nothing was
    table_before: FlightErrors  # of the first flight, by table; `before` unless the way is live
    seconds: float  # wall time of it all
    outcome: str  # one of OUTCOMES

    def to_json(self) -> dict[str, Any]:
        """As `loop --json` writes it."""
        refined = self.refinement.to_json()
        plain = {k: v for k, v in vars(self).items() if k != "refinement"}
        return {
            **plain,
            "before": self.before.to_json(),
            "after": self.after.to_json(),
            "table_before": self.table_before.to_json(),
            "compensated": dict(self.compensated),
            "not_compensated": dict(self.not_compensated),
            "effects": refined["effects"],
            "refine": refined,
        }


@dataclass(frozen=True)
class LoopSetup:
    """What all flights of a loop share: the world, the plan, the vehicle as it is identified on the stand."""

    hidden: list[str]  # the simulator's arguments but its seed and speed
    seed: int
    speed: float
    out: Path
    plan: FlightPlan
    vehicle: Vehicle
    tell: Tell = silent
    watch: Watch = silent

    def simulation(self, flight: int) -> flights.Simulation:
        """The same world, and noise of its own for every flight (from 0)."""
        arguments = [*self.hidden, "--seed", str(self.seed + OTHER_NOISE * flight)]
        return flights.Simulation(arguments, self.speed, self.out, self.watch, self.tell)


@dataclass(frozen=True)
class _FlightPair:
    """Both flights, and what was done between them."""

    way: str
    before: FlightErrors
    after: FlightErrors
    log_before: str
    log_after: str
    done: dict[str, str]
    cannot: dict[str, str]


def run_loop(
    truth: Path | None,
    seed: int,
    out: Path,
    speed: float,
    *,
    live: bool | None = None,
    tell: Tell = silent,
    watch: Watch = silent,
) -> LoopResult:
    """Two flights and what lies between them; models, tables, backups and logs go to `out`.

    `live`: how both are mixed (None: by what the effects need). Nothing is put into the mixer that
    the data do not demand: where they are contradictory, ambiguous, unexplained or at the floor, the second
    flight is the first once more. Raises what the steps raise.
    """
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.data import read_flight_log, read_stand_log
    from coaxlink.fly.trajectory import paper_flight
    from coaxlink.residual import refine
    from coaxlink.rotor import identify, save_rotor_model
    from coaxlink.tables import px4 as tables
    from coaxlink.vehicle import Vehicle

    began = time.monotonic()
    airframe_file = files.example("x8_demo.toml")
    airframe = load_airframe(airframe_file)
    hidden = ["--truth", str(truth.resolve())] if truth is not None else ["--hidden-seed", str(seed)]
    tell("identifying the rotor pair")
    model = identify(read_stand_log(files.example("stand_eq17.csv")), "crm").model
    save_rotor_model(out / "rotor.toml", model)
    vehicle = Vehicle(airframe, model)
    arguments = ["--airframe", str(airframe_file), *hidden]
    setup = LoopSetup(arguments, seed, speed, out, paper_flight(), vehicle, tell, watch)
    table = tables.report_px4(vehicle, LAW)
    tell("first flight")
    flown = _fly_table(setup, 0, vehicle, "before", table)
    by_table = flight_errors.errors_of_table(flown, vehicle, table.params)
    log = read_flight_log(flown.log)
    tell("tracing the residual")
    refinement = refine(log, airframe, model)
    found, corrected = _corrected(setup, refinement, log)
    if live is None:
        live = _needs_live(corrected)
    if live:
        pair = _live_pair(setup, found or model, corrected.airframe.mass_kg)
    else:
        pair = _table_pair(setup, table, corrected if found is not None else None, flown, by_table)
    return LoopResult(
        seed, pair.way, pair.before, pair.after, pair.log_before, pair.log_after, refinement, pair.done,
        pair.cannot, by_table, time.monotonic() - began, outcome_of(refinement, pair.done),
    )  # fmt: skip


def _corrected(setup: LoopSetup, refinement: Refinement, log: Samples) -> tuple[RotorModel | None, Vehicle]:
    """The refined model, None where nothing is found that a mixer may use; the vehicle with it."""
    from coaxlink.rotor import save_rotor_model
    from coaxlink.vehicle import Conditions, Vehicle

    usable = bool(refinement.effects) and not refinement.suspect_data
    found = refinement.model if usable else None
    if found is not None:
        save_rotor_model(setup.out / "rotor_refined.toml", found)
    declared = setup.vehicle
    return found, Vehicle(
        declared.declared, found or declared.rotors, Conditions(voltage_V=mean_voltage(log))
    )


def _needs_live(corrected: Vehicle) -> bool:
    """Whether an effect that no table can hold can be taken out live."""
    from coaxlink.effects import effect

    return any(e.is_live for e in map(effect, corrected.left_out) if e)


def mean_voltage(log: Samples) -> float | None:
    """What the pack gave on average in the air; None where that was not logged."""
    if not log.has("voltage_V", "height_m"):
        return None
    volts = log["voltage_V"][log["height_m"] > 0.5]
    return float(volts.mean()) if len(volts) else None


def _table_pair(
    setup: LoopSetup,
    table: TableReport,
    corrected: Vehicle | None,
    flown: RecordedFlight,
    before: FlightErrors,
) -> _FlightPair:
    """The first flight and one by the corrected vehicle's table; by the same table where that is None."""
    from coaxlink.tables import px4 as tables

    vehicle = corrected or setup.vehicle
    if corrected is not None:
        table = tables.report_px4(corrected, LAW)
    setup.tell("second flight" if corrected is not None else "second flight, nothing changed")
    again = _fly_table(setup, 1, vehicle, "after", table, refined=corrected is not None)
    after = flight_errors.errors_of_table(again, vehicle, table.params)
    done = dict(vehicle.compensated) if corrected is not None else {}
    if "battery_voltage" in done:
        done["battery_voltage"] += f"; {SAGS}"
    cannot = dict(vehicle.left_out)
    return _FlightPair("table", before, after, str(flown.log), str(again.log), done, cannot)


def _fly_table(
    setup: LoopSetup, flight: int, vehicle: Vehicle, name: str, table: TableReport, *, refined: bool = False
) -> RecordedFlight:
    from coaxlink.tables.px4 import refuse_traps

    refuse_traps(table)
    rotor = setup.out / ("rotor_refined.toml" if refined else "rotor.toml")
    folder = flights.write_table(setup.out, vehicle.airframe, name, table, rotor)
    return flights.fly_table(setup.simulation(flight), name, folder, setup.plan)[0]


def _live_pair(setup: LoopSetup, found: RotorModel, mass_kg: float) -> _FlightPair:
    """Both flights with the companion mixing, by the stand's model, then by `found` with its effects.

    `mass_kg` is what the effects make the vehicle weigh.
    """
    from coaxlink.live.effects import LiveEffects
    from coaxlink.vehicle import Vehicle

    airframe = setup.vehicle.declared
    setup.tell("mixing live without the effects")
    flown, demands = _fly_live(setup, 1, setup.vehicle, "live_before")
    before = flight_errors.errors_of_live(flown, setup.vehicle, demands)
    setup.tell("mixing live with the effects")
    vehicle = Vehicle(airframe, found, measured_live=True)
    again, demands = _fly_live(setup, 2, vehicle, "live_after")
    weighed = Vehicle(replace(airframe, mass_kg=mass_kg), found, measured_live=True)
    after = flight_errors.errors_of_live(again, weighed, demands)
    account = LiveEffects(None, vehicle)
    done = dict.fromkeys(account.names, "taken out of the commands live, from telemetry")
    cannot = dict(account.left_out)
    if cannot.pop("mass_change", ""):
        done["mass_change"] = (
            f"{mass_kg:.2f} kg instead of {airframe.mass_kg:.2f}: forces are weighed with it"
        )
    return _FlightPair("live", before, after, str(flown.log), str(again.log), done, cannot)


def _fly_live(
    setup: LoopSetup, flight: int, vehicle: Vehicle, name: str
) -> tuple[RecordedFlight, flights.Demands]:
    """One flight mixed live. Raises CheckFailed when not nearly every demand was answered."""
    from coaxlink.errors import CheckFailed

    flown, demands, account = flights.fly_live(setup.simulation(flight), vehicle, setup.plan, name=name)
    answered = account["cycles"] / (DEMANDS_HZ * setup.plan.duration_s)
    # one hand-over belongs to the end of the flight
    if answered < ENOUGH or account["hand_overs"] > 1:
        share = (
            f"{100 * min(answered, 1.0):.0f} % of the demands answered, {account['hand_overs']} hand-overs"
        )
        raise CheckFailed(f"{name}: {share}: not the mixer's flight, so not weighed")
    return flown, demands
