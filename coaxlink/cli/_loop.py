"""The loop's steps: fly, refine, compensate, fly again; `loop.py` shows them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coaxlink.airframe import Airframe
from coaxlink.cli import _demo as steps
from coaxlink.cli._demo import Watch
from coaxlink.report.demo import FlightErrors
from coaxlink.report.loop import LoopResult
from coaxlink.rotor import RotorModel

if TYPE_CHECKING:
    from coaxlink.data import Samples
    from coaxlink.link.trajectory import Plan

LAW, LIVE_LAW = "fitted", "exact"
DEMANDS_HZ = 250.0  # of the vehicle's own time
ENOUGH = 0.99  # of them answered, for a flight to be that of the mixer
Tell = Callable[[str], None]


@dataclass(frozen=True)
class World:
    """Where is flown: the simulator's arguments, its speed, the folder of all files, the plan."""

    arguments: list[str]
    speed: float
    out: Path
    plan: Plan


def run_loop(
    truth: Path | None, seed: int, out: Path, speed: float, live: bool | None, tell: Tell, watch: Watch
) -> LoopResult:
    """Two flights and what lies between them; four files' worth of results in `out`.

    `live` mixes both flights live; None does where the effects found ask for it. Raises what the steps raise.
    """
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.data import read_flight_log, read_stand_log
    from coaxlink.link import tables
    from coaxlink.link.trajectory import paper_flight
    from coaxlink.mixer import Conditions, see
    from coaxlink.mixer.seen import LIVE_ONLY
    from coaxlink.residual import refine
    from coaxlink.rotor import identify, save_rotor_model

    began = time.monotonic()
    airframe_file = files.example("x8_demo.toml")
    airframe = load_airframe(airframe_file)
    hidden = ["--truth", str(truth.resolve())] if truth is not None else ["--hidden-seed", str(seed)]
    world = World(
        ["--airframe", str(airframe_file), "--seed", str(seed), *hidden], speed, out, paper_flight()
    )
    tell("identifying the rotor pair")
    model = identify(read_stand_log(files.example("stand_eq17.csv")), "crm").model
    save_rotor_model(out / "rotor.toml", model)
    first = tables.report_px4(airframe, model, LAW)
    tell("first flight")
    flown = _fly_table(world, airframe, "before", first, out / "rotor.toml", watch)
    by_table = steps.errors_of_table(flown, airframe, model, first.params, whole=True)
    log = read_flight_log(flown.log)
    tell("tracing the residual")
    refinement = refine(log, airframe, model)
    found = refinement.model or model
    save_rotor_model(out / "rotor_refined.toml", found)
    seen = see(airframe, found, Conditions(voltage_V=mean_voltage(log)))
    if live is None:
        live = any(name in LIVE_ONLY for name in seen.cannot)
    if live:
        before, after, done, cannot = _live_pair(
            world, airframe, model, found, seen.airframe.mass_kg, tell, watch
        )
        logs = str(out / "live_before.tlog"), str(out / "live_after.tlog")
    else:
        second = tables.report_px4(seen.airframe, seen.model, LAW)
        tell("second flight")
        again = _fly_table(world, seen.airframe, "after", second, out / "rotor_refined.toml", watch)
        before = by_table
        after = steps.errors_of_table(again, seen.airframe, seen.model, second.params, whole=True)
        done, cannot, logs = dict(seen.done), dict(seen.cannot), (str(flown.log), str(again.log))
    return LoopResult(
        seed, "live" if live else "table", before, after, *logs, refinement, done, cannot, by_table,
        time.monotonic() - began,
    )  # fmt: skip


def mean_voltage(log: Samples) -> float | None:
    """What the pack gave on average in the air; None where that was not logged."""
    if not log.has("voltage_V", "height_m"):
        return None
    volts = log["voltage_V"][log["height_m"] > 0.5]
    return float(volts.mean()) if len(volts) else None


def _fly_table(world: World, airframe: Airframe, name: str, report: Any, rotor: Path, watch: Watch) -> Any:
    from coaxlink.cli.demo import upload_into, write_table
    from coaxlink.link.tables import refuse_traps

    refuse_traps(report)
    folder = write_table(world.out, airframe, name, report, rotor)
    flown, _ = steps.fly_tables(
        world.arguments, world.speed, {name: folder}, upload_into(world.out), world.plan, world.out, watch
    )
    return flown[name]


def _fly_live(
    world: World, airframe: Airframe, rotors: RotorModel, name: str, effects: bool, watch: Watch
) -> tuple[Any, steps.Demands]:
    """One flight mixed live. Raises CheckFailed when not nearly every demand was answered."""
    from coaxlink.errors import CheckFailed

    flight, demands, account = steps.fly_live(
        world.arguments, world.speed, airframe, rotors, world.plan, world.out, watch,
        law=LIVE_LAW, name=name, effects=effects,
    )  # fmt: skip
    answered = account["cycles"] / (DEMANDS_HZ * world.plan.duration_s)
    # one hand-over belongs to the end of the flight
    if answered < ENOUGH or account["hand_overs"] > 1:
        share = (
            f"{100 * min(answered, 1.0):.0f} % of the demands answered, {account['hand_overs']} hand-overs"
        )
        raise CheckFailed(f"{name}: {share}: not the mixer's flight, so not weighed")
    return flight, demands


def _live_pair(
    world: World,
    airframe: Airframe,
    model: RotorModel,
    found: RotorModel,
    mass_kg: float,
    tell: Tell,
    watch: Watch,
) -> tuple[FlightErrors, FlightErrors, dict[str, str], dict[str, str]]:
    """Both flights with the companion mixing, by `model`, then by `found` with its effects.

    `mass_kg` is what the effects make the vehicle weigh.
    """
    from coaxlink.link.live_effects import LiveEffects

    errors = []
    ways = (("live_before", model, airframe.mass_kg, False), ("live_after", found, mass_kg, True))
    for name, rotors, mass, with_effects in ways:
        tell(f"mixing live {'with' if with_effects else 'without'} the effects")
        flight, demands = _fly_live(world, airframe, rotors, name, with_effects, watch)
        weighed = replace(airframe, mass_kg=mass)
        errors.append(steps.errors_of_live(flight, weighed, rotors, demands, whole=True))
    account = LiveEffects(None, airframe, found)
    done = dict.fromkeys(account.names, "taken out of the commands live, from telemetry")
    cannot = dict(account.left_out)
    if cannot.pop("mass_change", None):
        done["mass_change"] = (
            f"{mass_kg:.2f} kg instead of {airframe.mass_kg:.2f}: forces are weighed with it"
        )
    return errors[0], errors[1], done, cannot
