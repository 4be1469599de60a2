"""What `coaxlink health` says of simulated flights whose truth is known.

    python research/health.py [--small] [--onsets N | --sound N [--flown]] [--seed S]
    python research/health.py --air [--hours 100] [--losses 1000] [--loss 0.1] [--curve] [--json F]

Onsets: N
single flights of a minute of vehicles drawn around the paper's X8 and a hexa, each judged alone. In six of
nine a rotor loses 5 to 20 % (a blade, or a motor that turns slower), from the start, at a drawn time or over
10 to 30 s; in the others nothing, a load that slides by 2 cm, or half a kilogramme that drops. Sound: N more
such single flights, all rotors sound: in four of six nothing happens, in the others a load slides or drops;
a flight that is called is a false alarm. They are held against the true pair's model; `--flown`: against the
one that `identify` makes of an earlier minute of wandering, from a prior whose loads are each 15 % off.
Air: how soon a rotor that lost thrust is named in the air, and how often one is that did not. Flights of 60 s
in the compiled plant: vehicles drawn around the paper's X8 and the example hexa, wind up to 8 m/s with gusts,
sag, rotor drag, inflow in climbs; hovers, circles, wandering, steps; fitted table and exact law. The test is
told what telemetry tells at 50 Hz. Clean flights: every detection is a false alarm. Others: one rotor loses
thrust at a drawn time by a drawn law.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent


FAULTS = ("from the start", "at once, in flight", "gradual, in flight")
OTHERS = ("nothing", "a load slides", "half a kilogramme drops")
SOUND = (*[OTHERS[0]] * 4, *OTHERS[1:])
PLANS, SECONDS, EVERY, LAWS = ("wander", "circle", "hover"), 60.0, 8, ("share", "tip", "weak_motor")


@cache
def vehicle_and_table(name: str) -> tuple[Any, dict[str, float]]:
    """A drawn vehicle's file as the verb knows it, and what its autopilot flies with."""
    from coaxlink.tables.px4 import report_px4
    from coaxlink.vehicle import load_vehicle

    examples = HERE.parent / "examples"
    vehicle = load_vehicle(examples / name, examples / "rotor_paper.toml")
    return vehicle, dict(report_px4(vehicle, "fitted").params)


def lost_at_speed(pair: Any, pairs: Any, hover: Any, rotor: int, loss: float) -> dict[int, float]:
    """What a motor that turns by sqrt(1 - loss) of its speed takes of the thrusts of its pair, in hover."""
    slow = hover.copy()
    slow[rotor] *= np.sqrt(1.0 - loss)
    upper, lower = next(p for p in pairs if rotor in p)
    before, after = (pair.loads(u[upper], u[lower]) for u in (hover, slow))
    return {k: float(1.0 - after[s] / before[s]) for k, s in ((upper, 0), (lower, 2))}


def onset_flight(seed: int, i: int, kinds: tuple[str, ...]) -> tuple[str, dict, dict, Callable[[], dict]]:
    """(airframe file, columns, truth, a sound flight before it); what happens is the i-th of `kinds`."""
    from sim.effects import HiddenEffect
    from sim.physics.rotors import read_pair
    from sim.quick.flight import FlightWorld, fly_quick, make_design
    from sim.vehicle import read_vehicle

    random = np.random.default_rng([seed, i, 0x05E7])
    name = ("x8_demo.toml", "y6.toml")[int(random.integers(2))]
    rotor_file = HERE.parent / "examples" / "rotor_paper.toml"
    vehicle, table = vehicle_and_table(name)
    body = read_vehicle(HERE.parent / "examples" / name)
    mass, inertia, arm = (1.0 + random.uniform(-s, s) for s in (0.01, 0.03, 0.01))
    body = replace(
        body,
        mass_kg=body.mass_kg * mass,
        inertia_kg_m2=np.asarray(body.inertia_kg_m2) * inertia,
        position_m=body.position_m * np.array([arm, arm, 1.0]),
    )
    wind = {"direction_deg": random.uniform(0, 360)}
    effects = [
        HiddenEffect("wind", random.uniform(0.0, 6.0), 0.0, wind, "dryden"),
        HiddenEffect("rotor_drag", random.uniform(0.0, 0.1)),
        HiddenEffect("axial_inflow", random.uniform(0.0, 0.5)),
        HiddenEffect("battery_voltage", random.uniform(0.0, 0.5)),
        HiddenEffect("rotor_lag", random.uniform(0.0, 0.01)),
    ]
    askew = {"direction_deg": random.uniform(0, 360)}
    cg, onset = random.uniform(0.0, 0.005), random.uniform(15.0, 45.0)
    kind = kinds[i % len(kinds)]
    usual = tuple(effects)
    truth: dict[str, Any] = {"what": kind, "rotor": 0, "loss": 0.0, "law": "", "onset_s": onset}
    effects.append(HiddenEffect("cg_offset", cg, 0.0, askew))
    if kind in FAULTS:
        rotor, loss = int(random.integers(body.rotors)) + 1, random.uniform(0.05, 0.2)
        law, over = LAWS[int(random.integers(3))], random.uniform(10.0, 30.0)
        onset = {FAULTS[0]: 0.0, FAULTS[1]: onset, FAULTS[2]: min(onset, 55.0 - over)}[kind]
        truth |= {"rotor": rotor, "loss": loss, "law": law, "onset_s": onset}
        parts = 20 if kind == FAULTS[2] else 1
        each = 1.0 - (1.0 - loss) ** (1.0 / parts)
        times = onset + over * (np.arange(parts) + 0.5) / parts if parts > 1 else [onset]
        effects += [
            HiddenEffect("degraded_rotor", each, float(t), {"rotor": float(rotor)}, law) for t in times
        ]
    elif kind == OTHERS[1]:
        effects.append(HiddenEffect("cg_offset", 0.02, onset, {"direction_deg": random.uniform(0, 360)}))
    elif kind == OTHERS[2]:
        effects.append(HiddenEffect("mass_change", -0.5, onset))
    plan = PLANS[int(random.integers(3))]
    made = make_design(body, read_pair(rotor_file), table)
    if truth["law"] == "weak_motor":
        hover, pairs = made.hover_command, vehicle.declared.pairs
        gone = lost_at_speed(made.pair, pairs, hover, truth["rotor"] - 1, truth["loss"])
        truth |= {"loss": gone[truth["rotor"] - 1], "gone": {k + 1: x for k, x in gone.items()}}
    world = FlightWorld(tuple(effects), int(random.integers(1_000_000)), plan, SECONDS - 5.0)

    def columns(world: Any) -> dict:
        flown, log = fly_quick(made, world, EVERY)
        rows = int((flown.seconds + 5.0) * 400 / EVERY) - 5
        return {column: values[:rows] for column, values in log.items()}

    before = FlightWorld(
        (*usual, HiddenEffect("cg_offset", cg, 0.0, askew)), world.seed + 1, "wander", SECONDS - 5.0
    )
    return name, columns(world), truth, lambda: columns(before)


def identified(path: Path, vehicle: Any, seed: int) -> Any:
    """The model that a flight makes of a prior whose loads are each 15 % too large or too small."""
    from coaxlink.data import read_flight_log
    from coaxlink.rotor.model import RotorModel
    from coaxlink.rotor_update.coefficients import coefficients_from_flights

    true = vehicle.rotors
    factors = 1.0 + 0.15 * np.random.default_rng([seed, 0x0FF]).choice([-1.0, 1.0], 4)
    terms = {
        load: {term: f * c for term, c in own.items()}
        for (load, own), f in zip(true.terms().items(), factors, strict=True)
    }
    prior = RotorModel.from_terms(true.form, true.speed_max_rpm, terms)
    return coefficients_from_flights([read_flight_log(path)], vehicle.declared, prior).model


def judged_alone(count: int, seed: int, kinds: tuple[str, ...], flown: bool = False) -> list[dict[str, Any]]:
    """Single flights, what happens in them in turn: the truth and what was said, a row a flight.

    `flown`: held against a model that an earlier flight made.
    """
    from coaxlink.channels.flight import flight_frame
    from coaxlink.data import read_flight_log
    from coaxlink.health.columns import reduced
    from coaxlink.health.judge import judge
    from sim.flights import write_flight

    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for i in range(count):
            name, log, truth, before = onset_flight(seed, i, kinds)
            path, first_path = Path(folder) / "flight.csv", Path(folder) / "before.csv"
            write_flight(path, log)
            vehicle = vehicle_and_table(name)[0]
            body, model = vehicle.declared, vehicle.rotors
            if flown:
                write_flight(first_path, before())
                model = identified(first_path, vehicle, 1000 * seed + i)
            flight = reduced(flight_frame([read_flight_log(path)], body, model))
            h = judge([flight], ["flight"], [r.number for r in body.rotors], body.pairs)
            first = h.suspects[0]
            own = next((s for s in h.suspects if s.rotor == truth["rotor"]), first)
            began = getattr(first, "onset_s", None)
            others = [r.number for r in body.rotors if r.number != truth["rotor"]]
            shown = {r.rotor: r.thrust for r in h.flights[-1].rotors}
            gone = truth.get("gone") or {truth["rotor"]: truth["loss"]}
            true = {n: 1.0 - gone.get(n, 0.0) for n in shown}
            held = {n: bool(shown[n].low <= true[n] <= shown[n].high) for n in shown}
            rows.append(
                truth
                | {
                    "verdict": h.verdict,
                    "named": first.rotor == truth["rotor"],
                    "share": own.probability,
                    "inside": bool(own.loss.low <= truth["loss"] <= own.loss.high),
                    "shown": [round(x, 3) for x in shown.get(truth["rotor"], ())],
                    "held": held.get(truth["rotor"], True),
                    "others": [sum(held[n] for n in others), len(others)],
                    "found": [round(x, 3) for x in own.loss],
                    "kind": getattr(own, "kind", ""),
                    "late_s": began.value - truth["onset_s"] if began else None,
                }
            )
            print(f"    {i}: {name} {rows[-1]}", flush=True)
    return rows


def onset_flights(count: int, seed: int) -> list[str]:
    """The table of single flights, a row a kind."""
    rows = judged_alone(count, seed, (*FAULTS, *FAULTS, *OTHERS))
    lines = [
        "| one flight alone | sound | watch | ground it | of the called: right rotor | loss inside | "
        "of all: the weak rotor's share in the table's interval | the others' |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for what in (*FAULTS, *OTHERS):
        own_rows = [r for r in rows if r["what"] == what]
        called = [r for r in own_rows if r["verdict"] != "sound"]
        cells = [sum(r["verdict"] == v for r in own_rows) for v in ("sound", "watch", "ground it")]
        right = sum(r["named"] for r in called)
        within = sum(r["named"] and r["inside"] for r in called)
        held = sum(r["held"] for r in own_rows)
        fault = (f"{right} of {len(called)}", f"{within} of {right}", f"{held} of {len(own_rows)}")
        others = " of ".join(str(sum(r["others"][k] for r in own_rows)) for k in (0, 1))
        cells = [*cells, *(fault if what in FAULTS else ("", "", "")), others]
        lines.append(f"| {what} | {' | '.join(map(str, cells))} |")
    return lines


def sound_flights(count: int, seed: int, flown: bool) -> list[str]:
    """The table of false alarms: sound rotors that are called, with Clopper and Pearson's 95 %."""
    from scipy.stats import beta

    rows = judged_alone(count, seed, SOUND, flown)
    lines = ["| sound rotors | sound | watch | ground it | called, 95 % |", "|---|---:|---:|---:|---:|"]
    for what in OTHERS:
        verdicts = [r["verdict"] for r in rows if r["what"] == what]
        n, cells = len(verdicts), [verdicts.count(v) for v in ("sound", "watch", "ground it")]
        called = n - cells[0]
        low = float(beta.ppf(0.025, called, n - called + 1)) if called else 0.0
        high = float(beta.ppf(0.975, called + 1, n - called)) if called < n else 1.0
        share = f"{100 * called / max(n, 1):.0f} % ({100 * low:.1f} to {100 * high:.0f})"
        lines.append(f"| {n} {what} | {' | '.join(map(str, cells))} | {share} |")
    return lines


# in the air

RATE = 400
AIR_PLANS = ("hover", "circle", "wander", "steps")
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

    rotor = HERE.parent / "examples" / "rotor_paper.toml"
    vehicle = load_vehicle(HERE.parent / "examples" / name, rotor)
    mixer = NativeExact(vehicle) if law == "exact" else report_px4(vehicle, law).params
    return vehicle, make_design(read_vehicle(HERE.parent / "examples" / name), read_pair(rotor), mixer)


def air_world(seed: int, loss: float, steps: bool) -> tuple[Any, Any, dict[str, Any]]:
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
        HiddenEffect(
            "wind", random.uniform(0.0, 8.0), 0.0, {"direction_deg": random.uniform(0, 360)}, "dryden"
        ),
        HiddenEffect("rotor_drag", random.uniform(0.0, 0.15)),
        HiddenEffect("axial_inflow", random.uniform(0.0, 1.0)),
        HiddenEffect("battery_voltage", random.uniform(0.0, 0.8)),
        HiddenEffect("cg_offset", random.uniform(0.0, 0.01), 0.0, {"direction_deg": random.uniform(0, 360)}),
        HiddenEffect("rotor_lag", random.uniform(0.0, 0.01)),
    ]
    plan = AIR_PLANS[int(random.integers(len(AIR_PLANS) if steps else len(AIR_PLANS) - 1))]
    rotor, onset = int(random.integers(made.vehicle.rotors)) + 1, random.uniform(15.0, SECONDS - 10.0)
    kind = LAWS[int(random.integers(len(LAWS)))]
    truth = {"vehicle": name, "law": law, "plan": plan, "rotor": rotor, "onset_s": onset, "kind": kind}
    if loss > 0.0:
        effects.append(HiddenEffect("degraded_rotor", loss, onset, {"rotor": float(rotor)}, kind))
    return (
        vehicle,
        (replace(made, vehicle=body), FlightWorld(tuple(effects), seed, plan, SECONDS - 5.0)),
        truth,
    )


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


def flights(job: tuple[int, int, float, bool, tuple[float, ...]]) -> list[tuple[dict[str, Any], Any, str]]:
    """(truth, calls, how it ended) of flights first..first+count."""
    from sim.quick.flight import fly_quick

    first, count, loss, steps, hours = job
    rows = []
    for seed in range(first, first + count):
        vehicle, (made, true), truth = air_world(seed, loss, steps)
        flown, log = fly_quick(made, true, EVERY)
        truth["seconds"] = flown.seconds + 5.0
        flight_log = {k: v[: int((flown.seconds + 5.0) * RATE / EVERY) - 5] for k, v in log.items()}
        rows.append((truth, watch(vehicle, flight_log, hours), flown.failsafe))
    return rows


def air_flights(
    first: int, count: int, loss: float, steps: bool, hours: tuple[float, ...], cpus: int
) -> list[Any]:
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


def in_the_air(o: argparse.Namespace) -> None:
    """False alarms an hour and delays, at every mean time between false alarms."""
    hours = HOURS if o.curve else (100.0,)
    results = {}
    count = round(o.hours * 3600.0 / SECONDS)
    clean = air_flights(o.seed, count, 0.0, not o.no_steps, hours, o.workers) if count else []
    flown = sum(truth["seconds"] for truth, _, _ in clean) / 3600.0
    weak = []
    if o.losses:
        weak = air_flights(o.seed + 10_000_000, o.losses, o.loss, not o.no_steps, hours, o.workers)
    for h in hours:
        false = [(truth["vehicle"], truth["law"], truth["plan"]) for truth, calls, _ in clean if h in calls]
        by = losses(weak, h)
        results[str(h)] = {"false": len(false), "hours": flown, **by}
        print(f"one in {h:g} h: {len(false)} false in {flown:.1f} h {dict(Counter(false))}; {by}")
    for plan in AIR_PLANS:
        print("   ", plan, losses([row for row in weak if row[0]["plan"] == plan], 100.0))
    for kind in LAWS:
        print("   ", kind, losses([row for row in weak if row[0]["kind"] == kind], 100.0))
    print(f"crashed {sum(bool(f) for *_, f in clean)}")
    if o.json:
        o.json.write_text(json.dumps(results, indent=1))
    if o.small:
        assert results["100.0"]["false"] == 0 and results["100.0"]["flights"] == o.losses


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--small", action="store_true", help="a few flights in the air, for CI")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--onsets", type=int, default=20)
    parser.add_argument("--sound", type=int, default=0)
    parser.add_argument("--flown", action="store_true", help="with --sound: against a flown model")
    parser.add_argument("--air", action="store_true")
    parser.add_argument("--hours", type=float, default=100.0)
    parser.add_argument("--losses", type=int, default=1000)
    parser.add_argument("--loss", type=float, default=0.1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--no-steps", action="store_true", help="without the saturating steps")
    parser.add_argument("--curve", action="store_true", help="other mean times between false alarms too")
    parser.add_argument("--json", type=Path)
    o = parser.parse_args()
    if o.small:
        o.hours, o.losses, o.workers = 2 / 60, 2, 1
    if o.air or o.small:
        in_the_air(o)
    elif o.sound:
        print("\n".join(sound_flights(o.sound, o.seed, o.flown)))
    else:
        print("\n".join(onset_flights(o.onsets, o.seed)))


if __name__ == "__main__":
    main()
