"""How soon a rotor that lost thrust is named in the air, and how often one is that did not.

    python research/health_air.py [--hours 100] [--losses 1000] [--loss 0.1] [--seed S] [--json F]
    python research/health_air.py --stops 200 [--hours 10] [--seed S]

Flights of 60 s in the compiled plant (as `coaxlink campaign` flies): vehicles drawn around the paper's X8
and the example hexa (mass, inertia and arms that the model does not know to 3, 5 and 1 %, centre of mass,
slower motors), wind up to 8 m/s with gusts, sag, rotor drag, inflow in climbs; hovers, circles, wandering,
steps; fitted table and exact law. The test is told what telemetry tells at 50 Hz: commands, rates,
acceleration.
Clean flights: every call is a false alarm. Others: one rotor loses thrust at a drawn time by a drawn law.
Also the curve of both: the same flights at other mean times between false alarms. `--stops`: a rotor's motor
stops or its propeller leaves, the test is that of `coaxlink mix --reallocate`, and what it calls in clean
flights is counted likewise; accelerations alone, no rpm.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
SECONDS, RATE, EVERY = 60.0, 400, 8
PLANS = ("hover", "circle", "wander", "steps")
LAWS = ("share", "tip", "weak_motor")
STOPS = {"motor stopped": "weak_motor", "propeller left": "tip"}
VEHICLES = (
    ("x8_demo.toml", "fitted"),
    ("x8_demo.toml", "exact"),
    ("y6.toml", "fitted"),
    ("y6.toml", "exact"),
)
HOURS = (0.1, 1.0, 10.0, 100.0, 1000.0, 1e4)
CHUNK = 20


@cache
def design(name: str, law: str) -> tuple[Any, Any]:
    """The vehicle as the test knows it, and as it flies but for what is drawn."""
    from coaxlink.mixer.exact.native import NativeExact
    from coaxlink.tables.px4 import report_px4
    from coaxlink.vehicle import load_vehicle
    from sim.physics.rotors import read_pair
    from sim.quick.flight import make_design
    from sim.vehicle import read_vehicle

    rotor = EXAMPLES / "rotor_paper.toml"
    vehicle = load_vehicle(EXAMPLES / name, rotor)
    mixer = NativeExact(vehicle) if law == "exact" else report_px4(vehicle, law).params
    return vehicle, make_design(read_vehicle(EXAMPLES / name), read_pair(rotor), mixer)


def world(seed: int, loss: float, steps: bool) -> tuple[Any, Any, dict[str, Any]]:
    """Vehicle of the test, (design, world) of the flight, and what is true."""
    from sim.effects import HiddenEffect
    from sim.quick.flight import FlightWorld

    random = np.random.default_rng([seed, 0x5A1B])
    name, law = VEHICLES[int(random.integers(len(VEHICLES)))]
    vehicle, made = design(name, law)
    mass, inertia, arm = (1.0 + random.uniform(-s, s) for s in (0.03, 0.05, 0.01))
    body = replace(
        made.vehicle,
        mass_kg=made.vehicle.mass_kg * mass,
        inertia_kg_m2=np.asarray(made.vehicle.inertia_kg_m2) * inertia,
        position_m=made.vehicle.position_m * np.array([arm, arm, 1.0]),
    )
    effects = [
        HiddenEffect("wind", random.uniform(0.0, 8.0), 0.0, {"direction_deg": random.uniform(0, 360)}, "dryden"),
        HiddenEffect("rotor_drag", random.uniform(0.0, 0.15)),
        HiddenEffect("axial_inflow", random.uniform(0.0, 1.0)),
        HiddenEffect("battery_voltage", random.uniform(0.0, 0.8)),
        HiddenEffect("cg_offset", random.uniform(0.0, 0.01), 0.0, {"direction_deg": random.uniform(0, 360)}),
        HiddenEffect("rotor_lag", random.uniform(0.0, 0.01)),
    ]
    plan = PLANS[int(random.integers(len(PLANS) if steps else len(PLANS) - 1))]
    rotor, onset = int(random.integers(made.vehicle.rotors)) + 1, random.uniform(15.0, SECONDS - 10.0)
    kind = LAWS[int(random.integers(len(LAWS)))]
    truth = {"vehicle": name, "law": law, "plan": plan, "rotor": rotor, "onset_s": onset, "kind": kind}
    if loss > 0.0:
        effects.append(HiddenEffect("degraded_rotor", loss, onset, {"rotor": float(rotor)}, kind))
    return vehicle, (replace(made, vehicle=body), FlightWorld(tuple(effects), seed, plan, SECONDS - 5.0)), truth


def watch(vehicle: Any, log: dict[str, Any], hours: tuple[float, ...]) -> dict[float, tuple[float, int]]:
    """(time, rotor) of the first call at each mean time between false alarms."""
    from coaxlink.health.sequential import SequentialTest
    from coaxlink.health.stream import Stream

    stream = Stream(vehicle)
    tests = {h: SequentialTest(vehicle, h) for h in hours}
    commands = np.stack([log[f"motor{i + 1}"] for i in range(stream.count)], axis=1)
    rates = np.stack([log[f"gyro_{a}_rad_s"] for a in "xyz"], axis=1)
    found: dict[float, tuple[float, int]] = {}
    for t, u, w, a in zip(log["time_s"].tolist(), commands, rates, log["accel_z_m_s2"].tolist(), strict=True):
        stream.command(t, u)
        for block in stream.reading(t, w, a):
            for h, test in list(tests.items()):
                verdict = test.step(block)
                if verdict.called:
                    found[h] = verdict.time_s, verdict.called.rotor
                    del tests[h]
    return found


def watch_stops(vehicle: Any, log: dict[str, Any]) -> tuple[float, int] | None:
    """(time, rotor) of the first stop called."""
    from coaxlink.health.stop import BLOCK_S, StopTest
    from coaxlink.health.stream import Stream

    stream, test = Stream(vehicle, BLOCK_S), StopTest(vehicle)
    commands = np.stack([log[f"motor{i + 1}"] for i in range(stream.count)], axis=1)
    rates = np.stack([log[f"gyro_{a}_rad_s"] for a in "xyz"], axis=1)
    for t, u, w, a in zip(log["time_s"].tolist(), commands, rates, log["accel_z_m_s2"].tolist(), strict=True):
        stream.command(t, u)
        for block in stream.reading(t, w, a):
            verdict = test.step(block)
            if verdict.called:
                return verdict.time_s, verdict.called.rotor
    return None


def stops(job: tuple[int, int, str, bool]) -> list[tuple[dict[str, Any], tuple[float, int] | None]]:
    """(truth, call) of flights in which a rotor stops so; none does where the kind is empty."""
    from sim.effects import HiddenEffect
    from sim.quick.flight import fly_quick

    first, count, kind, steps = job
    rows = []
    for seed in range(first, first + count):
        vehicle, (made, true), truth = world(seed, 0.0, steps)
        if kind:
            fault = HiddenEffect(
                "degraded_rotor", 1.0, truth["onset_s"], {"rotor": float(truth["rotor"])}, STOPS[kind]
            )
            true = replace(true, effects=(*true.effects, fault), seconds=truth["onset_s"] - 4.0)
        flown, log = fly_quick(made, true, EVERY)
        truth["seconds"] = flown.seconds + 5.0
        if not kind or truth["seconds"] > truth["onset_s"]:  # not down before
            flight_log = {k: v[: int(truth["seconds"] * RATE / EVERY) - 5] for k, v in log.items()}
            rows.append((truth, watch_stops(vehicle, flight_log)))
    return rows


def _delays(rows: list[Any]) -> str:
    right = [c[0] - t["onset_s"] for t, c in rows if c and c[0] > t["onset_s"] and c[1] == t["rotor"]]
    missed = sum(c is None for _, c in rows)
    q = np.quantile(right, [0.5, 0.9, 1.0]).round(3).tolist() if right else []
    soon, wrong = sum(d <= 0.15 for d in right), len(rows) - len(right) - missed
    return f"{soon} of {len(rows)} in 0.15 s; {q} s; wrong {wrong}, missed {missed}"


def count_stops(o: argparse.Namespace) -> None:
    """Delays by kind, and false stops."""

    def run_all(first: int, count: int, kind: str) -> list[Any]:
        jobs = [(first + k, min(CHUNK, count - k), kind, not o.no_steps) for k in range(0, count, CHUNK)]
        with ProcessPoolExecutor(o.workers) as pool:
            return [row for rows in pool.map(stops, jobs) for row in rows]

    for k, kind in enumerate(STOPS):
        rows = run_all(o.seed + (20 + k) * 1_000_000, o.stops, kind)
        for name in sorted({name for name, _ in VEHICLES}):
            for plan in PLANS:
                part = [r for r in rows if r[0]["vehicle"] == name and r[0]["plan"] == plan]
                print(f"{kind}, {name}, {plan}: {_delays(part)}")
    count = round(o.hours * 3600.0 / SECONDS)
    clean = run_all(o.seed, count, "") if count else []
    flown = sum(truth["seconds"] for truth, _ in clean) / 3600.0
    false = Counter((t["vehicle"], t["plan"]) for t, c in clean if c)
    print(f"{sum(false.values())} false stops in {flown:.1f} h {dict(false)}")


def flights(job: tuple[int, int, float, bool, tuple[float, ...]]) -> list[tuple[dict[str, Any], Any, str]]:
    """(truth, calls, how it ended) of flights first..first+count."""
    from sim.quick.flight import fly_quick

    first, count, loss, steps, hours = job
    rows = []
    for seed in range(first, first + count):
        vehicle, (made, true), truth = world(seed, loss, steps)
        flown, log = fly_quick(made, true, EVERY)
        truth["seconds"] = flown.seconds + 5.0
        flight_log = {k: v[: int((flown.seconds + 5.0) * RATE / EVERY) - 5] for k, v in log.items()}
        rows.append((truth, watch(vehicle, flight_log, hours), flown.failsafe))
    return rows


def run(first: int, count: int, loss: float, steps: bool, hours: tuple[float, ...], cpus: int) -> list[Any]:
    """All flights."""
    jobs = [(first + k, min(CHUNK, count - k), loss, steps, hours) for k in range(0, count, CHUNK)]
    with ProcessPoolExecutor(cpus) as pool:
        return [row for rows in pool.map(flights, jobs) for row in rows]


def losses(rows: list[Any], hours: float) -> dict[str, Any]:
    """Delays of the right rotor, and what else was called."""
    delays, what = [], Counter()
    for truth, calls, _ in rows:
        call = calls.get(hours)
        if call is None:
            what["missed"] += 1
        elif call[0] < truth["onset_s"]:
            what["before"] += 1
        elif call[1] != truth["rotor"]:
            what["wrong rotor"] += 1
        else:
            what["right"] += 1
            delays.append(call[0] - truth["onset_s"])
    n = max(len(rows), 1)
    within = sum(d <= 2.0 for d in delays) / n
    q = np.quantile(delays, [0.5, 0.9, 0.99]).round(2).tolist() if delays else []
    return {"flights": len(rows), "within_2s": within, "delay_s": q, **what}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--hours", type=float, default=100.0)
    parser.add_argument("--losses", type=int, default=1000)
    parser.add_argument("--loss", type=float, default=0.1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--no-steps", action="store_true", help="without the saturating steps")
    parser.add_argument("--curve", action="store_true", help="other mean times between false alarms too")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--stops", type=int, default=0, help="flights in which a rotor stops, of each kind")
    o = parser.parse_args()
    if o.stops:
        count_stops(o)
        return
    hours = HOURS if o.curve else (100.0,)
    began, results = time.monotonic(), {}
    count = round(o.hours * 3600.0 / SECONDS)
    clean = run(o.seed, count, 0.0, not o.no_steps, hours, o.workers) if count else []
    flown = sum(truth["seconds"] for truth, _, _ in clean) / 3600.0
    weak = run(o.seed + 10_000_000, o.losses, o.loss, not o.no_steps, hours, o.workers) if o.losses else []
    for h in hours:
        false = [(truth["vehicle"], truth["law"], truth["plan"]) for truth, calls, _ in clean if h in calls]
        by = losses(weak, h)
        results[str(h)] = {"false": len(false), "hours": flown, **by}
        print(f"one in {h:g} h: {len(false)} false in {flown:.1f} h {dict(Counter(false))}; {by}")
        for plan in PLANS:
            part = [row for row in weak if row[0]["plan"] == plan]
            if part and h == 100.0:
                print("   ", plan, losses(part, h))
    for kind in LAWS:
        print("   ", kind, losses([row for row in weak if row[0]["kind"] == kind], 100.0))
    print(f"crashed {sum(bool(f) for *_, f in clean)}; {time.monotonic() - began:.0f} s")
    if o.json:
        o.json.write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
