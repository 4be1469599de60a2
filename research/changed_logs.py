"""Clean stand logs under changes that keep them clean: what is claimed all the same?

    python research/changed_logs.py ../shared/worlds/stand [FOLDER...] [--rows 16 20 28 50] [--seed 0]

FOLDER has `truth.json` with the logs of kind `clean`, and their rotor models, as `../shared/worlds` lays them
out. Of each log: its columns without torque, without the lower rotor, without anything but speeds and loads,
without time; loads in coarse steps, a thousandth as large, with spikes; rows shuffled, doubled, averaged in
pairs, from the middle; and, of `--rows` each, rows spread over the log, the same a row later, and neighbours.
Anything named, alone or as ambiguous, is a claim of what is not there; columns accused are counted apart.
"""

from __future__ import annotations

import argparse
import json
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from coaxlink.cli.shared.stand import StandOptions, read_stand
from coaxlink.errors import InputError
from coaxlink.residual import refine_stand
from coaxlink.rotor import RotorModel, load_rotor_model

LOADS = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")
MOST_ROWS = 1500  # of a log: time
AS_WRITTEN = StandOptions(None, None, None, sheet=None, trust_units=True)
Columns = dict[str, np.ndarray]


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


def clean_logs(folder: Path) -> Iterator[tuple[str, Path, RotorModel | None]]:
    """Names, paths and rotor models of a folder's clean logs."""
    for name, truth in json.loads((folder / "truth.json").read_text()).items():
        if truth["kind"] == "clean" and isinstance(truth["log"], str):
            yield (
                name,
                folder / truth["log"],
                load_rotor_model(folder / truth["rotor"]) if truth["rotor"] else None,
            )


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--rows", type=int, nargs="*", default=[16, 20, 28, 50])
    parser.add_argument("--seed", type=int, default=0)
    a = parser.parse_args()
    random = np.random.default_rng(a.seed)
    asked, claimed, accused, refused = (Counter[str]() for _ in range(4))
    for folder in a.folders:
        for name, path, model in clean_logs(folder):
            log = read_stand([path], AS_WRITTEN, lambda _: None)[0]
            if log.rows > MOST_ROWS:
                continue
            columns = {n: np.asarray(c) for n, c in log.columns.items()}
            pieces = [p for rows in a.rows for p in shortened(columns, rows)]
            for what, changes in [*changed(columns, random), *pieces]:
                if what == "a thousandth" and model is not None:
                    continue  # of another rotor
                asked[what] += 1
                try:
                    answer = refine_stand([replace(log, columns=changes)], model)
                except InputError as error:
                    refused[what] += 1
                    print(f"{name}, {what}: {error}", flush=True)
                    continue
                names = [e.name for e in answer.effects] + ["/".join(x.names) for x in answer.ambiguous]
                claimed[what] += bool(names)
                accused[what] += bool(answer.suspect_data)
                if names:
                    print(f"{name}, {what}: {', '.join(names)}", flush=True)
    print("| change | logs | claimed | columns accused | refused |\n|---|---:|---:|---:|---:|")
    for what, count in asked.items():
        print(f"| {what} | {count} | {claimed[what]} | {accused[what]} | {refused[what]} |")


if __name__ == "__main__":
    main()
