"""Hidden against found: logs of the simulator's world with an effect in them, through `refine`, blind.

    python benchmarks/blind.py [--seeds 20] [--clean 100] [--only NAME,...] [--kind stand|flight|all]

The world writes its effects by its own laws (package `sim`); `refine` is given the log, the paper's rotor
model and the airframe, never the truth. Printed: what was hidden against what was found, false alarms on
clean logs, error after over noise floor, time.
"""

from __future__ import annotations

import argparse
import os
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.data import Samples
from coaxlink.residual import Refinement, refine, refine_stand
from coaxlink.rotor import load_rotor_model

# name: (sizes between which the seed draws, pattern, drive, sweeps), in the units of the world's own truth
# files; chosen so that the effect is worth 3 to 10 % of thrust where it is largest
STAND = {
    "battery_voltage": ((0.35, 0.9), "ramps", "throttle", 4),
    "air_density": ((1.0, 1.0), "grid", "rpm", 4),
    "sensor_drift": ((0.25, 0.8), "grid", "rpm", 2),
    "lower_on_upper_interference": ((2.5, 7.0), "grid", "rpm", 1),
    "blade_speed_law": ((0.05, 0.15), "grid", "rpm", 1),
    "hysteresis": ((0.04, 0.12), "ramps", "rpm", 1),
    "rotor_lag": ((0.1, 0.4), "ramps", "throttle", 1),
    "rotor_spacing": ((0.25, 0.6), "grid", "rpm", 4),
    "motor_heating": ((0.06, 0.15), "ramps", "throttle", 4),
    "dead_band": ((0.05, 0.1), "ramps", "throttle", 1),
}
FAULTS = {
    "lying_tachometer": ((0.04, 0.12), "grid", "rpm", 1),
    "swapped_labels": ((1.0, 1.0), "grid", "rpm", 1),
    "stuck_cell": ((1.0, 1.0), "ramps", "rpm", 1),
    "strange": ((2.5, 6.0), "ramps", "rpm", 1),
}
STAND_DOUBLES = (
    ("air_density", "sensor_drift"),
    ("rotor_spacing", "air_density"),
    ("sensor_drift", "lower_on_upper_interference"),
    ("blade_speed_law", "rotor_spacing"),
)
FLIGHT = {
    "battery_voltage": (0.17, 0.55),
    "ground_effect": (0.08, 0.27),
    "rotor_drag": (0.66, 2.2),
    "axial_inflow": (1.5, 5.0),
    "rotor_lag": (0.03, 0.08),
    "rotor_inertia_torque": (8e-4, 3e-3),
    "degraded_rotor": (0.1, 0.4),
    "cg_offset": (0.0054, 0.018),
    "mass_change": (1.6, 3.0),
    "wind": (3.0, 8.0),
}
FLIGHT_DOUBLES = (
    ("rotor_drag", "degraded_rotor"),
    ("cg_offset", "axial_inflow"),
    ("battery_voltage", "ground_effect"),
    ("degraded_rotor", "rotor_lag"),
    ("rotor_drag", "ground_effect"),
)


@dataclass(frozen=True)
class Case:
    """One hidden world."""

    kind: str  # stand, flight
    hidden: tuple[str, ...]
    seed: int


@dataclass(frozen=True)
class Outcome:
    """What came out of one."""

    case: Case
    found: tuple[str, ...]
    suspects: int
    ambiguous: tuple[str, ...]
    unexplained: int
    over_floor: float  # worst channel's error after over its noise floor
    fell: bool  # the error fell on every channel an effect claims
    seconds: float


def cases(arguments: argparse.Namespace) -> Iterator[Case]:
    """Every world asked for."""
    kinds = ("stand", "flight") if arguments.kind == "all" else (arguments.kind,)
    only = set(arguments.only.split(",")) if arguments.only else None
    for kind in kinds:
        single = [(name,) for name in (*(STAND | FAULTS if kind == "stand" else FLIGHT),)]
        doubles = list(STAND_DOUBLES if kind == "stand" else FLIGHT_DOUBLES)
        for hidden in [*single, *doubles]:
            if only is None or "+".join(hidden) in only:
                yield from (Case(kind, tuple(hidden), 1000 + s) for s in range(arguments.seeds))
        if only is None or "clean" in only:
            yield from (Case(kind, (), 5000 + s) for s in range(arguments.clean))


def run(case: Case) -> Outcome:
    """Make the log, refine it, compare."""
    if case.kind == "stand":
        log, paper = Samples(stand_log(case), "blind"), load_rotor_model(files.example("rotor_paper.toml"))
        start = time.perf_counter()
        answer = refine_stand(log, paper)
    else:
        log, paper = Samples(flight_log(case), "blind"), load_rotor_model(files.example("rotor_paper.toml"))
        start = time.perf_counter()
        answer = refine(log, load_airframe(files.example("x8_demo.toml")), paper)
    return _outcome(case, answer, time.perf_counter() - start)


def stand_log(case: Case) -> dict[str, np.ndarray]:
    """A run of the virtual stand with the case's effects."""
    from sim.bench import Bench, BenchEffect, measure
    from sim.rotors import read_pair

    random = np.random.default_rng(case.seed)
    table = STAND | FAULTS
    effects = tuple(
        BenchEffect(name, float(random.uniform(*table[name][0])), 0.0, int(random.integers(4)))
        for name in case.hidden
    )
    effects = tuple(_scaled(e) for e in effects)
    styles = [table[name][1:] for name in case.hidden] or [
        (
            ("grid", "ramps")[case.seed % 2],
            ("rpm", "throttle")[case.seed // 2 % 2],
            1 + 3 * (case.seed // 4 % 2),
        )
    ]
    pattern, drive, sweeps = styles[0]
    sweeps = max(s[2] for s in styles)
    pair = read_pair(files.example("rotor_paper.toml"))
    return measure(pair, Bench(effects, pattern, drive, sweeps), seed=case.seed)


def _scaled(effect: object) -> object:
    """Sizes given in N belong to thrust; a torque channel takes the same share of its own range."""
    from dataclasses import replace

    if effect.name in ("sensor_drift", "strange") and effect.channel in (1, 3):
        return replace(effect, size=effect.size * 0.022)
    return effect


def flight_log(case: Case) -> dict[str, np.ndarray]:
    """A vigorous flight of the stand-in autopilot in the case's world."""
    from sim.flights import fly
    from sim.plant import Plant
    from sim.px4.autopilot import Autopilot
    from sim.rotors import read_pair
    from sim.truth import Effect, Truth
    from sim.vehicle import read_vehicle

    random = np.random.default_rng(case.seed)
    effects = []
    for name in case.hidden:
        size = float(random.uniform(*FLIGHT[name]))
        extra: dict[str, float] = {}
        if name == "degraded_rotor":
            extra["rotor"] = float(random.integers(1, 9))
        if name in ("cg_offset", "wind"):
            extra["direction_deg"] = float(random.uniform(0, 360))
        effects.append(Effect(name, size, 0.0, extra))
    vehicle = read_vehicle(files.example("x8_demo.toml"))
    plant = Plant(vehicle, read_pair(files.example("rotor_paper.toml")))
    pilot = Autopilot(plant, Truth(tuple(effects)), version=(1, 16, 1), seed=case.seed)
    return fly(pilot, "vigorous")


def _outcome(case: Case, answer: Refinement, seconds: float) -> Outcome:
    touched = {c for e in answer.effects for c in e.channels}
    over = [c.rmse_after / c.noise_floor for c in answer.channels.values() if c.noise_floor > 0]
    return Outcome(
        case,
        tuple(sorted(e.name for e in answer.effects)),
        len(answer.suspect_data),
        tuple(n for a in answer.ambiguous for n in a.names),
        len(answer.unexplained),
        max(over),
        all(answer.channels[c].rmse_after < answer.channels[c].rmse_before for c in touched),
        seconds,
    )


def right(o: Outcome) -> bool:
    """Whether the answer is exactly what was hidden."""
    if not o.case.hidden:
        return not (o.found or o.suspects or o.ambiguous)
    if o.case.hidden == ("strange",):
        return not o.found and o.unexplained > 0
    if o.case.hidden[0] in FAULTS:
        return not o.found and o.suspects > 0
    return o.found == tuple(sorted(o.case.hidden)) and not o.ambiguous


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--clean", type=int, default=100)
    parser.add_argument("--only", default="")
    parser.add_argument("--kind", choices=("stand", "flight", "all"), default="all")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    with ProcessPoolExecutor(arguments.jobs) as pool:
        outcomes = []
        for o in pool.map(run, cases(arguments)):
            outcomes.append(o)
            if not right(o):
                print(f"# {o.case.kind} seed {o.case.seed}: {o.case.hidden} -> {_said(o)}", flush=True)
    print(f"{'kind':6s} {'hidden':44s} {'right':>9s}  {'after/floor':>11s} {'fell':>5s} {'s':>5s}  otherwise")
    groups: dict[tuple[str, tuple[str, ...]], list[Outcome]] = {}
    for o in outcomes:
        groups.setdefault((o.case.kind, o.case.hidden), []).append(o)
    for (kind, hidden), mine in groups.items():
        good = sum(map(right, mine))
        other = Counter(_said(o) for o in mine if not right(o))
        floor = float(np.quantile([o.over_floor for o in mine], 0.5))
        shown = "; ".join(f"{n} x {what}" for what, n in other.most_common(4))
        fell = sum(o.fell for o in mine)
        seconds = float(np.median([o.seconds for o in mine]))
        name = " + ".join(hidden) or "clean"
        print(
            f"{kind:6s} {name:44s} {good:4d}/{len(mine):<4d}  {floor:11.2f} {fell:5d} {seconds:5.1f}  {shown}"
        )
    _totals(outcomes)


def _said(o: Outcome) -> str:
    said = "+".join(o.found) or "nothing"
    if o.ambiguous:
        said += " (ambiguous " + "/".join(o.ambiguous) + ")"
    if o.suspects:
        said += f" ({o.suspects} suspect)"
    if o.unexplained:
        said += " (unexplained)"
    return said


def _totals(outcomes: list[Outcome]) -> None:
    for kind in ("stand", "flight"):
        mine = [o for o in outcomes if o.case.kind == kind]
        parts = {
            "singles": [o for o in mine if len(o.case.hidden) == 1 and o.case.hidden[0] not in FAULTS],
            "faults and strange": [o for o in mine if o.case.hidden and o.case.hidden[0] in FAULTS],
            "doubles": [o for o in mine if len(o.case.hidden) == 2],
            "clean": [o for o in mine if not o.case.hidden],
        }
        for name, part in parts.items():
            if part:
                share = 100 * np.mean([right(o) for o in part])
                print(f"{kind} {name}: {share:.1f} % of {len(part)} right")


if __name__ == "__main__":
    main()
