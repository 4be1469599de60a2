"""Spoiled files through every reader and every verb's command line: done, or refused in one line.

    python research/fuzz.py [--files 5000] [--seed 0] [--what readers|verbs] [--only NAME] [--small]
        [--seconds S]

No traceback, no death of the process, at most 1 GB and 30 s of CPU: each runs in a child that has no more.
Deterministic: file N of a kind is the same file always. A quarter of the verbs' lines have a sound file and
odd options. What spoils and what reads stands in tests/hostile, where a few of each run with the tests.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import sys
import tempfile
import time
from collections import Counter
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "hostile"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from bounded_readers import Outcome, run  # type: ignore[import-not-found]
from bounded_verbs import verbs  # type: ignore[import-not-found]
from sound_files import MAKERS, sound_files  # type: ignore[import-not-found]

BAD = ("traceback", "hang", "memory", "killed")


def main() -> None:
    """Run, print the table and what failed; exit code 1 if anything did."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--files", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=math.inf, help="count what was run until then")
    parser.add_argument("--what", choices=("readers", "verbs"), help="by default both, verbs thrice as often")
    parser.add_argument("--only", default="", metavar="NAME", help="only those whose name begins so")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--small", action="store_true", help="fifty files")
    o = parser.parse_args()
    o.files = 50 if o.small else o.files
    outcomes: list[Outcome] = []
    end = time.monotonic() + o.seconds
    with tempfile.TemporaryDirectory() as scratch:
        cases = drawn(list(verbs(sound_files(Path(scratch)))), o)
        for outcome in run(cases, Path(scratch)):
            outcomes.append(outcome)
            if outcome.result in BAD:
                print(f"{outcome.result}: {outcome.kind} {outcome.number}: {outcome.text}", flush=True)
            if time.monotonic() > end:
                break
    print(table(outcomes))
    if o.json:
        o.json.write_text(json.dumps([asdict(outcome) for outcome in outcomes]))
    sys.exit(any(outcome.result in BAD for outcome in outcomes))


def drawn(of_verbs: list[str], o: argparse.Namespace) -> list[tuple[str, int]]:
    """(name, number) of each file: in turn a reader's, two of verbs, one with odd options."""
    odd = [name for name in of_verbs if name.endswith("odd")]
    decks = {"readers": [list(MAKERS)], "verbs": [[n for n in of_verbs if n not in odd]] * 2 + [odd]}
    chosen = [
        [name for name in deck if name.startswith(o.only)]
        for what, each in decks.items()
        if o.what in (what, None)
        for deck in each
    ]
    dice, counts, cases = random.Random(o.seed), Counter[str](), []
    chosen = [deck for deck in chosen if deck]
    for n in range(o.files):
        name = dice.choice(chosen[n % len(chosen)])
        cases.append((name, o.seed * 1_000_000 + counts[name]))
        counts[name] += 1
    return cases


def table(outcomes: list[Outcome]) -> str:
    """A row a reader."""
    heads = ("files", "ok", "refused", *BAD)
    lines = [
        f"{'reader or verb':<40}" + "".join(f"{h:>10}" for h in heads) + f"{'most CPU s':>11}{'peak MB':>9}"
    ]
    for kind in [*dict.fromkeys(o.kind for o in outcomes), "all"]:
        rows = [o for o in outcomes if kind in (o.kind, "all")]
        counts = Counter(o.result for o in rows)
        numbers = [len(rows), *(counts[h] for h in heads[1:])]
        slowest, peak = max(o.seconds for o in rows), max(o.peak_MB for o in rows)
        lines.append(f"{kind:<40}" + "".join(f"{n:>10}" for n in numbers) + f"{slowest:>11.2f}{peak:>9.0f}")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
