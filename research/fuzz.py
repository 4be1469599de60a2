"""Spoiled files of every kind through every reader: read or refused in one line, no traceback, hang or GB.

    python research/fuzz.py [--files 5000] [--seed 0] [--only KIND] [--json OUT.json]

Deterministic: file N of a kind is the same file always. Each runs in a child with 1 GB and 20 s of CPU. What
spoils and what reads stands in tests/hostile, where a few files of each kind run with the tests.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "hostile"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from bounded_readers import Outcome, run  # type: ignore[import-not-found]
from sound_files import MAKERS, sound_files  # type: ignore[import-not-found]

BAD = ("traceback", "hang", "memory", "killed")


def main() -> None:
    """Run, print the table and what failed; exit code 1 if anything did."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--files", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", choices=["", *MAKERS], metavar="KIND")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--small", action="store_true", help="two hundred files")
    o = parser.parse_args()
    o.files = 200 if o.small else o.files
    kinds = [o.only] if o.only else list(MAKERS)
    cases = [(kinds[n % len(kinds)], o.seed * 1_000_000 + n // len(kinds)) for n in range(o.files)]
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory() as scratch:
        sound_files(Path(scratch))
        for outcome in run(sorted(cases), Path(scratch)):
            outcomes.append(outcome)
            if outcome.result in BAD:
                print(f"{outcome.result}: {outcome.kind} {outcome.number}: {outcome.text}", flush=True)
    print(table(outcomes))
    if o.json:
        o.json.write_text(json.dumps([asdict(outcome) for outcome in outcomes]))
    sys.exit(any(outcome.result in BAD for outcome in outcomes))


def table(outcomes: list[Outcome]) -> str:
    """A row a reader."""
    heads = ("files", "ok", "refused", *BAD)
    lines = [f"{'reader':<22}" + "".join(f"{h:>10}" for h in heads) + f"{'most CPU s':>11}{'peak MB':>9}"]
    for kind in [*dict.fromkeys(o.kind for o in outcomes), "all"]:
        rows = [o for o in outcomes if kind in (o.kind, "all")]
        counts = Counter(o.result for o in rows)
        numbers = [len(rows), *(counts[h] for h in heads[1:])]
        slowest, peak = max(o.seconds for o in rows), max(o.peak_MB for o in rows)
        lines.append(f"{kind:<22}" + "".join(f"{n:>10}" for n in numbers) + f"{slowest:>11.2f}{peak:>9.0f}")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
