"""A million hostile frames at the live loop: commands that left their range (must be none), and memory.

python benchmarks/live_fuzz.py [--frames 1000000] [--law exact]
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "link"))

from test_link_live_fuzz import CRM, X8, Sink, hostile  # type: ignore[import-not-found]

from coaxlink.link.live_guard import Timing
from coaxlink.link.mixing import LiveMixer
from coaxlink.mixer import make_law


def resident_mb() -> float:
    status = Path("/proc/self/status").read_text()
    return int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1]) / 1024


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--law", default="exact")
    parser.add_argument("--seed", type=int, default=1)
    o = parser.parse_args()
    sink, law = Sink(), make_law(o.law, X8, CRM)
    mixer = LiveMixer(sink, X8, law, CRM, timing=Timing(settle=1, fade_s=0.02), witness=False)
    mixer.start()
    started, early = time.monotonic(), 0.0
    for k, data in zip(range(o.frames), hostile(random.Random(o.seed)), strict=False):
        mixer.take(data)
        if k == o.frames // 10:
            early = resident_mb()
    summary = mixer.summary()
    took = time.monotonic() - started
    print(f"{o.frames} frames at {o.law} in {took:.0f} s: {sink.sent} answers, none out of 0..1")
    print(f"unanswered: {summary['unanswered']}")
    print(f"resident {early:.1f} MB after a tenth, {resident_mb():.1f} MB at the end")
    if summary["unanswered"]["failures"]:
        sys.exit(f"the loop failed: {mixer.error}")


if __name__ == "__main__":
    main()
