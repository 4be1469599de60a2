"""`coaxlink loop` on worlds with known effects: what is named, and the flight's error before and after.

    python benchmarks/loop_truths.py [--only NAME...] [--speed X] [--seed N] [--json F]

Each world is an `examples/truth_*.toml`; the loop sees only flights, the truth file is read here for the
score. The floor of a channel is what a world without effects leaves there, or 1.5 times the noise of the
flight itself. A channel that the effect upsets (before-error beyond twice the floor) shall have at most half
its error after, or be within 1.5 of the floor.
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
CLEAN = "clean"
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


def truth_file(name: str) -> Path:
    """Of a world."""
    return ROOT / "examples" / f"truth_{name}.toml"


def run(name: str, seed: int, speed: float, folder: Path) -> dict[str, Any]:
    """One loop through the verb, as a user types it; its JSON."""
    truth = truth_file(name)
    if name == CLEAN:
        truth = folder / "clean.toml"
        truth.write_text("effects = []\n")
    out = folder / f"{name}.json"
    verb = [sys.executable, "-m", "coaxlink", "loop", "--truth", str(truth), "--seed", str(seed)]
    verb += ["--speed", str(speed), "--out", str(folder / name), "--json", str(out)]
    done = subprocess.run(verb, capture_output=True, text=True, check=False)
    if done.returncode:
        return {"failed": done.stderr.strip().splitlines()[-1:]}
    return json.loads(out.read_text())


def errors(flight: dict[str, Any]) -> list[float]:
    """Thrust in N, roll, pitch, yaw in N m."""
    return [flight["thrust_error_N"], *flight["torque_error_Nm"]]


def judge(name: str, result: dict[str, Any], clean: list[float]) -> list[str]:
    """Per channel: half, floor, MISSED, or blank where the effect does not reach it."""
    verdicts = []
    pairs = zip(errors(result["before"]), errors(result["after"]), clean, strict=True)
    noise = [result["after"]["floor"]["thrust_N"], *result["after"]["floor"]["torque_Nm"]]
    for (before, after, least), own in zip(pairs, noise, strict=True):
        least = max(least, 1.5 * own)
        if before < 2.0 * least:
            verdicts.append("")
        elif after <= 0.5 * before:
            verdicts.append("half")
        elif after <= 1.5 * least:
            verdicts.append("floor")
        else:
            verdicts.append("MISSED" if WORLDS[name] != "nobody" else "stays")
    return verdicts


def main() -> None:
    """Fly all, print the table as it grows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=list(WORLDS))
    parser.add_argument("--speed", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    kept: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        base = run(CLEAN, options.seed, options.speed, folder)
        clean = [min(p) for p in zip(errors(base["before"]), errors(base["after"]), strict=True)]
        print(f"world without effects: {shown(clean)}, found {names(base)}", flush=True)
        units = [f"{axis} {'N' if axis == 'thrust' else 'N m'}" for axis in AXES]
        print(f"{'world':21}{'mixed':6}{'named':32}" + "".join(f"{u:>25}" for u in units) + f"{'s':>6}")
        missed = 0
        for name in options.only:
            result = kept[name] = run(name, options.seed, options.speed, folder)
            if "failed" in result:
                print(f"{name:21}failed: {result['failed']}", flush=True)
                missed += 1
                continue
            true = sorted(e["name"] for e in tomllib.loads(truth_file(name).read_text())["effects"])
            right = sorted(e["name"] for e in result["effects"]) == true
            verdicts = judge(name, result, clean)
            missed += "MISSED" in verdicts
            cells = [
                f"{b:.3g} -> {a:.3g} {v}"
                for b, a, v in zip(errors(result["before"]), errors(result["after"]), verdicts, strict=True)
            ]
            said = names(result) if right else f"{names(result)} (!)"
            row = f"{name:21}{result['way']:6}{said:32}" + "".join(f"{c:>25}" for c in cells)
            print(row + f"{result['seconds']:6.0f}", flush=True)
            for effect, why in result["not_compensated"].items():
                print(f"{'':21}not compensated: {effect}: {why}", flush=True)
    print(f"{len(options.only) - missed} of {len(options.only)} as they should be")
    if options.json:
        options.json.write_text(json.dumps(kept, indent=1))


def names(result: dict[str, Any]) -> str:
    """What was found."""
    return "+".join(e["name"] for e in result["effects"]) or "nothing"


def shown(values: list[float]) -> str:
    """Per axis."""
    return ", ".join(f"{axis} {v:.3g}" for axis, v in zip(AXES, values, strict=True))


if __name__ == "__main__":
    main()
