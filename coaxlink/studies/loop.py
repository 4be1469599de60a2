"""The closed loop: fly, refine, compensate, fly again."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coaxlink.airframe import Airframe
from coaxlink.report.demo import FlightErrors
from coaxlink.report.loop import LoopResult, outcome_of
from coaxlink.studies import allocation, flights
from coaxlink.studies.flight import Tell, Watch, silent

if TYPE_CHECKING:
    from coaxlink.data import Samples
    from coaxlink.fly.trajectory import FlightPlan
    from coaxlink.residual.result import Refinement
    from coaxlink.rotor import RotorModel
    from coaxlink.vehicle import Vehicle

LAW = "fitted"
DEMANDS_HZ = 250.0  # of the vehicle's own time
ENOUGH = 0.99  # of them answered, for a flight to be that of the mixer
OTHER_NOISE = 100_003  # added to the seed for each further flight
LED = "coaxlink loop --lead and coaxlink mix --lead lead slow motors, with livelier commands"
SAGS = "coaxlink loop --live and coaxlink mix follow it as it sags"


@dataclass(frozen=True)
class World:
    """Where is flown: the simulator's arguments but its seed, its speed, the folder of files, the plan."""

    hidden: list[str]
    seed: int
    speed: float
    out: Path
    plan: FlightPlan
    tell: Tell = silent
    watch: Watch = silent

    def simulation(self, flight: int) -> flights.Simulation:
        """The same world, and noise of its own for every flight (from 0)."""
        arguments = [*self.hidden, "--seed", str(self.seed + OTHER_NOISE * flight)]
        return flights.Simulation(arguments, self.speed, self.out, self.watch, self.tell)


@dataclass(frozen=True)
class Wishes:
    """What the user asked for: how to mix (None: by what the effects need), and what may be flown besides."""

    live: bool | None = None
    separate: bool = False
    lead: bool = False


@dataclass(frozen=True)
class _Start:
    """What all flights share: the declared vehicle, its identified rotors, its first table."""

    vehicle: Vehicle
    table: Any


@dataclass(frozen=True)
class _Pair:
    """Both flights, and what was done between them."""

    before: FlightErrors
    after: FlightErrors
    logs: tuple[str, str]
    done: dict[str, str]
    cannot: dict[str, str]


def run_loop(
    truth: Path | None, seed: int, out: Path, speed: float, wishes: Wishes, tell: Tell, watch: Watch
) -> LoopResult:
    """Two flights and what lies between them; four files' worth of results in `out`.

    Nothing is put into the mixer that the data do not demand: where they are contradictory, ambiguous,
    unexplained or at the floor, the second flight is the first once more. Raises what the steps raise.
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
    world = World(["--airframe", str(airframe_file), *hidden], seed, speed, out, paper_flight(), tell, watch)
    tell("identifying the rotor pair")
    model = identify(read_stand_log(files.example("stand_eq17.csv")), "crm").model
    save_rotor_model(out / "rotor.toml", model)
    vehicle = Vehicle(airframe, model)
    start = _Start(vehicle, tables.report_px4(vehicle, LAW))
    tell("first flight")
    flown = _fly_table(world, 0, airframe, "before", start.table, out / "rotor.toml")
    by_table = allocation.errors_of_table(flown, vehicle, start.table.params)
    log = read_flight_log(flown.log)
    tell("tracing the residual")
    refinement = refine(log, airframe, model)
    separated = None
    if wishes.separate and refinement.ambiguous and not refinement.suspect_data:
        separated = _separate(world, start, refinement)
        if separated is not None:
            tell("tracing the residual of both flights")
            refinement = refine([log, read_flight_log(separated)], airframe, model)
    way, pair = _second_flight(world, start, refinement, log, wishes, (flown, by_table))
    return LoopResult(
        seed, way, pair.before, pair.after, *pair.logs, refinement, pair.done, pair.cannot, by_table,
        time.monotonic() - began, outcome_of(refinement, pair.done),
        str(separated) if separated is not None else None,
    )  # fmt: skip


def _second_flight(
    world: World,
    start: _Start,
    refinement: Refinement,
    log: Samples,
    wishes: Wishes,
    first: tuple[Any, FlightErrors],
) -> tuple[str, _Pair]:
    """How was mixed (table or live), and both flights."""
    from coaxlink.effects import effect
    from coaxlink.rotor import save_rotor_model
    from coaxlink.vehicle import Conditions, Vehicle

    airframe, model = start.vehicle.declared, start.vehicle.rotors
    usable = bool(refinement.effects) and not refinement.suspect_data and refinement.model is not None
    found = refinement.model if usable and refinement.model is not None else model
    if usable:
        save_rotor_model(world.out / "rotor_refined.toml", found)
    corrected = Vehicle(airframe, found, Conditions(voltage_V=mean_voltage(log)))
    leads = wishes.lead and any(e.name == "rotor_lag" for e in found.effects)
    live = wishes.live
    if live is None:
        live = leads or any(e.is_live for e in map(effect, corrected.left_out) if e)
    if live:
        return "live", _live_pair(world, start, found, corrected.airframe.mass_kg, leads)
    table, rotor_file = start.table, world.out / "rotor.toml"
    if usable:
        from coaxlink.tables import px4 as tables

        table = tables.report_px4(corrected, LAW)
        rotor_file = world.out / "rotor_refined.toml"
    world.tell("second flight" if usable else "second flight, nothing changed")
    again = _fly_table(world, 1, corrected.airframe, "after", table, rotor_file)
    after = allocation.errors_of_table(again, corrected, table.params)
    done = {
        name: f"{what}; {SAGS}" if name == "battery_voltage" else what
        for name, what in corrected.compensated.items()
    }
    cannot = {
        name: f"{why}; {LED}" if name == "rotor_lag" else why for name, why in corrected.left_out.items()
    }
    flown, before = first
    return "table", _Pair(before, after, (str(flown.log), str(again.log)), done, cannot)


def _separate(world: World, start: _Start, refinement: Refinement) -> Path | None:
    """Fly what would tell rivals apart, by the first table; its log, None where no such flight is known."""
    from coaxlink.fly.trajectory import planned_flight

    experiments = [a.experiment for a in refinement.ambiguous if a.experiment is not None]
    if not experiments:
        return None
    world.tell(f"flying what would separate {' or '.join(experiments[0].names)}")
    there = replace(world, plan=planned_flight(experiments[0].document()))
    rotor = world.out / "rotor.toml"
    return Path(_fly_table(there, 2, start.vehicle.airframe, "separating", start.table, rotor).log)


def mean_voltage(log: Samples) -> float | None:
    """What the pack gave on average in the air; None where that was not logged."""
    if not log.has("voltage_V", "height_m"):
        return None
    volts = log["voltage_V"][log["height_m"] > 0.5]
    return float(volts.mean()) if len(volts) else None


def _fly_table(world: World, flight: int, airframe: Airframe, name: str, report: Any, rotor: Path) -> Any:
    from coaxlink.tables.px4 import refuse_traps

    refuse_traps(report)
    folder = flights.write_table(world.out, airframe, name, report, rotor)
    return flights.fly_table(world.simulation(flight), name, folder, world.plan)[0]


def _fly_live(
    world: World, flight: int, vehicle: Vehicle, name: str, **how: Any
) -> tuple[Any, flights.Demands]:
    """One flight mixed live. Raises CheckFailed when not nearly every demand was answered."""
    from coaxlink.errors import CheckFailed

    sim = world.simulation(flight)
    flown, demands, account = flights.fly_live(sim, vehicle, world.plan, name=name, **how)
    answered = account["cycles"] / (DEMANDS_HZ * world.plan.duration_s)
    # one hand-over belongs to the end of the flight
    if answered < ENOUGH or account["hand_overs"] > 1:
        share = (
            f"{100 * min(answered, 1.0):.0f} % of the demands answered, {account['hand_overs']} hand-overs"
        )
        raise CheckFailed(f"{name}: {share}: not the mixer's flight, so not weighed")
    return flown, demands


def _live_pair(world: World, start: _Start, found: RotorModel, mass_kg: float, leads: bool) -> _Pair:
    """Both flights with the companion mixing, by the stand's model, then by `found` with its effects.

    `mass_kg` is what the effects make the vehicle weigh.
    """
    from coaxlink.live.effects import LiveEffects
    from coaxlink.vehicle import Vehicle

    airframe = start.vehicle.declared
    lag = next((e.parameters["lag_s"] for e in found.effects if e.name == "rotor_lag"), 0.0)
    lead_s = (lag, airframe.motor_lag_s) if leads and lag > airframe.motor_lag_s else (0.0, 0.0)
    world.tell("mixing live without the effects")
    flown, demands = _fly_live(world, 1, start.vehicle, "live_before")
    before = allocation.errors_of_live(flown, start.vehicle, demands)
    world.tell("mixing live with the effects")
    vehicle = Vehicle(airframe, found, measured_live=True)
    again, demands = _fly_live(world, 2, vehicle, "live_after", lead_s=lead_s)
    weighed = Vehicle(replace(airframe, mass_kg=mass_kg), found, measured_live=True)
    after = allocation.errors_of_live(again, weighed, demands)
    account = LiveEffects(None, vehicle)
    done = dict.fromkeys(account.names, "taken out of the commands live, from telemetry")
    cannot = dict(account.left_out)
    if cannot.pop("mass_change", ""):
        done["mass_change"] = (
            f"{mass_kg:.2f} kg instead of {airframe.mass_kg:.2f}: forces are weighed with it"
        )
    if lead_s[0] > 0.0 and cannot.pop("rotor_lag", ""):
        led = f"motors led from {1e3 * lead_s[0]:.0f} to {1e3 * lead_s[1]:.0f} ms"
        done["rotor_lag"] = f"{led}: livelier commands are its price"
    return _Pair(before, after, (str(flown.log), str(again.log)), done, cannot)
