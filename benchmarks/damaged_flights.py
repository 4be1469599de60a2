"""Damaged copies of a flight log: each is answered or refused in one line, none ends in a traceback.

    python benchmarks/damaged_flights.py [--copies 200] [--through 30] [--seed 0]

A flight of a minute on the example X8 with a weak rotor; every other copy goes by way of a CSV. A copy has
one to three damages: columns that are constant, missing, empty in places, repeated, huge, tiny, negative,
endless or exchanged; gaps, doubled and jumping times, a flight cut short. All copies are read and looked
through for faults, the first `--through` of them go through `refine`. A warning counts as a traceback.
"""

from __future__ import annotations

import argparse
import collections
import tempfile
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

Columns = dict[str, np.ndarray]
Damage = Callable[[Columns, list[str], np.random.Generator], Columns]
EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
HUGE, TINY = 1e9, 1e-9


def some_rows(columns: Columns, random: np.random.Generator) -> slice:
    """A stretch of the flight."""
    rows = len(columns["time_s"])
    first, last = np.sort(random.integers(0, rows, 2))
    return slice(int(first), int(last) + 1)


def of_columns(change: Callable[[np.ndarray, np.random.Generator], np.ndarray], *, part: bool) -> Damage:
    """A damage of some columns, for a stretch or throughout."""

    def damage(columns: Columns, names: list[str], random: np.random.Generator) -> Columns:
        where = some_rows(columns, random) if part and random.random() < 0.7 else slice(None)
        out = {name: values.copy() for name, values in columns.items()}
        for name in names:
            out[name][where] = change(out[name][where], random)
        return out

    return damage


def without(columns: Columns, names: list[str], random: np.random.Generator) -> Columns:
    return {name: values for name, values in columns.items() if name not in names}


def exchanged(columns: Columns, names: list[str], random: np.random.Generator) -> Columns:
    other = str(random.choice(list(columns)))
    return columns | {names[0]: columns[other], other: columns[names[0]]}


def kept(columns: Columns, rows: np.ndarray) -> Columns:
    return {name: values[rows] for name, values in columns.items()}


def gap(columns: Columns, names: list[str], random: np.random.Generator) -> Columns:
    rows = np.ones(len(columns["time_s"]), bool)
    rows[some_rows(columns, random)] = False
    return kept(columns, np.flatnonzero(rows))


def cut(columns: Columns, names: list[str], random: np.random.Generator) -> Columns:
    return kept(columns, np.arange(int(len(columns["time_s"]) * random.random() ** 2)))


def doubled(columns: Columns, names: list[str], random: np.random.Generator) -> Columns:
    return kept(columns, np.sort(random.integers(0, len(columns["time_s"]), len(columns["time_s"]))))


def jump(columns: Columns, names: list[str], random: np.random.Generator) -> Columns:
    time = columns["time_s"].copy()
    time[some_rows(columns, random)] += random.choice([-100.0, 1e-3, 5.0, HUGE])
    return columns | {"time_s": time}


DAMAGES: dict[str, Damage] = {
    "constant": of_columns(lambda x, r: np.full_like(x, x[0] if len(x) else 0.0), part=True),
    "nil": of_columns(lambda x, r: np.zeros_like(x), part=True),
    "empty": of_columns(lambda x, r: np.where(r.random(len(x)) < 0.3, np.nan, x), part=True),
    "repeated": of_columns(lambda x, r: np.resize(x[: max(len(x) // 5, 1)], len(x)), part=True),
    "huge": of_columns(lambda x, r: HUGE * x, part=True),
    "tiny": of_columns(lambda x, r: TINY * x, part=True),
    "negative": of_columns(lambda x, r: -x, part=True),
    "endless": of_columns(lambda x, r: np.where(r.random(len(x)) < 0.01, np.inf, x), part=True),
    "noise": of_columns(lambda x, r: r.standard_normal(len(x)), part=True),
    "missing": without,
    "exchanged": exchanged,
    "gap": gap,
    "cut": cut,
    "doubled": doubled,
    "jump": jump,
}


def flown() -> Columns:
    """The flight that is damaged."""
    from coaxlink.tables.px4 import report_px4
    from coaxlink.vehicle import load_vehicle
    from sim.effects import Effect
    from sim.physics.rotors import read_pair
    from sim.quick.flight import World, fly_quick, make_design
    from sim.vehicle import read_vehicle

    frame, rotors = EXAMPLES / "x8_demo.toml", EXAMPLES / "rotor_paper.toml"
    table = report_px4(load_vehicle(frame, rotors), "fitted").params
    weak = Effect("degraded_rotor", 0.1, 20.0, {"rotor": 3.0})
    made = make_design(read_vehicle(frame), read_pair(rotors), table)
    return fly_quick(made, World((weak,), 1, "wander", 60.0), 8)[1]


def main() -> int:
    """Print what became of the copies; 1 where one ended in a traceback."""
    from coaxlink.airframe import load_airframe
    from coaxlink.data import Samples, read_flight_log
    from coaxlink.errors import CoaxlinkError
    from coaxlink.residual import refine
    from coaxlink.residual.channels.flight import flight_frame
    from coaxlink.residual.faults.flight_faults import flight_suspects
    from coaxlink.rotor import load_rotor_model

    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--copies", type=int, default=200)
    parser.add_argument("--through", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    o = parser.parse_args()
    warnings.simplefilter("error")
    airframe = load_airframe(EXAMPLES / "x8_demo.toml")
    model = load_rotor_model(EXAMPLES / "rotor_paper.toml")
    whole, ends = flown(), collections.Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        for copy in range(o.copies):
            random = np.random.default_rng([o.seed, copy])
            columns, done = dict(whole), []
            for _ in range(int(random.integers(1, 4))):
                kind = str(random.choice(list(DAMAGES)))
                names = [n for n in columns if n != "time_s"]
                chosen = random.choice(names, min(int(random.integers(1, 4)), len(names)), replace=False)
                columns = DAMAGES[kind](columns, [str(n) for n in chosen], random)
                done.append(f"{kind} {' '.join(chosen)}")
            place = Path(folder) / f"{copy}.csv"
            try:
                if copy % 2:  # as a binary log's reader hands them on: also with what a CSV may not have
                    log = Samples(columns, place.name)
                else:
                    rows = np.stack(list(columns.values()), axis=1)
                    np.savetxt(place, rows, "%.9g", ",", header=",".join(columns), comments="")
                    log = read_flight_log(place)
                frame = flight_frame([log], airframe, model)
                flight_suspects(frame, [log])
                ends["looked through"] += 1
                if copy < o.through:
                    refine(log, airframe, model)
                    ends["answered"] += 1
            except CoaxlinkError as error:
                ends["refused"] += 1
                if copy < o.through:
                    ends["of the first, refused"] += 1
                assert "\n" not in str(error), error
            except Exception:
                ends["traceback"] += 1
                print(f"copy {copy}: {'; '.join(done)}\n{traceback.format_exc(limit=-3)}", flush=True)
    print(", ".join(f"{name} {count}" for name, count in ends.items()))
    return 1 if ends["traceback"] else 0


if __name__ == "__main__":
    raise SystemExit(main())
