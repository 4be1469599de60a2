"""What a mixer table is worth in flight: every table through the same flights, on equal seeds.

    python research/table_worth.py [--airframe A] [--seeds 8] [--trials drop "yaw steps"] [--json F]

First the figures by the rotor model alone (`coaxlink compare`), then flights on the PX4 stand-in, which reads
its own table and flies its own cascade; the exact law is what a companion that mixes live without delay would
do. Every table is tuned alike at the airframe's own mass (sim/px4/tuning.py). Differences are paired by
seed, with a 95 % interval by Student's t. Two processes; five minutes on two cores with nothing else to do.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from coaxlink.airframe import load_airframe
from coaxlink.mixer.exact.native import NativeExact
from coaxlink.report.worth import remark_on_curve, rows, verdict
from coaxlink.rotor.model import load_rotor_model
from coaxlink.tables.px4 import px4_table
from coaxlink.tables.worth import CURVED, DEFAULTS, LIVE, default_table, px4_worths
from coaxlink.vehicle import Vehicle
from firmware_params import px4
from sim.effects import HiddenEffect
from sim.errors import WorldError
from sim.flights import circle, vigorous
from sim.physics.rotors import read_pair
from sim.px4.autopilot import RATE_HZ
from sim.px4.cascade import Goal
from sim.quick.flight import FIGURES, FlightFigures, FlightWorld, NativeMixing, fly_quick, make_design
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[1] / "examples"
TABLES = (DEFAULTS, "standard", CURVED, "reduced", "fitted", LIVE)
LEFT = ("thrust_error_N", "roll_error_Nm", "pitch_error_Nm", "yaw_error_Nm")
SHOWN = (
    ("height_max_m", "height max m", ".3f"), ("height_rms_m", "rms m", ".4f"), ("sunk_m", "sunk m", ".3f"),
    ("level_rms_m", "level m", ".3f"), ("tilt_rms_deg", "tilt deg", ".2f"),
    ("yaw_rms_deg", "yaw rms deg", ".2f"), ("yaw_max_deg", "yaw max", ".1f"),
    ("saturated", "saturated", ".3f"), ("shaft_W", "shaft W", ".0f"), ("pack_W", "pack W", ".0f"),
)  # fmt: skip


def mixers(airframe: Path) -> dict[str, Any]:
    """Every table as PX4's parameters, and the live law."""
    frame = load_airframe(airframe)
    assert frame.rotor_model is not None
    model = load_rotor_model(frame.rotor_model)
    made = {law: px4_table(Vehicle(frame, model), law) for law in ("standard", CURVED, "reduced", "fitted")}
    made[DEFAULTS] = default_table(frame)
    tables: dict[str, Any] = {name: px4.table_to_params(table) for name, table in made.items()}
    return tables | {LIVE: NativeExact(Vehicle(frame, model))}


_MIXERS: dict[Path, dict[str, Any]] = {}  # of this process


def fly(job: tuple[Path, str, str, int]) -> tuple[list[float], list[float]]:
    """One flight: its figures, and what a constant gain leaves of thrust, roll, pitch and yaw."""
    airframe, trial, table, seed = job
    if airframe not in _MIXERS:
        _MIXERS[airframe] = mixers(airframe)
    outcome = fly_trial(TRIALS[trial], airframe, _MIXERS[airframe][table], seed)
    return [getattr(outcome, name) for name in FIGURES], [getattr(outcome, name) for name in LEFT]


def interval(x: NDArray[np.float64]) -> tuple[float, float]:
    """Mean and half its 95 % interval."""
    half = (
        float(student.ppf(0.975, len(x) - 1) * x.std(ddof=1) / math.sqrt(len(x))) if len(x) > 1 else math.nan
    )
    return float(x.mean()), half


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--airframe", type=Path, default=EXAMPLES / "x8_demo.toml")
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--trials", nargs="+", choices=list(TRIALS), default=list(TRIALS))
    parser.add_argument("--tables", nargs="+", choices=TABLES, default=list(TABLES))
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--small", action="store_true", help="a hover and a yaw step by two tables")
    o = parser.parse_args()
    if o.small:
        o.seeds, o.trials, o.tables = 2, ["hover", "yaw steps"], ["standard", "fitted"]
    static(o.airframe)
    start = time.monotonic()
    document: dict[str, Any] = {}
    with multiprocessing.get_context("spawn").Pool(o.processes) as pool:
        for trial in o.trials:
            jobs = [(o.airframe, trial, table, seed) for table in o.tables for seed in range(o.seeds)]
            keys = [job[1:] for job in jobs]
            flown = dict(zip(keys, pool.imap(fly, jobs, chunksize=2), strict=True))
            document[trial] = show(trial, o.tables, o.seeds, flown)
    print(f"\n{o.seeds} seeds, {time.monotonic() - start:.0f} s")
    if o.json:
        o.json.write_text(json.dumps(document, indent=1))


def static(airframe: Path) -> None:
    """The rotor model's figures."""
    frame = load_airframe(airframe)
    assert frame.rotor_model is not None
    worths = px4_worths(Vehicle(frame, load_rotor_model(frame.rotor_model)))
    fitted, standard = worths.named("fitted"), worths.named("standard")
    assert fitted is not None and standard is not None
    print(verdict(fitted, standard))
    print(remark_on_curve(worths.named(CURVED), fitted, worths.own_curve))
    print(f"{'':46s}" + "".join(f"{t.name:>20s}" for t in worths.rows))
    for label, *cells in rows(worths.rows):
        print(f"{label:46s}" + "".join(f"{cell:>20s}" for cell in cells))


def show(trial: str, tables: list[str], seeds: int, flown: dict[Any, Any]) -> dict[str, Any]:
    """A row a table, then the paired difference; returns them."""
    print(f"\n{trial}: {TRIALS[trial].what}")
    print(f"{'':20s}" + "".join(f"{head:>13s}" for _, head, _ in SHOWN) + "   left N  left yaw N m")
    found: dict[str, Any] = {}
    by_table = {}
    for table in tables:
        values = np.array([flown[trial, table, seed][0] for seed in range(seeds)])
        shape = np.array([flown[trial, table, seed][1] for seed in range(seeds)])
        by_table[table] = values
        means = dict(zip(FIGURES, values.mean(axis=0).tolist(), strict=True))
        found[table] = means | {"shape": shape.mean(axis=0).tolist()}
        cells = "".join(f"{means[name]:>13{form}}" for name, _, form in SHOWN)
        print(f"{table:20s}{cells}{shape[:, 0].mean():>9.3f}{shape[:, 3].mean():>14.4f}")
    for other in ("standard", CURVED):
        if other not in by_table or "fitted" not in by_table:
            continue
        pairs = by_table["fitted"] - by_table[other]
        spans = {name: interval(pairs[:, k]) for k, name in enumerate(FIGURES)}
        found[f"fitted - {other}"] = spans
        cells = "".join(f"{spans[name][0]:>+13{form}}" for name, _, form in SHOWN)
        print(f"{'fitted - ' + other[:10]:20s}{cells}")
        halves = "".join(f"{spans[name][1]:>13{form}}" for name, _, form in SHOWN)
        print(f"{'  95 %, +-':20s}{halves}", flush=True)
    return found


# the flights: what a seed draws is the same for every table, so that outcomes are paired

HEIGHT_M = 6.0
HERE, STILL = (0.0, 0.0, -HEIGHT_M), (0.0, 0.0, 0.0)
SETTLE_S = 8.0
BACK_S = 5.0  # after a step, or a rotor's weakness
THRUST_LEFT = 0.75  # of a weak motor's thrust


@dataclass(frozen=True)
class Draw:
    """What a seed decides."""

    at_s: float  # when it happens, after settling
    direction_deg: float
    rotor: int
    sign: float

    @classmethod
    def of(cls, seed: int, rotors: int) -> Draw:
        """The draw of a seed; every rotor in turn, for upper and lower ones differ."""
        random = np.random.default_rng([seed, 0x3047])
        at, direction = float(random.uniform(2.0, 4.0)), float(random.uniform(0.0, 360.0))
        return cls(at, direction, 1 + (5 * seed) % rotors, float(random.choice([-1.0, 1.0])))


@dataclass(frozen=True)
class TableTrial:
    """One flight: the goal over time (s after settling), what is true meanwhile, how the loops are set."""

    what: str
    goal: Callable[[float, Draw], Goal]
    effects: Callable[[Draw, float], tuple[HiddenEffect, ...]]  # of a draw and the time that settling ends
    seconds: float = 12.0
    integrals: float = 1.0  # times PX4's own and the tuned ones
    hover_estimate: bool = True  # MPC_USE_HTE
    lift_tuned: bool = True  # vertical gains by the table's slope in hover; else PX4's own for every table
    charge: float = 0.95  # of the pack, to begin with


def _after(t: float, d: Draw) -> float:
    """1 from the draw's time on, 0 again some seconds later."""
    return float(d.at_s < t <= d.at_s + BACK_S)


def _hover(t: float, d: Draw) -> Goal:
    return Goal(HERE, STILL)


def _circle(t: float, d: Draw) -> Goal:
    return Goal((2.0, 0.0, -HEIGHT_M), STILL) if t < 0.0 else circle(t, 2.0, -HEIGHT_M, 8.0)


def _vigorous(t: float, d: Draw) -> Goal:
    return vigorous(max(t, 0.0) + d.at_s)


def _yaw_steps(t: float, d: Draw) -> Goal:
    return Goal(HERE, STILL, yaw=0.5 * math.pi * d.sign * _after(t, d))


def _height_steps(t: float, d: Draw) -> Goal:
    return Goal((0.0, 0.0, -HEIGHT_M - 2.0 * _after(t, d)), STILL)


def _climb_and_yaw(t: float, d: Draw) -> Goal:
    turned = 0.5 * math.pi * d.sign * (t > d.at_s)
    return Goal((0.0, 0.0, -HEIGHT_M - 3.0 * _after(t, d)), STILL, yaw=turned)


def _nothing(d: Draw, settled_s: float) -> tuple[HiddenEffect, ...]:
    return ()


def _carried(kg: float) -> Callable[[Draw, float], tuple[HiddenEffect, ...]]:
    return lambda d, settled_s: (HiddenEffect("mass_change", kg),)


def _dropped(d: Draw, settled_s: float) -> tuple[HiddenEffect, ...]:
    return (HiddenEffect("mass_change", 5.0), HiddenEffect("mass_change", -5.0, settled_s + d.at_s))


def _gusts(d: Draw, settled_s: float) -> tuple[HiddenEffect, ...]:
    extra = {"direction_deg": d.direction_deg, "gust_m_s": 3.0}
    return (HiddenEffect("wind", 8.0, 0.0, extra, "dryden"),)


def _weak(d: Draw, settled_s: float) -> tuple[HiddenEffect, ...]:
    """Speeds of one motor by the square root of what is left, and back."""
    onset, extra = settled_s + d.at_s, {"rotor": float(d.rotor)}
    return (
        HiddenEffect("degraded_rotor", 1.0 - THRUST_LEFT, onset, extra, "weak_motor"),
        HiddenEffect("degraded_rotor", 1.0 - 1.0 / THRUST_LEFT, onset + BACK_S, extra, "weak_motor"),
    )


def _unregulated(d: Draw, settled_s: float) -> tuple[HiddenEffect, ...]:
    return (HiddenEffect("battery_voltage", 1.0, 0.0, {}, "motor"), HiddenEffect("mass_change", 5.0))


def _racing(trial: TableTrial) -> TableTrial:
    what = "the same, integrals at a tenth, no hover estimate"
    return replace(trial, what=what, integrals=0.1, hover_estimate=False)


def _mapping(trial: TableTrial) -> TableTrial:
    return replace(trial, what="the same, integrals half as strong again", integrals=1.5)


_DROP = TableTrial("5 of 25 kg dropped", _hover, _dropped)
_WEAK = TableTrial("one motor at 75 % of its thrust for 5 s", _hover, _weak)
_BUSY = TableTrial("fast circles, climbs and yaw at once", _vigorous, _nothing, 25.0)

TRIALS: dict[str, TableTrial] = {
    "hover": TableTrial("calm hover", _hover, _nothing),
    "circle": TableTrial("circle of 2 m in 8 s", _circle, _nothing, 16.0),
    "gusts": TableTrial("hover in 8 m/s of wind, gusts of 3 m/s", _hover, _gusts, 20.0),
    "busy": _BUSY,
    "busy, 15 kg": replace(_BUSY, what="the same at 15 kg, gains tuned at 20", effects=_carried(-5.0)),
    "busy, 28 kg": replace(_BUSY, what="the same at 28 kg, gains tuned at 20", effects=_carried(8.0)),
    "height steps": TableTrial("2 m up and down", _height_steps, _nothing),
    "drop": _DROP,
    "drop, racing": _racing(_DROP),
    "drop, mapping": _mapping(_DROP),
    "drop, stock": replace(_DROP, what="the same on PX4's own vertical gains", lift_tuned=False),
    "weak rotor": _WEAK,
    "weak, racing": _racing(_WEAK),
    "yaw steps": TableTrial("90 degrees of yaw there and back", _yaw_steps, _nothing),
    "yaw, racing": _racing(TableTrial("", _yaw_steps, _nothing)),
    "yaw, 25 kg": TableTrial("the same at 25 kg, gains tuned at 20", _yaw_steps, _carried(5.0)),
    "near full": TableTrial("36 kg: 3 m up with 90 degrees of yaw", _climb_and_yaw, _carried(16.0)),
    "low battery": TableTrial(
        "25 kg, pack at 20 %, unregulated ESCs: 3 m up with 90 degrees of yaw",
        _climb_and_yaw, _unregulated, charge=0.2,
    ),
}  # fmt: skip


def fly_trial(
    trial: TableTrial,
    airframe: Path,
    mixer: Mapping[str, float] | NativeMixing,
    seed: int = 0,
    rotor: Path | None = None,
) -> FlightFigures:
    """Fly a table (PX4's parameters by name, on top of its defaults) or a compiled law. Raises WorldError."""
    vehicle = read_vehicle(airframe)
    rotor = rotor or vehicle.rotor_file
    if rotor is None:
        raise WorldError(airframe, "rotor_model", "a rotor file is expected")
    draw = Draw.of(seed, vehicle.rotors)

    def goals(times: NDArray[np.float64], _: int) -> NDArray[np.float64]:
        found = (trial.goal(t, draw) for t in times.tolist())
        return np.array([(*g.position, *g.velocity, *g.acceleration, g.yaw, g.yaw_rate) for g in found])

    design = make_design(
        vehicle, read_pair(rotor), mixer,
        lift=trial.lift_tuned, integrals=trial.integrals, hover_estimate=trial.hover_estimate,
    )  # fmt: skip
    effects = trial.effects(draw, SETTLE_S)
    world = FlightWorld(effects, seed, goals, trial.seconds, SETTLE_S, trial.charge, RATE_HZ)
    return fly_quick(design, world)[0]


if __name__ == "__main__":
    main()
