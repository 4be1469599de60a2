"""What `coaxlink health` says of flights whose truth is known: own simulated ones and the independent worlds.

    python research/health.py [--flights N] [--onsets N | --sound N [--flown]] [--seed S]

Own: N vehicles, half of them with one rotor that lost 5 to 20 % of its thrust before the second of two
flights, the other half with another hidden effect or none in both; the verdict over both flights. Onsets: N
single flights of a minute of vehicles drawn around the paper's X8 and a hexa, each judged alone. In six of
nine a rotor loses 5 to 20 % (a blade, or a motor that turns slower), from the start, at a drawn time or over
10 to 30 s; in the others nothing, a load that slides by 2 cm, or half a kilogramme that drops. Sound: N more
such single flights, all rotors sound: in four of six nothing happens, in the others a load slides or drops;
a flight that is called is a false alarm. They are held against the true pair's model; `--flown`: against the
one that `identify` makes of an earlier minute of wandering, from a prior whose loads are each 15 % off.
Worlds: the single logs of ../shared/worlds/flight, each with its own airframe and rotor model, where that
folder is there.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
WORLDS = HERE.parent.parent / "shared" / "worlds" / "flight"
SIZES = {
    "none": 0.0, "battery_voltage": 0.8, "ground_effect": 0.15, "cg_offset": 0.015, "mass_change": 1.0,
    "wind": 6.0, "rotor_drag": 0.15, "axial_inflow": 1.0, "rotor_lag": 0.02,
}  # fmt: skip
COMMAND = (sys.executable, "-m", "coaxlink")


def sim(folder: Path, name: str, seed: int, effects: list[tuple[str, float, int]]) -> Path:
    """One flight of the shipped X8 with these effects (name, size, rotor or 0)."""
    log, truth = folder / f"{name}.csv", folder / f"{name}.toml"
    text = ""
    for what, size, rotor in effects:
        text += f'[[effects]]\nname = "{what}"\nsize = {size}\n' + (f"rotor = {rotor}\n" if rotor else "")
    truth.write_text(text)
    truth_option = ("--truth", truth) if text else ()
    plan = "paper" if seed % 2 else "vigorous"
    call = (*COMMAND, "sim", "--fly", plan, "--log", log, "--seed", seed, *truth_option)
    subprocess.run([str(c) for c in call], check=True, capture_output=True)
    return log


def judged(folder: Path, logs: list[Path], airframe: Path | None = None, rotor: Path | None = None) -> dict:
    """The JSON of `coaxlink health`; an empty one where the log cannot be judged."""
    out = folder / "health.json"
    out.unlink(missing_ok=True)
    options = [*(["--airframe", airframe] if airframe else []), *(["--rotor", rotor] if rotor else [])]
    call = (*COMMAND, "health", *logs, *options, "--json", out)
    done = subprocess.run([str(c) for c in call], capture_output=True, text=True)
    if done.returncode not in (0, 1) or not out.is_file():
        print("   ", logs[-1].name, done.stderr.strip().splitlines()[-1:])
        return {}
    return dict(json.loads(out.read_text()))


def own(count: int, seed: int) -> list[str]:
    """The table of own flights."""
    random = np.random.default_rng(seed)
    airframe = HERE.parent / "examples" / "x8_demo.toml"
    counts: Counter[tuple[str, str]] = Counter()
    right = faulty = inside = 0
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for i in range(count):
            what = list(SIZES)[int(random.integers(len(SIZES)))]
            size = SIZES[what] * float(random.uniform(0.5, 1.0))
            base = [(what, size, 0)] if what != "none" else []
            broken, rotor = i % 2 == 0, int(random.integers(1, 9))
            loss = float(random.uniform(0.05, 0.2))
            fault = [("degraded_rotor", loss, rotor)] if broken else []
            flights = int(random.integers(1_000_000))
            logs = [
                sim(folder, "before", flights, base),
                sim(folder, "after", flights + 1, [*base, *fault]),
            ]
            found = judged(folder, logs, airframe)
            verdict = found.get("verdict", "not judged")
            size_named = "5 to 10 %" if loss < 0.1 else "10 to 20 %"
            counts[f"lost {size_named}" if broken else "sound", verdict] += 1
            if broken and verdict in ("watch", "ground it"):
                faulty += 1
                first = found["suspects"][0]
                right += first["rotor"] == rotor
                inside += first["rotor"] == rotor and first["loss"][1] <= loss <= first["loss"][2]
            print(f"    {i}: {what}, {f'rotor {rotor} {100 * loss:.0f} %' if broken else 'sound'}: {verdict}")
    lines = ["| two flights | sound | watch | ground it |", "|---|---:|---:|---:|"]
    for row in ("sound", "lost 5 to 10 %", "lost 10 to 20 %"):
        cells = [str(counts[row, verdict]) for verdict in ("sound", "watch", "ground it")]
        lines.append(f"| {row} | {' | '.join(cells)} |")
    return [*lines, "", f"of {faulty} called: the right rotor {right}, its loss inside the interval {inside}"]


def worlds() -> list[str]:
    """The table of the independent worlds, single flights."""
    truth = json.loads((WORLDS / "truth.json").read_text())
    counts: Counter[tuple[str, str]] = Counter()
    right = called = 0
    with tempfile.TemporaryDirectory() as scratch:
        for name, t in truth.items():
            found = judged(Path(scratch), [WORLDS / t["log"]], WORLDS / t["airframe"], WORLDS / t["rotor"])
            broken = "degraded_rotor" in t["effects"]
            verdict = found.get("verdict", "not judged")
            counts["a degraded rotor" if broken else "none", verdict] += 1
            if broken:
                rotor = (
                    1 + int(t["parameters"]["degraded_rotor"][0])
                    if "degraded_rotor" in t["parameters"]
                    else 0
                )
                first = found["suspects"][0] if found else {}
                called += verdict in ("watch", "ground it")
                right += bool(found) and first["rotor"] == rotor and verdict != "sound"
            if (verdict != "sound") != broken:
                print(f"    {name}: {t['effects'] or t['kind']} {t['parameters']}: {verdict}")
    lines = ["| single flights | sound | watch | ground it | not judged |", "|---|---:|---:|---:|---:|"]
    for row in ("none", "a degraded rotor"):
        cells = [str(counts[row, v]) for v in ("sound", "watch", "ground it", "not judged")]
        lines.append(f"| {row} | {' | '.join(cells)} |")
    return [*lines, "", f"of {called} called, {right} name the rotor"]


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


def lost_at_speed(pair: Any, pairs: Any, hover: Any, rotor: int, loss: float) -> float:
    """What a motor that turns by sqrt(1 - loss) of its speed loses of its thrust, in hover."""
    slow = hover.copy()
    slow[rotor] *= np.sqrt(1.0 - loss)
    upper, lower = next(p for p in pairs if rotor in p)
    surface = 0 if rotor == upper else 2
    before, after = (pair.loads(u[upper], u[lower])[surface] for u in (hover, slow))
    return float(1.0 - after / before)


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
        effects += [HiddenEffect("degraded_rotor", each, float(t), {"rotor": float(rotor)}, law) for t in times]
    elif kind == OTHERS[1]:
        effects.append(HiddenEffect("cg_offset", 0.02, onset, {"direction_deg": random.uniform(0, 360)}))
    elif kind == OTHERS[2]:
        effects.append(HiddenEffect("mass_change", -0.5, onset))
    plan = PLANS[int(random.integers(3))]
    made = make_design(body, read_pair(rotor_file), table)
    if truth["law"] == "weak_motor":
        hover, pairs = made.hover_command, vehicle.declared.pairs
        truth["loss"] = lost_at_speed(made.pair, pairs, hover, truth["rotor"] - 1, truth["loss"])
    world = FlightWorld(tuple(effects), int(random.integers(1_000_000)), plan, SECONDS - 5.0)

    def columns(world: Any) -> dict:
        flown, log = fly_quick(made, world, EVERY)
        rows = int((flown.seconds + 5.0) * 400 / EVERY) - 5
        return {column: values[:rows] for column, values in log.items()}

    before = FlightWorld((*usual, HiddenEffect("cg_offset", cg, 0.0, askew)), world.seed + 1, "wander", SECONDS - 5.0)
    return name, columns(world), truth, lambda: columns(before)


def identified(path: Path, vehicle: Any, seed: int) -> Any:
    """The model that a flight makes of a prior whose loads are each 15 % too large or too small."""
    from coaxlink.data import read_flight_log
    from coaxlink.health.coefficients import coefficients_from_flights
    from coaxlink.rotor.model import RotorModel

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
    from coaxlink.data import read_flight_log
    from coaxlink.health.columns import reduced
    from coaxlink.health.judge import judge
    from coaxlink.residual.channels.flight import flight_frame
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
            own = next((s for s in h.suspects if s.number == truth["rotor"]), first)
            began = getattr(first, "onset_s", None)
            rows.append(
                truth
                | {
                    "verdict": h.verdict,
                    "named": first.number == truth["rotor"],
                    "share": own.probability,
                    "inside": bool(own.loss.low <= truth["loss"] <= own.loss.high),
                    "found": [round(x, 3) for x in own.loss.as_json()],
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
        "| one flight alone | sound | watch | ground it | of the called: right rotor | loss inside |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for what in (*FAULTS, *OTHERS):
        own_rows = [r for r in rows if r["what"] == what]
        called = [r for r in own_rows if r["verdict"] != "sound"]
        cells = [sum(r["verdict"] == v for r in own_rows) for v in ("sound", "watch", "ground it")]
        right = sum(r["named"] for r in called)
        within = sum(r["named"] and r["inside"] for r in called)
        told = (f"{right} of {len(called)}", f"{within} of {right}") if what in FAULTS else ("", "")
        lines.append(f"| {what} | {' | '.join(str(c) for c in (*cells, *told))} |")
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


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--onsets", type=int, default=0)
    parser.add_argument("--sound", type=int, default=0)
    parser.add_argument("--flown", action="store_true", help="with --sound: against a flown model")
    options = parser.parse_args()
    if options.sound:
        print("\n".join(sound_flights(options.sound, options.seed, options.flown)))
        return 0
    if options.onsets:
        print("\n".join(onset_flights(options.onsets, options.seed)))
        return 0
    if options.flights:
        print("\n".join(own(options.flights, options.seed)))
    if WORLDS.is_dir():
        print("\n".join(worlds()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
