"""Ten demos with ten hidden effects: what the world hid, what was found, the held-out error before and after.

    python research/demo_seeds.py [SEEDS]

Only this judge reads the truth: it asks the sim for it after the demo is done.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def hidden_by(seed: int) -> str:
    """What the sim hides for this seed, by its own word."""
    from sim.truth import hidden_truth

    return hidden_truth(seed, rotors=8).effects[0].name


def main(count: int) -> int:
    """Run `count` demos; exit 1 if one named the wrong effect or did not get better."""
    bad = 0
    print(f"{'seed':>4}  {'hidden':22} {'found':22} {'before -> after on held-out rows':60} s")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for seed in range(1, count + 1):
            started = time.monotonic()
            result = folder / "demo.json"
            command = [sys.executable, "-m", "coaxlink", "demo", "--seed", str(seed)]
            command += ["--out", str(folder / "demo"), "--json", str(result)]
            run = subprocess.run(command, capture_output=True, text=True)
            if run.returncode:
                bad += 1
                print(
                    f"{seed:4}  exit {run.returncode}: {(run.stderr.strip().splitlines() or [''])[-1]}",
                    flush=True,
                )
                continue
            demo = json.loads(result.read_text())
            hidden, found = hidden_by(seed), str(demo["hidden_effect_found"])
            before, after = demo["before"], demo["after"]
            better = all(after[c] < before[c] for c in before)
            errors = ", ".join(f"{c} {before[c]:.3g} -> {after[c]:.3g}" for c in before)
            bad += found != hidden or not better
            mark = "" if found == hidden and better else "  <-"
            print(
                f"{seed:4}  {hidden:22} {found:22} {errors:60} {time.monotonic() - started:.0f}{mark}",
                flush=True,
            )
    print(f"{count - bad} of {count} right and better")
    return 1 if bad else 0


if __name__ == "__main__":
    raise SystemExit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 10))
