"""Hours of flight through `coaxlink refine`: seconds and peak memory of the whole process.

    python research/long_flight.py [--rows 1000000] [--keep FOLDER]

Flights of 16 minutes on the example X8 with a weak rotor, each with other gusts and a seed of its own, one
behind the other at 50 Hz in one CSV.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
FRAME, ROTORS = EXAMPLES / "x8_demo.toml", EXAMPLES / "rotor_paper.toml"
MINUTES, EVERY = 16.0, 8  # of a flight; turns of the loops a row


def written(path: Path, rows: int) -> None:
    """The log: flights until there are so many rows."""
    from coaxlink.tables.px4 import report_px4
    from coaxlink.vehicle import load_vehicle
    from sim.effects import Effect
    from sim.physics.rotors import read_pair
    from sim.quick.flight import World, fly_quick, make_design
    from sim.vehicle import read_vehicle

    table = report_px4(load_vehicle(FRAME, ROTORS), "fitted").params
    made = make_design(read_vehicle(FRAME), read_pair(ROTORS), table)
    weak = Effect("degraded_rotor", 0.1, 0.0, {"rotor": 3.0})
    left, end, seed = rows, 0.0, 0
    with path.open("w") as file:
        while left:
            columns = fly_quick(made, World((weak,), seed, "wander", 60.0 * MINUTES), EVERY)[1]
            if not seed:
                file.write(",".join(columns) + "\n")
            time = columns["time_s"]
            table_of = np.stack(list((columns | {"time_s": time + end}).values()), axis=1)[:left]
            np.savetxt(file, table_of, "%.9g", ",")
            left, end, seed = left - len(table_of), end + float(time[-1]) + 0.02, seed + 1


def main() -> int:
    """Print what it took."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--keep", type=Path)
    o = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = (o.keep or Path(folder)) / "long.csv"
        written(path, o.rows)
        command = [sys.executable, "-m", "coaxlink", "refine", str(path)]
        command += ["--airframe", str(FRAME), "--rotor", str(ROTORS)]
        started = os.times().elapsed
        process = os.spawnv(os.P_NOWAIT, sys.executable, command)
        _, status, usage = os.wait4(process, 0)
        seconds = os.times().elapsed - started
    used = usage.ru_utime + usage.ru_stime
    print(
        f"{o.rows} rows: {seconds:.0f} s, {used:.0f} s of a processor, {usage.ru_maxrss / 1e6:.2f} GB at most"
    )
    return os.waitstatus_to_exitcode(status)


if __name__ == "__main__":
    raise SystemExit(main())
