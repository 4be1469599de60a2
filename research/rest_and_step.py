"""Rest and step: the model of a stand log in time, held against that of the averaged map.

    python research/rest_and_step.py [FOLDER] [--only mn4014] [--inertia] [--small]

FOLDER holds the coaxial maps of the shared data (default: ../shared/data/coax beside the repository). Twelve
runs of one map (tests/helpers/stand_in_time.py: rest first, last, at both ends and between, ramps, steps of
0.5 s, a slow spin-up) of the paper's pair and of each map are identified as logged, 10 rows a second.
Printed is how far each load is from the averaged map's model over the map's points, root mean square, in
standard errors of the two models and of the tare: 2 is what chance leaves in 1 of 20. `--inertia` lets the
torque cells feel the rotors' inertia too: steps of 0.5 s do not settle, and their torques are off by it.
`--small` takes seconds: the paper's pair, three runs, of which none may be further off than `BROKEN`: a model
that rest spoils is tens of standard errors off, and this pair's model misses CHANCE by a little.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "helpers"))

import stand_in_time as bench_of  # noqa: E402
from stand_in_time import Array, Bench  # noqa: E402

from coaxlink.data import read_stand_log  # noqa: E402
from coaxlink.rotor import Identification, identify  # noqa: E402
from coaxlink.rotor.model import LOADS  # noqa: E402

MAPS = {"mn4014_16in_zD055": 4e-4, "propdrive_11in_zD07": 8e-5, "u5_16in_zD05": 4e-4}  # kg m^2, of a rotor
SMALL = ("rest last", "rests between steps", "ramps, rest at both ends")
CHANCE = 2.0
MEDIAN = 1.25  # standard error of a median over that of a mean


def identified(bench: Bench, log: dict[str, Array], folder: Path) -> Identification:
    path = bench_of.save(folder / "log.csv", log)
    return identify(read_stand_log(path), "auto", speed_max_rpm=bench.full)


def standard_errors(found: Identification) -> list[Array]:
    """Of each load's model at the rows of the averaged map, all terms of its dictionary free."""
    errors = []
    for load in LOADS:
        rows, fit = found.data.rows(load), found.fits[load]
        X = rows.design(fit.terms)
        q = np.linalg.qr(X / np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-300))[0]
        left = rows.y - X @ fit.coefficients
        scatter = np.sqrt(left @ left / max(len(left) - X.shape[1], 1))
        errors.append(scatter * np.sqrt(np.minimum(np.sum(q**2, axis=1), 1.0)))
    return errors


def apart(bench: Bench, averaged: Identification, found: Identification, rest_s: float) -> list[float]:
    """Of each load, in standard errors of their difference, root mean square over the map."""
    u = bench.points / bench.full
    tops = np.abs(bench.loads(*bench.points.T)).max(axis=0)
    out = []
    for load, error, top in zip(LOADS, standard_errors(averaged), tops, strict=True):
        off = found.fits[load].predict(*u.T) - averaged.fits[load].predict(*u.T)
        tare = MEDIAN * bench.noise * top / np.sqrt(10.0 * rest_s) if rest_s else 0.0
        out.append(float(np.sqrt(np.mean(off**2) / np.mean(2.0 * error**2 + tare**2))))
    return out


BROKEN = 5.0  # standard errors, judgement


def held(name: str, bench: Bench, small: bool) -> tuple[int, int]:
    """Runs that are within chance, and runs."""
    good = 0
    with tempfile.TemporaryDirectory() as folder:
        averaged = identified(bench, bench_of.averaged(bench, 100), Path(folder))
        print(f"{name}: {averaged.form}, {len(bench.points)} points")
        runs = {n: p for n, p in bench_of.shapes(bench).items() if not small or n in SMALL}
        for seed, (run, pieces) in enumerate(runs.items()):
            found = identified(bench, bench_of.run(bench, pieces, seed), Path(folder))
            rest_s = sum(seconds for seconds, a, b in pieces if not a.any() and not b.any())
            off = apart(bench, averaged, found, rest_s)
            good += max(off) <= (BROKEN if small else CHANCE)
            error = found.channels["coaxial_thrust"].rmse
            rows = f"{found.data.logged:5d} rows, {found.data.samples.rows:3d} conditions"
            print(
                f"  {run:34s} {rows}, {found.form}: "
                f"{', '.join(f'{x:.1f}' for x in off)}; pair's thrust held out {error:.2g} N"
            )
    return good, len(runs)


def main() -> int:
    """Exit code 1 if more runs are off than chance explains."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("folder", nargs="?", type=Path, default=ROOT.parent / "shared" / "data" / "coax")
    asked.add_argument("--only", default="", help="maps whose name holds this")
    asked.add_argument("--inertia", action="store_true")
    asked.add_argument("--small", action="store_true")
    to = asked.parse_args()
    benches = {"paper": bench_of.paper()}
    if not to.small:
        maps = {name: to.folder / f"{name}.csv" for name in MAPS}
        benches |= {n: bench_of.of_map(p, MAPS[n]) for n, p in maps.items() if p.is_file()}
    counts = [
        held(name, bench if to.inertia else replace(bench, inertia_kg_m2=0.0), to.small)
        for name, bench in benches.items()
        if to.only in name
    ]
    good, runs = (sum(c) for c in zip(*counts, strict=True))
    print(f"{good} of {runs} runs within {BROKEN if to.small else CHANCE:g} standard errors")
    return 0 if runs - good <= 0.05 * runs + 2.0 * np.sqrt(0.05 * runs) else 1


if __name__ == "__main__":
    sys.exit(main())
