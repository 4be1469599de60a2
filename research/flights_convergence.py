"""From a prior 15 % off to the pair's own table by flights alone: the table's error over minutes of flight.

    python research/flights_convergence.py [--vehicles 20] [--minutes 6] [--splits] [--no-rpm]

Vehicles are drawn around the paper's X8 and the example hexa (inertia, arms and centre of mass that the file
does not know to 5 %, 1 % and 5 mm; wind up to 5 m/s with gusts, sag, slower motors). Each load of the prior
is drawn 15 % too large or too small, apart. A flight is a minute: circle, hover, wandering in turn, on the
fitted table of the model so far (`--keep-table`: on the prior's; `--splits`: with upper over lower column set
on the ground to 0.45, 1 and 0.7 in turn). After each, `identify FLIGHT...` has all flights so far, with the
ESCs' rpm (`--no-rpm`: without). The table's error is what `coaxlink compare` prints for it on the true pair:
mean |delivered - demanded| over the envelope, less that of that pair's own fitted table; torque is the worst
of the three axes. Misjudged is what the model says of the same table's speeds and the true pair does not do:
which table is chosen for a model jumps (its split, a number a rotor or one a level), this does not.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
OFF, MINUTE_S, EVERY = 0.15, 60.0, 8
PLANS = ("wander", "circle", "hover")
TARGET_N, TARGET_NM = 0.5, 0.02
POINTS = 500
SPLITS = (0.7, 0.45, 1.0)  # of `minute`: the second is the first minute's
FIGURES = ("N", "Nm", "misjudged_N", "misjudged_Nm")


def drawn(seed: int) -> tuple[str, Any, Any, tuple[Any, ...]]:
    """Airframe file, prior, body that flies, and effects."""
    from coaxlink.rotor.model import RotorModel, load_rotor_model
    from sim.effects import HiddenEffect
    from sim.vehicle import read_vehicle

    random = np.random.default_rng([seed, 0xC0])
    name = ("x8_demo.toml", "y6.toml")[seed % 2]
    true = load_rotor_model(EXAMPLES / "rotor_paper.toml")
    factors = 1.0 + OFF * random.choice([-1.0, 1.0], 4)
    terms = {
        load: {term: f * c for term, c in own.items()}
        for (load, own), f in zip(true.terms().items(), factors, strict=True)
    }
    prior = RotorModel.from_terms(true.form, true.speed_max_rpm, terms)
    body = read_vehicle(EXAMPLES / name)
    inertia, arm = (1.0 + random.uniform(-s, s) for s in (0.05, 0.01))
    body = replace(
        body,
        inertia_kg_m2=np.asarray(body.inertia_kg_m2) * inertia,
        position_m=body.position_m * np.array([arm, arm, 1.0]),
    )
    effects = (
        HiddenEffect(
            "wind", random.uniform(0.0, 5.0), 0.0, {"direction_deg": random.uniform(0, 360)}, "dryden"
        ),
        HiddenEffect("rotor_drag", random.uniform(0.0, 0.1)),
        HiddenEffect("axial_inflow", random.uniform(0.0, 0.5)),
        HiddenEffect("battery_voltage", random.uniform(0.0, 0.5)),
        HiddenEffect("cg_offset", random.uniform(0.0, 0.005), 0.0, {"direction_deg": random.uniform(0, 360)}),
        HiddenEffect("rotor_lag", random.uniform(0.0, 0.01)),
    )
    return name, prior, body, effects


def errors(airframe: Any, true: Any, model: Any) -> np.ndarray:
    """(4,) N and N m of the fitted table of `model`, flown by the true pair; N and N m misjudged."""
    from coaxlink.mixer.demands import envelope
    from coaxlink.mixer.fitted import FittedLaw
    from coaxlink.vehicle import Vehicle

    law, demands = FittedLaw(Vehicle(airframe, model)), envelope(airframe, POINTS)
    u = np.array([law.speeds(w) for w in demands])
    delivered, modelled = (airframe.wrench(*airframe.loads(m, u)) for m in (true, model))
    off, wrong = np.abs(delivered - demands).mean(axis=0), np.abs(delivered - modelled).mean(axis=0)
    return np.array([off[0], off[1:].max(), wrong[0], wrong[1:].max()])


def vehicle(job: tuple[int, int, bool, bool, bool]) -> list[dict[str, Any]]:
    """A row a minute: the table's error beyond the best, and a pair's loads in hover."""
    from coaxlink.airframe import load_airframe
    from coaxlink.data import read_flight_log
    from coaxlink.mixer.fitted import fit_table
    from coaxlink.rotor.model import load_rotor_model
    from coaxlink.rotor_update.coefficients import coefficients_from_flights
    from coaxlink.tables.px4 import report_px4
    from coaxlink.vehicle import Vehicle
    from sim.physics.rotors import read_pair
    from sim.quick.flight import FlightWorld, fly_quick, make_design

    seed, minutes, rpm, keep, splits = job
    name, prior, body, effects = drawn(seed)
    airframe, true = load_airframe(EXAMPLES / name), load_rotor_model(EXAMPLES / "rotor_paper.toml")
    pair, best = read_pair(EXAMPLES / "rotor_paper.toml"), errors(airframe, true, true)
    best[2:] = 0.0

    def row(minute: int, model: Any, failsafe: str) -> dict[str, Any]:
        figures = dict(zip(FIGURES, (errors(airframe, true, model) - best).tolist(), strict=True))
        return {"vehicle": name, "seed": seed, "minute": minute, **figures, "failsafe": failsafe}

    rows = [row(0, prior, "")]
    model, logs = prior, []
    with tempfile.TemporaryDirectory() as folder:
        for minute in range(1, minutes + 1):
            flies = Vehicle(airframe, prior if keep else model)
            fit = fit_table(flies, shares=(SPLITS[minute % len(SPLITS)],)) if splits else None
            table = report_px4(flies, "fitted", fit=fit).params
            world = FlightWorld(effects, 100 * seed + minute, PLANS[minute % len(PLANS)], MINUTE_S)
            flown, log = fly_quick(make_design(body, pair, table), world, EVERY)
            columns = {k: v for k, v in log.items() if rpm or not k.startswith("rpm")}
            path = Path(folder) / f"{minute}.csv"
            values = np.stack(list(columns.values()), axis=1)[: int((flown.seconds + 5.0) * 50) - 5]
            np.savetxt(path, values, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
            logs.append(read_flight_log(path))
            update = coefficients_from_flights(logs, airframe, prior)
            model = update.model
            rows.append(row(minute, model, flown.failsafe))
    return rows


def show(rows: list[dict[str, Any]], minutes: int) -> list[dict[str, Any]]:
    """Median, 90 % and worst of the vehicles, minute by minute."""
    summary = []
    for minute in range(minutes + 1):
        part = [r for r in rows if r["minute"] == minute]
        values = {name: np.array([r[name] for r in part]) for name in FIGURES}
        met = int(((values["N"] <= TARGET_N) & (values["Nm"] <= TARGET_NM)).sum())
        spread = {name: np.quantile(x, [0.5, 0.9, 1.0]).tolist() for name, x in values.items()}
        summary.append({"minute": minute, "vehicles": len(part), "within": met, **spread})
        digits = [3 if name.endswith("Nm") else 2 for name in FIGURES]
        cells = [
            ", ".join(f"{v:.{d}f}" for v in spread[name]) for name, d in zip(FIGURES, digits, strict=True)
        ]
        print(f"| {minute} | {' | '.join(cells)} | {met} of {len(part)} |", flush=True)
    return summary


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--vehicles", type=int, default=20)
    parser.add_argument("--minutes", type=int, default=6)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--no-rpm", action="store_true", help="logs without the ESCs' rpm")
    parser.add_argument("--keep-table", action="store_true", help="all flights on the prior's table")
    parser.add_argument("--splits", action="store_true", help="another split each flight")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--small", action="store_true", help="two vehicles, a minute")
    o = parser.parse_args()
    o.vehicles, o.minutes = (2, 1) if o.small else (o.vehicles, o.minutes)
    began = time.monotonic()
    jobs = [(o.seed + k, o.minutes, not o.no_rpm, o.keep_table, o.splits) for k in range(o.vehicles)]
    with ProcessPoolExecutor(o.workers) as pool:
        rows = [row for vehicle_rows in pool.map(vehicle, jobs) for row in vehicle_rows]
    print("| minutes | N: median, 90 %, worst | N m | misjudged N | N m | within both |")
    print("|---:|---:|---:|---:|---:|---:|")
    summary = show(rows, o.minutes)
    for name in sorted({r["vehicle"] for r in rows}):
        print(name)
        show([r for r in rows if r["vehicle"] == name], o.minutes)
    print(f"down {sum(bool(r['failsafe']) for r in rows)}; {time.monotonic() - began:.0f} s")
    if o.json:
        o.json.write_text(json.dumps({"summary": summary, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
