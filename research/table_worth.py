"""What a mixer table is worth in flight: every table through the same flights, on equal seeds.

    python research/table_worth.py [--airframe A] [--seeds 8] [--trials drop "yaw steps"] [--json F]

First the figures by the rotor model alone (`coaxlink compare`), then flights on the PX4 stand-in, which reads
its own table and flies its own cascade; the exact law is what a companion that mixes live without delay would
do. Every table is tuned alike at the airframe's own mass (sim/trial_flight.py). Differences are paired by
seed, with a 95 % interval by Student's t. Two processes; five minutes on two cores with nothing else to do.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from coaxlink.airframe import Airframe, load_airframe
from coaxlink.mixer.exact import ExactLaw
from coaxlink.mixer.worth import law_speeds
from coaxlink.report.worth import remark_on_curve, rows, verdict
from coaxlink.rotor.model import RotorModel, load_rotor_model
from coaxlink.tables.px4 import px4_table
from coaxlink.tables.worth import CURVED, DEFAULTS, LIVE, default_table, px4_worths
from coaxlink.vehicle import Vehicle
from firmware_params import px4
from sim.trial_flight import SCALARS, fly_trial
from sim.trials import TRIALS

EXAMPLES = Path(__file__).parents[1] / "examples"
TABLES = (DEFAULTS, "standard", CURVED, "reduced", "fitted", LIVE)
SHOWN = (
    ("height_max_m", "height max m", ".3f"), ("height_rms_m", "rms m", ".4f"), ("sunk_m", "sunk m", ".3f"),
    ("level_rms_m", "level m", ".3f"), ("tilt_rms_deg", "tilt deg", ".2f"),
    ("yaw_rms_deg", "yaw rms deg", ".2f"), ("yaw_max_deg", "yaw max", ".1f"),
    ("saturated", "saturated", ".3f"), ("shaft_W", "shaft W", ".0f"), ("pack_W", "pack W", ".0f"),
)  # fmt: skip


class LiveMixer:
    """The exact law as the stand-in's mixer: what a companion without delay would do."""

    mix, legacy = True, False  # what the stand-in asks of its mixer before it arms

    def __init__(self, frame: Airframe, model: RotorModel) -> None:
        full = airframe_ceiling(frame, model)
        self._speeds = law_speeds(ExactLaw(Vehicle(frame, model), compiled=True), frame, full)

    def command(self, roll: float, pitch: float, yaw: float, thrust: float) -> NDArray[np.float64]:
        """(N,) motor commands."""
        return self._speeds(roll, pitch, yaw, thrust)


def airframe_ceiling(frame: Airframe, model: RotorModel) -> float:
    """Level thrust with every rotor at full speed, N."""
    return float(frame.wrench(*frame.loads(model, np.ones(len(frame.rotors))))[0])


def mixers(airframe: Path) -> dict[str, Any]:
    """Every table as PX4's parameters, and the live law."""
    frame = load_airframe(airframe)
    assert frame.rotor_model is not None
    model = load_rotor_model(frame.rotor_model)
    made = {law: px4_table(Vehicle(frame, model), law) for law in ("standard", CURVED, "reduced", "fitted")}
    made[DEFAULTS] = default_table(frame)
    tables: dict[str, Any] = {name: px4.table_to_params(table) for name, table in made.items()}
    return tables | {LIVE: LiveMixer(frame, model)}


_MIXERS: dict[Path, dict[str, Any]] = {}  # of this process


def fly(job: tuple[Path, str, str, int]) -> tuple[list[float], list[float]]:
    """One flight: the outcome's scalars and its shape error."""
    airframe, trial, table, seed = job
    if airframe not in _MIXERS:
        _MIXERS[airframe] = mixers(airframe)
    outcome = fly_trial(TRIALS[trial], airframe, _MIXERS[airframe][table], seed)
    return [getattr(outcome, name) for name in SCALARS], outcome.shape.tolist()


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
    o = parser.parse_args()
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
        means = dict(zip(SCALARS, values.mean(axis=0).tolist(), strict=True))
        found[table] = means | {"shape": shape.mean(axis=0).tolist()}
        cells = "".join(f"{means[name]:>13{form}}" for name, _, form in SHOWN)
        print(f"{table:20s}{cells}{shape[:, 0].mean():>9.3f}{shape[:, 3].mean():>14.4f}")
    for other in ("standard", CURVED):
        if other not in by_table or "fitted" not in by_table:
            continue
        pairs = by_table["fitted"] - by_table[other]
        spans = {name: interval(pairs[:, k]) for k, name in enumerate(SCALARS)}
        found[f"fitted - {other}"] = spans
        cells = "".join(f"{spans[name][0]:>+13{form}}" for name, _, form in SHOWN)
        print(f"{'fitted - ' + other[:10]:20s}{cells}")
        halves = "".join(f"{spans[name][1]:>13{form}}" for name, _, form in SHOWN)
        print(f"{'  95 %, +-':20s}{halves}", flush=True)
    return found


if __name__ == "__main__":
    main()
