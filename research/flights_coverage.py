"""Whether `identify FLIGHT...` knows what it does not know, and whether the flight it plans tells more.

    python research/flights_coverage.py [--vehicles 20] [--seed 0]

Vehicles, winds and priors are those of `flights_convergence.py`. The first flight is `coaxlink fly --plan
identify` on the prior's fitted table, cut at a minute; its log is read with the ESCs' rpm and without, and a
coefficient's, or a load's, 95 % interval holds the true pair's value or not. Then a second minute on the
table of the model so far, twice: the same plan again, and the flight that `identify --next` plans from the
first, on the split that it asks for. What each told is the model's error over a table's wrenches (150, at the
speeds of the table that the model would get): mean |error| in N, and in N m of the worst axis. The ratio's
interval is that of its logarithm's mean over vehicles (Student). Expected over had: the standard deviations
that the plan promised over those that the flight left, all coefficients.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from flights_convergence import EXAMPLES, drawn

MINUTE_S, EVERY = 60.0, 8
NORMAL_95 = 1.96


def goals(plan: Any) -> Callable[[np.ndarray, int], np.ndarray]:
    """A plan of `coaxlink fly` as the quick flights take it: (turns, 11)."""

    def of(times: np.ndarray, seed: int) -> np.ndarray:
        rows = []
        for t in times:
            p = plan.at(max(float(t), 0.0))[1]
            rows.append([*p.position_m, *p.velocity_m_s, *p.acceleration_m_s2, p.yaw_rad, 0.0])
        out = np.array(rows)
        out[:, 10] = np.gradient(out[:, 9], times) if len(times) > 1 else 0.0
        return out

    return of


def told(update: Any, true: Any) -> dict[str, list[tuple[bool, bool]]]:
    """Kind: (inside its interval, told) of every coefficient, and of a pair's loads in hover."""
    terms = true.terms()
    out: dict[str, list[tuple[bool, bool]]] = defaultdict(list)
    for c in update.coefficients:
        inside = abs(c.value - terms[c.load][c.term]) <= NORMAL_95 * c.sd
        out[f"coefficients, {c.load}"].append((inside, c.verdict == "told"))
    at = [np.array([u]) for u in update.hover]
    pair = true.loads(*at)
    for load, (_, before, value, sd) in update.loads.items():
        own = float(getattr(pair, load.replace(".", "_").rsplit("_", 1)[0])[0])
        out[f"in hover, {load}"].append((abs(value - own) <= NORMAL_95 * sd, sd < 0.5 * before))
    return out


def misjudged(airframe: Any, true: Any, model: Any) -> np.ndarray:
    """(2,) N, N m: mean |error| of a model at the speeds that its own table asks for."""
    from coaxlink.mixer.fitted import FittedLaw, envelope
    from coaxlink.vehicle import Vehicle

    law = FittedLaw(Vehicle(airframe, model))
    u = np.array([law.speeds(w) for w in envelope(airframe)])
    own, other = (airframe.wrench(*airframe.loads(m, u)) for m in (true, model))
    off = np.abs(own - other).mean(axis=0)
    return np.array([off[0], off[1:].max()])


def vehicle(seed: int) -> dict[str, Any]:
    """All figures of one drawn vehicle."""
    from coaxlink.airframe import load_airframe
    from coaxlink.data import read_flight_log
    from coaxlink.errors import CoaxlinkError
    from coaxlink.fly.plans import plan_of
    from coaxlink.fly.trajectory import planned_flight
    from coaxlink.health.coefficients import coefficients_from_flights
    from coaxlink.health.next_flight import next_flight
    from coaxlink.mixer.authority import doublet_acceleration
    from coaxlink.mixer.constrained import constrained_table
    from coaxlink.mixer.limits import Limit
    from coaxlink.rotor.model import load_rotor_model
    from coaxlink.tables.px4 import report_px4
    from coaxlink.vehicle import Vehicle
    from sim.physics.rotors import read_pair
    from sim.quick.flight import FlightWorld, fly_quick, make_design
    from sim.quick.plans import PLANS

    name, prior, body, effects = drawn(seed)
    airframe, true = load_airframe(EXAMPLES / name), load_rotor_model(EXAMPLES / "rotor_paper.toml")
    pair = read_pair(EXAMPLES / "rotor_paper.toml")

    def fly(plan: Any, number: int, folder: str, model: Any, limits: Any = None) -> tuple[Any, Any]:
        PLANS["given"] = goals(plan)
        flies = Vehicle(airframe, model)
        fit = constrained_table(flies, limits).table if limits else None
        made = make_design(body, pair, report_px4(flies, "fitted", fit=fit).params)
        flown, log = fly_quick(made, FlightWorld(effects, 1000 * seed + number, "given", MINUTE_S), EVERY)
        rows = int((flown.seconds + 5.0) * 400 / EVERY) - 5
        read = []
        for columns in (log, {k: v for k, v in log.items() if not k.startswith("rpm")}):
            path = Path(folder) / f"{number}_{len(columns)}.csv"
            values = np.stack([v[:rows] for v in columns.values()], axis=1)
            np.savetxt(path, values, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
            read.append(read_flight_log(path))
        return read[0], read[1]

    with tempfile.TemporaryDirectory() as folder:
        usual = plan_of("identify", 4.0, 2.0, doublet_acceleration(Vehicle(airframe, prior)))
        first, blind = fly(usual, 1, folder, prior)
        known = coefficients_from_flights([first], airframe, prior)
        unknown = coefficients_from_flights([blind], airframe, prior)
        planned = next_flight(known, airframe)
        row: dict[str, Any] = {"vehicle": name, "seed": seed, "split": planned.split, "kept": True}
        row["rpm"], row["no rpm"] = told(known, true), told(unknown, true)
        row["first"] = misjudged(airframe, true, known.model)
        again = plan_of("identify", 4.0, 2.0, doublet_acceleration(Vehicle(airframe, known.model)))
        wish = planned.limits()
        limits = [Limit(r["kind"], r["min"], r["max"]) for r in wish["limit"]] if wish else None
        for what, plan in (("again", again), ("planned", planned_flight(planned.document()))):
            try:
                second, _ = fly(plan, 2, folder, known.model, limits if what == "planned" else None)
            except CoaxlinkError as error:  # no table keeps the split: the pilot flies the model's own
                print(f"    {seed} {error}")
                second, row["kept"] = fly(plan, 2, folder, known.model)[0], False
            update = coefficients_from_flights([first, second], airframe, prior)
            row[what] = misjudged(airframe, true, update.model)
            count = len(update.coefficients)
            row[f"{what}, sd"] = planned.table.errors(update.known.covariance[:count, :count])
        had = np.sqrt(np.diag(update.known.covariance)[:count])
        row["expected over had"] = np.array([c.after for c in planned.coefficients]) / had
        row["words"] = list(planned.words())
    return row


def show_coverage(rows: list[dict[str, Any]], kinds: tuple[str, ...]) -> None:
    """A row a kind of coefficient or load: how many intervals hold the truth, how many were told."""
    for kind in kinds:
        print(f"| {kind} | inside | told |\n|---|---:|---:|")
        for name in rows[0][kind]:
            found = np.array([pair for row in rows for pair in row[kind][name]])
            inside, known = found.sum(axis=0)
            print(f"| {name} | {inside} of {len(found)} | {known} |")


def show_plans(rows: list[dict[str, Any]]) -> None:
    """What the second flight told: geometric means, and planned over again with its interval."""
    from scipy.stats import t

    n = len(rows)
    for kind in ("", ", sd"):
        again, planned = (np.array([r[f"{what}{kind}"] for r in rows]) for what in ("again", "planned"))
        logs = np.log(planned / again)
        half = t.ppf(0.975, n - 1) * logs.std(axis=0, ddof=1) / np.sqrt(n)
        middle, low, high = (
            np.exp(x) for x in (logs.mean(axis=0), logs.mean(axis=0) - half, logs.mean(axis=0) + half)
        )
        for k, unit in enumerate(("N", "N m")):
            a, b = np.median(again[:, k]), np.median(planned[:, k])
            what = "expected error (posterior)" if kind else "error"
            print(
                f"{what}, {unit}: again {a:.3f}, planned {b:.3f} (medians); planned over again "
                f"{middle[k]:.2f} ({low[k]:.2f} to {high[k]:.2f}), better in "
                f"{int((planned[:, k] < again[:, k]).sum())} of {n}"
            )
    print("splits asked for:", sum(r["split"] is not None for r in rows), "of", n)
    ratio = np.concatenate([r["expected over had"] for r in rows])
    print("expected over had, quartiles:", np.quantile(ratio, [0.25, 0.5, 0.75]).round(2).tolist())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--vehicles", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    o = parser.parse_args()
    began = time.monotonic()
    rows = []
    for seed in range(o.seed, o.seed + o.vehicles):
        rows.append(vehicle(seed))
        r = rows[-1]
        figures = {
            k: r[k].round(3).tolist() for k in ("first", "again", "planned", "again, sd", "planned, sd")
        }
        inside = {k: sum(i for own in r[k].values() for i, _ in own) for k in ("rpm", "no rpm")}
        what = r["words"][0].split(": ")[1]
        print(
            f"    {seed} {r['vehicle']} {figures} {inside} split {r['split']} {r['kept']}: {what}", flush=True
        )
    show_coverage(rows, ("rpm", "no rpm"))
    if len(rows) > 1:
        show_plans(rows)
    print(f"{time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
