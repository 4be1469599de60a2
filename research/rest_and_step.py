"""Rest and step: the model of a stand log in time, held against that of the averaged map.

    python research/rest_and_step.py [FOLDER] [--only mn4014] [--inertia] [--small]

FOLDER holds the coaxial maps of the shared data (default: ../shared/data/coax beside the repository). Twelve
runs of one map (tests/helpers/stand_in_time.py: rest first, last, at both ends and between, ramps, steps of
0.5 s, a slow spin-up) of the paper's pair and of each map are identified as logged, 10 rows a second.
Printed is how far each load is from the averaged map's model over the map's points, root mean square, in
standard errors of the two models and of the tare: by chance the worst of the four is above 2.5 in 1 run of
20. `--inertia` lets the torque cells feel the rotors' inertia too: steps of 0.5 s do not settle, and their
torques are off by it.
`--small` takes seconds: three runs of the paper's pair.
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
from coaxlink.rotor.polynomial import design_matrix  # noqa: E402

MAPS = {"mn4014_16in_zD055": 4e-4, "propdrive_11in_zD07": 8e-5, "u5_16in_zD05": 4e-4}  # kg m^2, of a rotor
SMALL = ("rest last", "rests between steps", "ramps, rest at both ends")
CHANCE = 2.5  # standard errors: one of a run's four loads is further off in 1 of 20
RUN_OUT = 5.0  # lags: to 1 % of full speed
MEDIAN = 1.25  # standard error of a median over that of a mean


def identified(bench: Bench, log: dict[str, Array], folder: Path) -> Identification:
    path = bench_of.save(folder / "log.csv", log)
    return identify(read_stand_log(path), "auto", speed_max_rpm=bench.full)


def standard_error(found: Identification, load: str, u: Array) -> Array:
    """Of a load's model at speeds (n, 2): all terms of its dictionary free, scatter of its own conditions."""
    rows, fit = found.data.rows(load), found.fits[load]
    X, at = rows.design(fit.terms), design_matrix(fit.terms, *u.T)
    left = rows.y - X @ np.linalg.lstsq(X, rows.y, rcond=None)[0]
    scatter = np.sqrt(left @ left / max(len(left) - X.shape[1], 1))
    return scatter * np.sqrt(np.sum((at @ np.linalg.pinv(X)) ** 2, axis=1))


def apart(bench: Bench, averaged: Identification, found: Identification, rest_s: float) -> list[float]:
    """Of each load, in standard errors of their difference, root mean square over the map."""
    u = bench.points / bench.full
    tops = np.abs(bench.loads(*bench.points.T)).max(axis=0)
    out = []
    for load, top in zip(LOADS, tops, strict=True):
        off = found.fits[load].predict(*u.T) - averaged.fits[load].predict(*u.T)
        errors = [standard_error(model, load, u) for model in (averaged, found)]
        tare = MEDIAN * bench.noise * top / np.sqrt(10.0 * rest_s) if rest_s else 0.0
        out.append(float(np.sqrt(np.mean(off**2) / np.mean(np.sum(np.square(errors), axis=0) + tare**2))))
    return out


def still_s(bench: Bench, pieces: list[bench_of.Piece]) -> float:
    """Seconds of rest that tell a tare: rotors run out first, and a third of a later rest is not used."""
    out = 0.0
    for number, (seconds, a, b) in enumerate(pieces):
        if not a.any() and not b.any():
            out += (seconds - RUN_OUT * bench.lag_s) * 2.0 / 3.0 if number else seconds
    return out


def held(name: str, bench: Bench, small: bool) -> tuple[int, int]:
    """Runs that are within chance, and runs."""
    good = 0
    with tempfile.TemporaryDirectory() as folder:
        averaged = identified(bench, bench_of.averaged(bench, 100), Path(folder))
        print(f"{name}: {averaged.form}, {len(bench.points)} points")
        runs = [(seed, *run) for seed, run in enumerate(bench_of.shapes(bench).items())]
        runs = [run for run in runs if not small or run[1] in SMALL]
        for seed, run, pieces in runs:
            found = identified(bench, bench_of.run(bench, pieces, seed), Path(folder))
            rest_s = still_s(bench, pieces)
            off = apart(bench, averaged, found, rest_s)
            good += max(off) <= CHANCE
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
    print(f"{good} of {runs} runs within {CHANCE:g} standard errors")
    return 0 if runs - good <= 0.05 * runs + 2.0 * np.sqrt(0.05 * runs) else 1


if __name__ == "__main__":
    sys.exit(main())
