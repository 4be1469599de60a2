"""`coaxlink loop` on worlds with known effects: what is named, and the flight's error before and after.

    python research/loop_truths.py [--only NAME ...] [--speed X] [--seed N] [--json F] [--markdown]

Each world is an `examples/truth_*.toml`; the loop sees only flights, the truth file is read here for the
score. Two worlds without effects, flown by table and mixed live, give each channel's floor (or 1.5 times the
noise of the flight itself, where that is more). A channel that the effect upsets (before-error beyond twice
the floor) shall have at most half its error after, or be within 1.5 of the floor. With `--json` a run goes on
where an earlier one stopped; `--markdown` prints the rows of docs/loop.md, with intervals, of the channels
that an effect upsets.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
CLEAN = {"clean": "--table", "clean_live": "--live"}
LED = {"slow_motors_led": "slow_motors"}  # the world of another name, with --lead
AXES = ("thrust", "roll", "pitch", "yaw")
# who can take it back: a table, live mixing, nobody
WORLDS = {
    "battery": "table",
    "battery_strong": "table",
    "weak_rotor": "table",
    "weak_lower_rotor": "table",
    "cg_offset": "table",
    "payload": "table",
    "weak_rotor_cg_offset": "table",
    "battery_weak_rotor": "table",
    "ground_effect": "live",
    "axial_inflow": "live",
    "drag": "nobody",
    "wind": "nobody",
    "slow_motors": "nobody",
    "slow_motors_led": "live",
    "rotor_inertia": "nobody",
}
Result = dict[str, Any]


def run(name: str, seed: int, speed: float) -> Result:
    """One loop through the verb, as a user types it; its JSON without the long parts."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        truth = ROOT / "examples" / f"truth_{LED.get(name, name)}.toml"
        if name in CLEAN:
            truth = folder / "clean.toml"
            truth.write_text("effects = []\n")
        out = folder / "loop.json"
        verb = [sys.executable, "-m", "coaxlink", "loop", "--truth", str(truth), "--seed", str(seed)]
        verb += ["--speed", str(speed), "--out", str(folder / "loop"), "--json", str(out)]
        verb += [CLEAN[name]] if name in CLEAN else ["--lead"] if name in LED else []
        done = subprocess.run(verb, capture_output=True, text=True, check=False)
        if done.returncode:
            return {"failed": (done.stderr.strip().splitlines() or [f"exit {done.returncode}"])[-1]}
        result: Result = json.loads(out.read_text())
    del result["refine"]
    return result


def errors(flight: Result) -> list[float]:
    """Thrust in N, roll, pitch, yaw in N m."""
    return [flight["thrust_error_N"], *flight["torque_error_Nm"]]


def floor_of(results: dict[str, Result], way: str) -> list[float]:
    """What the world without effects leaves per channel, mixed this way; zeros where it was not flown."""
    clean = results.get("clean_live" if way == "live" else "clean")
    if clean is None or "failed" in clean:
        return [0.0] * 4
    return [min(p) for p in zip(errors(clean["before"]), errors(clean["after"]), strict=True)]


def judge(name: str, result: Result, clean: list[float]) -> list[str]:
    """Per channel: half, floor, MISSED, or blank where the effect does not reach it."""
    verdicts = []
    noise = [result["after"]["floor"]["thrust_N"], *result["after"]["floor"]["torque_Nm"]]
    rows = zip(errors(result["before"]), errors(result["after"]), clean, noise, strict=True)
    for before, after, least, own in rows:
        floor = max(least, 1.5 * own)
        if before < 2.0 * floor:
            verdicts.append("")
        elif after <= 0.5 * before:
            verdicts.append("half")
        elif after <= 1.5 * floor:
            verdicts.append("floor")
        else:
            verdicts.append("MISSED" if WORLDS[name] != "nobody" else "stays")
    return verdicts


def show(name: str, results: dict[str, Result]) -> bool:
    """Print a world's row; whether it is as it should be."""
    result = results[name]
    if "failed" in result:
        print(f"{name:21}failed: {result['failed']}", flush=True)
        return False
    found = sorted(e["name"] for e in result["effects"])
    verdicts = [""] * 4 if name in CLEAN else judge(name, result, floor_of(results, result["way"]))
    cells = [
        f"{b:.3g} -> {a:.3g} {v:6}"
        for b, a, v in zip(errors(result["before"]), errors(result["after"]), verdicts, strict=True)
    ]
    right = found == truth_of(name)
    said = ("+".join(found) or "nothing") + ("" if right else " (!)")
    row = f"{name:21}{result['way']:6}{said:32}" + "".join(f"{c:>25}" for c in cells)
    print(f"{row}{result['seconds']:6.0f}", flush=True)
    for effect, why in result["not_compensated"].items():
        print(f"{'':21}not compensated: {effect}: {why}", flush=True)
    return right and "MISSED" not in verdicts


def intervals(flight: Result) -> list[list[float]]:
    """95 % of each channel's mean error."""
    return [flight["thrust_ci_N"], *flight["torque_ci_Nm"]]


def row(name: str, seed: int, results: dict[str, Result]) -> str:
    """A row of docs/loop.md."""
    result = results[name]
    if "failed" in result:
        return f"| {name} | {seed} | failed | {result['failed']} | | |"
    plain = name in CLEAN
    verdicts = ["floor", "floor", "", "floor"]  # torques are much alike where nothing is the matter
    if not plain:
        verdicts = judge(name, result, floor_of(results, result["way"]))
    cells = []
    for k, axis in enumerate(AXES):
        if not verdicts[k]:
            continue
        b, a = errors(result["before"])[k], errors(result["after"])[k]
        (b0, b1), (a0, a1) = intervals(result["before"])[k], intervals(result["after"])[k]
        unit = "N" if k == 0 else "N m"
        cells.append(f"{axis} {b:.3g} ({b0:.3g} to {b1:.3g}) -> {a:.3g} ({a0:.3g} to {a1:.3g}) {unit}")
    found = " + ".join(sorted(e["name"] for e in result["effects"])) or "nothing"
    said = {"half", "floor"} >= set(filter(None, verdicts)) or "MISSED" not in verdicts
    word = "" if plain else "stays" if "stays" in verdicts else "yes" if said else "MISSED"
    return f"| {name} | {seed} | {result['way']} | {found} | {'; '.join(cells)} | {word} |"


def truth_of(name: str) -> list[str]:
    """Names of what is true of a world, sorted."""
    if name in CLEAN:
        return []
    text = (ROOT / "examples" / f"truth_{LED.get(name, name)}.toml").read_text()
    return sorted(e["name"] for e in tomllib.loads(text)["effects"])


def main() -> None:
    """Fly all that is not yet flown; print the table as it grows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=[*CLEAN, *WORLDS])
    parser.add_argument("--speed", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--markdown", action="store_true")
    options = parser.parse_args()
    results: dict[str, Result] = {}
    if options.json and options.json.exists():
        results = json.loads(options.json.read_text())
    if options.markdown:
        for name in [n for n in options.only if n in results]:
            print(row(name, options.seed, results))
        return
    units = [f"{axis} {'N' if axis == 'thrust' else 'N m'}" for axis in AXES]
    print(f"{'world':21}{'mixed':6}{'named':32}" + "".join(f"{u:>25}" for u in units) + f"{'s':>6}")
    good = 0
    for name in options.only:
        if name not in results or "failed" in results[name]:
            results[name] = run(name, options.seed, options.speed)
            if options.json:
                options.json.write_text(json.dumps(results, indent=1))
        good += show(name, results)
    print(
        f"{good} of {len(options.only)} named right, and every channel half or at the floor where it can be"
    )


if __name__ == "__main__":
    main()
