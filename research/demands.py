"""Does the exact law ever answer with less than it could? A hundred thousand demands on each real pair.

    python research/demands.py [FOLDER] [--only mn4014] [--rows 100000] [--plain 5000] [--json FILE] [--small]

An X8 of each map of the shared data (as `real_pairs.py` makes it), of blades that are made here (`--small`),
and of the paper's pair. Demands in blocks of any order: what random speeds give (so they can be met), hover
with small turns, rest, steps that are held, up to four times out of reach; half of them with all rotors, a
quarter each with an upper and with a lower one dead.
An answer that misses by more than `MISSED` of the weight (moments: at the arm) is held against a search
with another method from random places (damped least squares within the law's own bounds); those it finds
are `short`; `sees` is the share of answered demands that the search meets too. The same of the compiled law,
of plain Python (`--plain` of them) and of the C++ on board (with g++),
whose every call ends after so many passes and goes on in the next: there a demand is held for `HELD` calls.
Times are of a demand's first call: microseconds in the middle and at p99; `looks`: how often the law looked
all round.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from real_pairs import HERE, STEMS, coaxlink, made_map, vehicle_file

from coaxlink.files import example
from coaxlink.mixer.exact import ExactLaw
from coaxlink.vehicle import Vehicle, load_vehicle

MISSED = 0.005  # of the weight
SEARCHED, STARTS, STEPS = 200, 12, 60  # answers that miss; random places that each is sought from; steps
SEEN = 50  # answers that do not miss
# of the X8's eight none dead, an upper one, a lower one; and their parts of the demands
DEAD: dict[tuple[int, ...], float] = {(): 0.5, (3,): 0.25, (7,): 0.25}
HELD = 5  # calls of the law on board: 20 ms at 250 Hz
KINDS = ("met", "hover", "rest", "held", "beyond")
Array = NDArray[np.float64]


def demands(
    vehicle: Vehicle, rows: int, failed: tuple[int, ...], rng: np.random.Generator
) -> tuple[Array, NDArray[np.int64]]:
    """(rows, 4) thrust N, roll, pitch, yaw N m in blocks of KINDS, in any order; (rows,) of which kind."""
    frame, count = vehicle.airframe, len(vehicle.airframe.rotors)
    weight, size = 9.80665 * frame.mass_kg, np.ptp(wrenches(vehicle, rng.random((400, count))), axis=0)
    blocks, kinds = list[Array](), list[int]()
    while sum(map(len, blocks)) < rows:
        n, kind = int(rng.integers(1, 60)), int(rng.integers(len(KINDS)))
        if kind == 0:
            commands = rng.random((n, count))
            commands[:, [i - 1 for i in failed]] = 0.0
            block = wrenches(vehicle, commands)
        elif kind == 1:
            near = rng.uniform([0.76, -1, -1, -1], [1.32, 1, 1, 1], (n, 4))
            block = near * [weight, *(0.05 * size[1:])]
        elif kind == 2:
            block = np.zeros((n, 4)) + rng.uniform(0.0, 0.05 * weight) * np.array([1.0, 0, 0, 0])
        elif kind == 3:
            held = rng.uniform([0.3, -0.2, -0.2, -0.2], [2.0, 0.2, 0.2, 0.2], 4) * [weight, *size[1:]]
            block = np.repeat(held[None], n, axis=0)
        else:
            block = rng.uniform([-0.5, -2, -2, -2], [4.0, 2, 2, 2], (n, 4)) * [weight, *size[1:]]
        blocks.append(block)
        kinds += [kind] * n
    return np.concatenate(blocks)[:rows], np.array(kinds[:rows])


def wrenches(vehicle: Vehicle, commands: Array) -> Array:
    """(rows, 4) of commands (rows, N)."""
    return delivered(vehicle, vehicle.turned(commands))


def delivered(vehicle: Vehicle, speeds: Array) -> Array:
    """(..., 4) of speeds (..., N)."""
    per_thrust, per_torque = vehicle.airframe.effectiveness()
    thrust, torque = vehicle.airframe.loads(vehicle.model, speeds)
    return np.asarray(thrust @ per_thrust.T + torque @ per_torque.T)


def found_by_search(
    vehicle: Vehicle, law: ExactLaw, given: Array, units: Array, rng: Any
) -> NDArray[np.bool_]:
    """Which demands (rows, 4) damped least squares meets from random places within the law's own bounds."""
    p, slots = law.arms, law.units.slots
    lo, hi, tiny = p.lo, p.hi, 1e-6

    def missing(x: Array) -> Array:
        upper, s = x[..., ::2], x[..., 1::2]
        least, most = (p.line[:, i] + p.line[:, i + 1] * upper for i in (0, 2))
        speeds = np.stack([upper, least + (most - least) * s], axis=-1).reshape(x.shape)[..., slots]
        return (delivered(vehicle, speeds) - demand) / units

    demand = np.repeat(given, STARTS, axis=0)
    x = rng.uniform(lo, hi, (len(demand), len(lo)))
    for n in range(STEPS):
        off = missing(x)
        slopes = np.stack([(missing(x + tiny * e) - off) / tiny for e in np.eye(len(lo))], axis=-1)
        step, free = np.zeros_like(x), np.broadcast_to(hi > lo, x.shape)
        for _ in range(3):  # what would leave the bounds is held there
            j = slopes * free[:, None, :]
            inner = j @ j.transpose(0, 2, 1) + 10.0 ** -(2 + n // 10) * np.eye(4)
            step = -(j.transpose(0, 2, 1) @ np.linalg.solve(inner, off[..., None]))[..., 0]
            free = free & (x + step > lo - 1e-12) & (x + step < hi + 1e-12)
        x = np.clip(x + step, lo, hi)
    return np.asarray((np.abs(missing(x)).max(axis=1) < 0.5 * MISSED).reshape(-1, STARTS).any(axis=1))


def judged(
    vehicle: Vehicle, law: ExactLaw, given: Array, kinds: NDArray[np.int64], speeds: Array, rng: Any
) -> dict[str, Any]:
    """How many answers miss, and of as many as are searched how many need not."""
    weight = 9.80665 * vehicle.airframe.mass_kg
    arm = max(float(np.hypot(*r.position_m[:2])) for r in vehicle.airframe.rotors)
    units = weight * np.array([1.0, arm, arm, arm])
    off = (np.abs(delivered(vehicle, speeds) - given) / units).max(axis=1)
    missed = rng.permutation(np.flatnonzero(off > MISSED))[:SEARCHED]
    met = rng.permutation(np.flatnonzero(off < MISSED))[:SEEN]
    short = missed[found_by_search(vehicle, law, given[missed], units, rng)]
    return {
        "missed": int(np.sum(off > MISSED)),
        "searched": len(missed),
        "short": len(short),
        "of": sorted(f"{KINDS[kinds[i]]} by {100 * off[i]:.2g} %" for i in short),
        "sees": float(np.mean(found_by_search(vehicle, law, given[met], units, rng))),
    }


def walk(name: str, vehicle: Vehicle, rows: int, plain: int, ways: tuple[str, ...]) -> list[dict[str, Any]]:
    """A finding a way of computing and a state of the rotors, printed."""
    rng, out = np.random.default_rng(1), []
    for failed, part in DEAD.items():
        given, kinds = demands(vehicle, int(part * rows), failed, rng)
        for way in ways:
            law = ExactLaw(vehicle, failed=failed, compiled=way == "compiled")
            mine = given[: int(part * plain)] if way == "plain" else given
            if way == "C++":
                speeds, micros, looks = by_board(vehicle, mine, failed)
            else:
                speeds, micros, looks = by_python(law, mine)
            found = judged(vehicle, law, mine, kinds, speeds, rng)
            out.append(row(name, way, failed, len(mine), found, micros, looks))
    return out


def by_python(law: ExactLaw, given: Array) -> tuple[Array, Array, float]:
    """(rows, N) speeds, microseconds (rows,), and looks a demand."""
    law.plain(given[0].tolist())
    speeds, micros = np.zeros((len(given), len(law.units.slots))), np.zeros(len(given))
    for n, wrench in enumerate(given.tolist()):
        begun = time.thread_time_ns()
        speeds[n] = law.plain(wrench)
        micros[n] = (time.thread_time_ns() - begun) / 1e3
    return speeds, micros, law.certificate.looks / len(given)


def by_board(vehicle: Vehicle, given: Array, failed: tuple[int, ...]) -> tuple[Array, Array, float]:
    """(rows, N) speeds of the module's law, microseconds (rows,), and looks a demand."""
    sys.path.insert(0, str(HERE.parent / "tests" / "helpers"))
    from board_law import build, on_board  # type: ignore[import-not-found]

    from coaxlink.live.onboard.description import board_law

    about = board_law(vehicle)
    with tempfile.TemporaryDirectory() as folder:
        program = build(Path(folder), about, "-O2")
        dead = sum(1 << int(about.units.slots[n - 1]) for n in failed)
        held = np.repeat(given[:, about.units.order] / about.units.scale, HELD, axis=0)
        reported = on_board(program, held, dead)
    looks = float(reported.looks[-1]) / len(given)
    return reported.speeds[HELD - 1 :: HELD, about.units.slots], reported.micros[::HELD], looks


def row(
    name: str,
    way: str,
    failed: tuple[int, ...],
    rows: int,
    found: dict[str, Any],
    micros: Array,
    looks: float,
) -> dict[str, Any]:
    """One finding, printed."""
    p50, p99 = np.percentile(micros, [50, 99])
    print(
        f"{name:22s} {way:8s} {f'dead {failed[0]}' if failed else 'all':6s} {rows:7d} demands  missed "
        f"{found['missed']:6d}  searched {found['searched']:3d}  short {found['short']:3d}  "
        f"sees {100 * found['sees']:.0f} %  "
        f"us {p50:6.1f} {p99:7.1f}  looks {100 * looks:.2f} % "
        f"{', '.join(found['of'])}",
        flush=True,
    )
    return {
        "map": name,
        "way": way,
        "dead": list(failed),
        "rows": rows,
        **found,
        "us": [p50, p99],
        "looks": looks,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument(
        "folder", nargs="?", type=Path, default=HERE.parent.parent / "shared" / "data" / "coax"
    )
    parser.add_argument("--only", default="", help="maps in whose name this is; `eq. 17` is the paper's pair")
    parser.add_argument("--rows", type=int, default=100_000)
    parser.add_argument("--plain", type=int, default=5_000, help="how many of them in plain Python")
    parser.add_argument("--small", action="store_true", help="blades alone, 500 demands, nothing compiled")
    parser.add_argument("--json", type=Path)
    o = parser.parse_args()
    out: list[dict[str, Any]] = []
    ways: tuple[str, ...] = ("compiled", "plain", "C++")
    if o.small or not shutil.which("g++"):
        ways = ("plain",) if o.small else ways[:2]
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        if o.small:
            paths = [made_map(folder / "made_zD07.csv")]
        else:
            every = sorted(p for s in STEMS for p in o.folder.glob(f"{s}_zD*.csv") if p.stem.count("_") == 2)
            paths = [p for p in every if o.only in p.stem]
            if o.only in "eq. 17":
                out += walk("eq. 17", load_vehicle(example("x8_paper.toml")), o.rows, o.plain, ways)
        for path in paths:
            coaxlink(
                "identify", path, "--upper", "left", "--out", rotor := folder / f"rotor_{path.stem}.toml"
            )
            vehicle = load_vehicle(vehicle_file(path, rotor, folder / f"{path.stem}.toml"))
            out += walk(path.stem, vehicle, *((1000, 1000) if o.small else (o.rows, o.plain)), ways)
    if o.json:
        o.json.write_text(json.dumps(out, indent=1))
    sys.exit(any(f["short"] for f in out))


if __name__ == "__main__":
    main()
