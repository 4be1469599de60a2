"""What `coaxlink health` says of flights whose truth is known: own simulated ones and the independent worlds.

    python benchmarks/health.py [--flights N] [--seed S]

Own: N vehicles, half of them with one rotor that lost 5 to 20 % of its thrust before the second of two
flights, the other half with another hidden effect or none in both; the verdict over both flights. Worlds:
the single logs of ../shared/worlds/flight, each with its own airframe and rotor model, where that folder is
there.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

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
    told = ("--truth", truth) if text else ()
    plan = "paper" if seed % 2 else "vigorous"
    call = (*COMMAND, "sim", "--fly", plan, "--log", log, "--seed", seed, *told)
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
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
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
    with tempfile.TemporaryDirectory() as place:
        for name, t in truth.items():
            found = judged(Path(place), [WORLDS / t["log"]], WORLDS / t["airframe"], WORLDS / t["rotor"])
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


def main() -> int:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    if options.flights:
        print("\n".join(own(options.flights, options.seed)))
    if WORLDS.is_dir():
        print("\n".join(worlds()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
