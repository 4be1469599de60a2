"""Damaged copies of a log: each is answered or refused in one line, none ends in a traceback.

    python research/damaged_logs.py [--small] [--kind stand] [--kind flight] [--copies 200] [--through 200]

A flight of a minute on the example X8 with a weak rotor, and a stand log whose supply sags, held against the
paper's rotor or (every third) against nothing; every other copy goes by way of a CSV. A copy has one to three
damages: columns that are constant, missing, empty in places, repeated, huge, tiny (1e-300 among them),
negative, endless or exchanged; gaps, doubled and jumping times, a log cut short, to two rows or none. All
copies are read and looked through for faults, the first `--through` of them go through `refine`. A warning
counts as a traceback.

    python research/damaged_logs.py --changed ../shared/worlds/stand [FOLDER...] [--rows 16 20 28 50]

Clean stand logs under changes that keep them clean: what is claimed all the same? FOLDER has `truth.json`
with the logs of kind `clean`, and their rotor models, as `../shared/worlds` lays them out. Of each log: its
columns without torque, without the lower rotor, without anything but speeds and loads, without time; loads in
coarse steps, a thousandth as large, with spikes; rows shuffled, doubled, averaged in pairs, from the middle;
and, of `--rows` each, rows spread over the log, the same a row later, and neighbours. Anything named, alone
or as ambiguous, is a claim of what is not there; flagged columns are counted apart.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from coaxlink.data import Samples

Columns = dict[str, np.ndarray]
Damage = Callable[[Columns, list[str], np.random.Generator], Columns]
EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
HUGE, TINY = 1e9, 1e-9


def some_rows(columns: Columns, random: np.random.Generator) -> slice:
    """A stretch of the flight."""
    rows = len(columns["time_s"])
    first, last = np.sort(random.integers(0, max(rows, 1), 2))
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


def rows_of(columns: Columns, rows: np.ndarray) -> Columns:
    return {name: values[rows] for name, values in columns.items()}


def gap(columns: Columns, names: list[str], random: np.random.Generator) -> Columns:
    rows = np.ones(len(columns["time_s"]), bool)
    rows[some_rows(columns, random)] = False
    return rows_of(columns, np.flatnonzero(rows))


def cut(columns: Columns, names: list[str], random: np.random.Generator) -> Columns:
    return rows_of(columns, np.arange(int(len(columns["time_s"]) * random.random() ** 2)))


def doubled(columns: Columns, names: list[str], random: np.random.Generator) -> Columns:
    return rows_of(
        columns, np.sort(random.integers(0, max(len(columns["time_s"]), 1), len(columns["time_s"])))
    )


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
    "vanishing": of_columns(lambda x, r: 1e-300 * x, part=True),
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
    from sim.effects import HiddenEffect
    from sim.physics.rotors import read_pair
    from sim.quick.flight import FlightWorld, fly_quick, make_design
    from sim.vehicle import read_vehicle

    frame, rotors = EXAMPLES / "x8_demo.toml", EXAMPLES / "rotor_paper.toml"
    table = report_px4(load_vehicle(frame, rotors), "fitted").params
    weak = HiddenEffect("degraded_rotor", 0.1, 20.0, {"rotor": 3.0})
    made = make_design(read_vehicle(frame), read_pair(rotors), table)
    return fly_quick(made, FlightWorld((weak,), 1, "wander", 60.0), 8)[1]


def measured() -> Columns:
    """The stand log that is damaged."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stand.csv"
        command = [sys.executable, "-m", "coaxlink", "sim", "--stand", str(path), "--seed", "1"]
        subprocess.run([*command, "--truth", str(EXAMPLES / "truth_battery.toml")], check=True)
        table = np.genfromtxt(path, delimiter=",", names=True, deletechars="")
        return {name: np.asarray(table[name], float) for name in table.dtype.names}


Answer = Callable[[Path, "Samples | None", int], None]


def of_flights() -> Answer:
    """How a copy of the flight is answered: by its file or its columns, and its number."""
    from coaxlink.airframe import load_airframe
    from coaxlink.data import read_flight_log
    from coaxlink.residual import refine
    from coaxlink.residual.channels.flight import flight_frame
    from coaxlink.residual.faults.flight_faults import flight_suspects
    from coaxlink.rotor import load_rotor_model

    airframe = load_airframe(EXAMPLES / "x8_demo.toml")
    model = load_rotor_model(EXAMPLES / "rotor_paper.toml")

    def answer(path: Path, columns: Samples | None, through: int) -> None:
        log = columns or read_flight_log(path)
        if through:
            refine(log, airframe, model).to_json()
        else:
            flight_suspects(flight_frame([log], airframe, model), [log])

    return answer


def of_stands() -> Answer:
    """How a copy of the stand log is answered."""
    from coaxlink.data import read_stand_log
    from coaxlink.residual import refine_stand
    from coaxlink.rotor import load_rotor_model

    model = load_rotor_model(EXAMPLES / "rotor_paper.toml")

    def answer(path: Path, columns: Samples | None, through: int) -> None:
        log = columns or read_stand_log(path)
        if through:
            refine_stand(log, None if through % 3 == 0 else model).to_json()

    return answer


# changes that keep a clean log clean

LOADS = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")
MOST_ROWS = 1500  # of a log: time


def changed(columns: Columns, random: np.random.Generator) -> Iterator[tuple[str, Columns]]:
    """Names of changes, and the columns behind each."""

    def of_loads(change) -> Columns:  # type: ignore[no-untyped-def]
        return {n: change(c) if n in LOADS else c for n, c in columns.items()}

    def without(refused) -> Columns:  # type: ignore[no-untyped-def]
        return {n: c for n, c in columns.items() if not refused(n)}

    def is_context(name: str) -> bool:
        return name not in (*LOADS, "time_s") and not name.endswith(("_rpm", "_throttle"))

    rows = len(columns["time_s"])
    yield "no torque", without(lambda n: n.endswith("_torque_Nm"))
    yield "upper rotor alone", without(lambda n: n.startswith("lower_"))
    yield "no context", without(is_context)
    yield "no time", without(lambda n: n == "time_s")
    yield "coarse steps", of_loads(lambda c: np.round(c / (2e-3 * np.abs(c).max())) * 2e-3 * np.abs(c).max())
    yield "a thousandth", of_loads(lambda c: 1e-3 * c)
    hit = random.random(rows) < 0.01
    yield "spikes", {n: np.where(hit, 1.5 * c, c) if n == "upper_thrust_N" else c for n, c in columns.items()}
    order = random.permutation(rows)
    yield "shuffled", {n: c if n == "time_s" else c[order] for n, c in columns.items()}
    step = columns["time_s"][1] - columns["time_s"][0]
    doubled = {n: np.repeat(c, 2) for n, c in columns.items()}
    yield "doubled", {**doubled, "time_s": columns["time_s"][0] + 0.5 * step * np.arange(2 * rows)}
    yield "in pairs", {n: c[: rows // 2 * 2].reshape(-1, 2).mean(axis=1) for n, c in columns.items()}
    yield "middle", {n: c[rows // 4 : 3 * rows // 4] for n, c in columns.items()}


def shortened(columns: Columns, rows: int) -> Iterator[tuple[str, Columns]]:
    """As many rows, three ways."""
    every = len(columns["time_s"])
    for late in (0, 1):
        pick = np.linspace(0, every - 1 - late, rows).astype(int) + late
        yield f"{rows} rows", {n: c[pick] for n, c in columns.items()}
    yield f"{rows} rows", {n: c[every // 3 :][:rows] for n, c in columns.items()}


def clean_logs(folder: Path) -> Iterator[tuple[str, Path, Any]]:
    """Names, paths and rotor models of a folder's clean logs."""
    from coaxlink.rotor import load_rotor_model

    for name, truth in json.loads((folder / "truth.json").read_text()).items():
        if truth["kind"] == "clean" and isinstance(truth["log"], str):
            yield (
                name,
                folder / truth["log"],
                load_rotor_model(folder / truth["rotor"]) if truth["rotor"] else None,
            )


def claims(a: argparse.Namespace) -> None:
    """A row a change: what is claimed of logs that hold nothing."""
    from coaxlink.cli.shared.stand import Reading, read_stand
    from coaxlink.errors import InputError
    from coaxlink.residual import refine_stand

    as_written = Reading(None, None, None, sheet=None, trust_units=True)
    random = np.random.default_rng(a.seed)
    given, claimed, flagged, refused = (Counter[str]() for _ in range(4))
    for folder in a.changed:
        for name, path, model in clean_logs(folder):
            log = read_stand([path], as_written, lambda _: None)[0]
            if log.rows > MOST_ROWS:
                continue
            columns = {n: np.asarray(c) for n, c in log.columns.items()}
            pieces = [p for rows in a.rows for p in shortened(columns, rows)]
            for what, changes in [*changed(columns, random), *pieces]:
                if what == "a thousandth" and model is not None:
                    continue  # of another rotor
                given[what] += 1
                try:
                    answer = refine_stand([replace(log, columns=changes)], model)
                except InputError as error:
                    refused[what] += 1
                    print(f"{name}, {what}: {error}", flush=True)
                    continue
                names = [e.name for e in answer.effects] + ["/".join(x.names) for x in answer.ambiguous]
                claimed[what] += bool(names)
                flagged[what] += bool(answer.suspect_data)
                if names:
                    print(f"{name}, {what}: {', '.join(names)}", flush=True)
    print("| change | logs | claimed | columns flagged | refused |\n|---|---:|---:|---:|---:|")
    for what, count in given.items():
        print(f"| {what} | {count} | {claimed[what]} | {flagged[what]} | {refused[what]} |")


def main() -> int:
    """Print what became of the copies; 1 where one ended in a traceback."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--kind", action="append", choices=("stand", "flight"))
    parser.add_argument("--copies", type=int, default=200)
    parser.add_argument("--through", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--changed", type=Path, nargs="*", default=[])
    parser.add_argument("--rows", type=int, nargs="*", default=[16, 20, 28, 50])
    parser.add_argument("--small", action="store_true", help="a few copies, for CI")
    o = parser.parse_args()
    if o.changed:
        claims(o)
        return 0
    if o.small:
        o.copies, o.through, o.kind = 12, 3, ["stand"]
    warnings.simplefilter("error")
    bad = 0
    for kind in o.kind or ("stand", "flight"):
        made, answer = (measured(), of_stands()) if kind == "stand" else (flown(), of_flights())
        ends = damaged(made, answer, o.copies, o.through, o.seed)
        print(f"{kind}: " + ", ".join(f"{name} {count}" for name, count in ends.items()))
        bad += ends["traceback"]
    return 1 if bad else 0


def damaged(log: Columns, answer: Answer, copies: int, through: int, seed: int) -> Counter[str]:
    """How many copies of a log ended how."""
    from coaxlink.data import Samples
    from coaxlink.errors import CoaxlinkError

    ends = Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        for copy in range(copies):
            random = np.random.default_rng([seed, copy])
            columns, done = dict(log), []
            for _ in range(int(random.integers(1, 4))):
                kind = str(random.choice(list(DAMAGES)))
                names = [n for n in columns if n != "time_s"]
                chosen = random.choice(names, min(int(random.integers(1, 4)), len(names)), replace=False)
                columns = DAMAGES[kind](columns, [str(n) for n in chosen], random)
                done.append(f"{kind} {' '.join(chosen)}")
            path = Path(folder) / f"{copy}.csv"
            try:
                if copy % 2:  # as a binary log's reader hands them on: also with what a CSV may not have
                    given = Samples(columns, path.name)
                else:
                    rows, given = np.stack(list(columns.values()), axis=1), None
                    np.savetxt(path, rows, "%.9g", ",", header=",".join(columns), comments="")
                answer(path, given, copy + 1 if copy < through else 0)
                ends["answered" if copy < through else "looked through"] += 1
            except CoaxlinkError as error:
                ends["refused"] += 1
                assert "\n" not in str(error), error
            except Exception:
                ends["traceback"] += 1
                print(f"copy {copy}: {'; '.join(done)}\n{traceback.format_exc(limit=-3)}", flush=True)
    return ends


if __name__ == "__main__":
    raise SystemExit(main())
