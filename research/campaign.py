"""What campaigns cost: workers against one, the engine's own cost, memory, ten thousand flights.

    python research/campaign.py [--flights 10000] [--scale 600] [--refined 40] [--json F]

Flights are 60 s, plant at 1 ms, loops at 400 Hz, four laws on the paper's X8 in drawn winds with drawn weak
rotors. The engine's cost is processor time, its own and the workers', beyond what the cells themselves take;
it does not count who else uses the machine. Wall-clock ratios do: the load average stands beside them.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

CAMPAIGN = """
flights = {flights}
laws = ["standard", "reduced", "fitted", "exact"]
airframe = "x8_demo.toml"
[effects.wind]
size = {{ low = 0.0, high = 8.0 }}
direction_deg = {{ low = 0.0, high = 360.0 }}
law = "dryden"
[effects.degraded_rotor]
chance = 0.5
size = {{ low = 0.0, high = 0.3 }}
rotor = "any"
"""
REFINED = """
flights = {flights}
laws = ["standard", "fitted"]
airframe = "x8_demo.toml"
refine = true
seconds = 40.0
[effects.degraded_rotor]
chance = 0.7
size = {{ low = 0.05, high = 0.2 }}
rotor = "any"
"""
CELL_S, CELLS = 0.05, 800
COAXLINK = [sys.executable, "-m", "coaxlink", "campaign"]


def burn(payload: object, cells: Sequence[int]) -> dict[str, list[object]]:
    """Cells of 50 ms of processor time each, with rows as wide as a flight's."""
    for _ in cells:
        until = time.thread_time() + CELL_S
        while time.thread_time() < until:
            pass
    return {"cell": list(cells)} | {f"figure{k}": [0.1 * c + k for c in cells] for k in range(40)}


def engine_cost(cells: int) -> float:
    """Processor seconds of this process and its workers for so many cells, the work itself left out."""
    from coaxlink.studies.campaign.dataset import Dataset
    from coaxlink.studies.campaign.engine import Machine, run

    def spent() -> float:
        both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        return sum(u.ru_utime + u.ru_stime for u in both)

    columns = {"cell": "int64"} | {f"figure{k}": "float64" for k in range(40)}
    before, worked = spent(), 0.0
    with tempfile.TemporaryDirectory() as folder, Dataset(Path(folder), columns, cells, {}) as rows:
        for done in run(burn, None, rows.missing(), Machine(2)):
            rows.add(done.rows)
            worked += done.seconds
    return spent() - before - worked


def fly(folder: Path, flights: int, workers: int) -> tuple[float, float, float]:
    """(wall s, processor s, MB of the largest process) of a campaign as a user starts it."""
    folder.mkdir(parents=True, exist_ok=True)
    spec = folder / "bench.toml"
    spec.write_text(CAMPAIGN.format(flights=flights))
    command = [*COAXLINK, str(spec), "--out", str(folder / "out"), "--workers", str(workers)]
    start = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, "the campaign failed"
    return time.monotonic() - start, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--flights", type=int, default=10_000)
    parser.add_argument("--scale", type=int, default=600, help="flights of the comparison of 1 and 2 workers")
    parser.add_argument("--refined", type=int, default=40, help="flights whose logs `refine` is given")
    parser.add_argument("--json", type=Path)
    o = parser.parse_args()
    results: dict[str, object] = {}

    def tell(name: str, value: object, text: str) -> None:
        results[name] = value
        print(f"{text}   (load {os.getloadavg()[0]:.1f})", flush=True)

    engine_cost(2)  # imports what this process needs once
    start_up = engine_cost(2)
    own = (engine_cost(CELLS) - start_up) / (CELLS * CELL_S)
    tell(
        "engine_share",
        own,
        f"engine: {100 * own:.2f} % of the work at cells of 50 ms; start {start_up:.1f} s",
    )
    with tempfile.TemporaryDirectory() as scratch:
        scratch_folder = Path(scratch)
        fly(scratch_folder / "warm", 8, 2)  # compiles what is not yet compiled
        ratios = []
        for k in range(2):
            one, two = (fly(scratch_folder / f"{k}-{w}", o.scale, w) for w in (1, 2))
            ratios.append(one[0] / two[0])
            text = f"{o.scale} flights: 1 worker {one[0]:.1f} s, 2 {two[0]:.1f} s, ratio {ratios[-1]:.2f}"
            tell(f"ratio_{k}", ratios[-1], f"{text}; processor {one[1]:.0f} and {two[1]:.0f} s")
        small = fly(scratch_folder / "small", 100, 2)
        tell("mb_100", small[2], f"100 flights: largest process {small[2]:.0f} MB")
        big = fly(scratch_folder / "big", o.flights, 2)
        tell("mb_many", big[2], f"{o.flights} flights: largest process {big[2]:.0f} MB")
        tell(
            "wall_s",
            big[0],
            f"{o.flights} flights of 60 s: {big[0]:.0f} s, {big[1] / o.flights:.3f} s of processor each",
        )
        if o.refined:
            spec = scratch_folder / "refined.toml"
            spec.write_text(REFINED.format(flights=o.refined))
            done = subprocess.run([*COAXLINK, str(spec), "--out", str(scratch_folder / "refined")],
                                  capture_output=True, text=True, check=True)  # fmt: skip
            for line in (done.stdout + done.stderr).splitlines():
                if line.startswith("refine named"):
                    tell("refined", line, line)
    if o.json:
        o.json.write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
