"""`coaxlink loop` on worlds with known effects: what is named, and the flight's error before and after.

    python research/loop_truths.py [--small] [--only NAME ...] [--speed X] [--seed N] [--json F]
    python research/loop_truths.py --demos 10

Each world is an `examples/truth_*.toml`; the loop sees only flights, the truth file is read here for the
score. Two worlds without effects, flown by table and mixed live, give each channel's floor (or 1.5 times the
noise of the flight itself, where that is more). A channel that the effect upsets (before-error beyond twice
the floor) shall have at most half its error after, or be within 1.5 of the floor. With `--json` a run goes on
where an earlier one stopped. `--demos`: so many demos with hidden effects; the sim is asked for the truth
afterwards.
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
    "rotor_inertia": "nobody",
}
Result = dict[str, Any]


def run(name: str, seed: int, speed: float) -> Result:
    """One loop through the verb, as a user types it; its JSON without the long parts."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        truth = ROOT / "examples" / f"truth_{name}.toml"
        if name in CLEAN:
            truth = folder / "clean.toml"
            truth.write_text("effects = []\n")
        out = folder / "loop.json"
        verb = [sys.executable, "-m", "coaxlink", "loop", "--truth", str(truth), "--seed", str(seed)]
        verb += ["--speed", str(speed), "--out", str(folder / "loop"), "--json", str(out)]
        verb += [CLEAN[name]] if name in CLEAN else []
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
    reported = ("+".join(found) or "nothing") + ("" if right else " (!)")
    row = f"{name:21}{result['way']:6}{reported:32}" + "".join(f"{c:>25}" for c in cells)
    print(f"{row}{result['seconds']:6.0f}", flush=True)
    for effect, why in result["not_compensated"].items():
        print(f"{'':21}not compensated: {effect}: {why}", flush=True)
    return right and "MISSED" not in verdicts


def truth_of(name: str) -> list[str]:
    """Names of what is true of a world, sorted."""
    if name in CLEAN:
        return []
    text = (ROOT / "examples" / f"truth_{name}.toml").read_text()
    return sorted(e["name"] for e in tomllib.loads(text)["effects"])


def demo(seed: int) -> bool:
    """Fly one demo and print its row; whether what was hidden is named and the held-out error fell."""
    from sim.truth import hidden_truth

    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "demo.json"
        command = [sys.executable, "-m", "coaxlink", "demo", "--seed", str(seed)]
        command += ["--out", str(Path(folder) / "demo"), "--json", str(result)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            print(f"{seed:4}  exit {done.returncode}: {(done.stderr.strip().splitlines() or [''])[-1]}")
            return False
        answer = json.loads(result.read_text())
    hidden, found = hidden_truth(seed, rotors=8).effects[0].name, str(answer["hidden_effect_found"])
    before, after = answer["before"], answer["after"]
    shown = ", ".join(f"{c} {before[c]:.3g} -> {after[c]:.3g}" for c in before)
    right = found == hidden and all(after[c] < before[c] for c in before)
    print(f"{seed:4}  {hidden:22} {found:22} {shown}{'' if right else '  <-'}", flush=True)
    return right


def main() -> None:
    """Fly all that is not yet flown; print the table as it grows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=[*CLEAN, *WORLDS])
    parser.add_argument("--speed", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--demos", type=int, default=0)
    parser.add_argument("--small", action="store_true", help="one world, for CI")
    options = parser.parse_args()
    if options.demos:
        right = sum(demo(seed) for seed in range(1, options.demos + 1))
        print(f"{right} of {options.demos} right and better")
        assert right == options.demos
        return
    if options.small:
        options.only, options.speed = ["cg_offset"], 10.0
    results: dict[str, Result] = {}
    if options.json and options.json.exists():
        results = json.loads(options.json.read_text())
    units = [f"{axis} {'N' if axis == 'thrust' else 'N m'}" for axis in AXES]
    print(f"{'world':21}{'mixed':6}{'named':32}" + "".join(f"{u:>25}" for u in units) + f"{'s':>6}")
    good = 0
    for name in options.only:
        if name not in results or "failed" in results[name]:
            results[name] = run(name, options.seed, options.speed)
            if options.json:
                options.json.write_text(json.dumps(results, indent=1))
        good += show(name, results)
    reported = "named right, and every channel half or at the floor where it can be"
    print(f"{good} of {len(options.only)} {reported}")
    assert good == len(options.only)


if __name__ == "__main__":
    main()
