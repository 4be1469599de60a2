"""The work of `blind.py`, a world a cell: made, asked, and both handed back as JSON.

A room of its own so that every worker, of this machine or of a Dask cluster, can import it. Worlds and
analysis share nothing but the log and the files a user would have.
"""

from __future__ import annotations

import json
import os
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import blind_flight
import blind_sim
import blind_stand
from blind_guest import analyse
from blind_score import Case


@dataclass(frozen=True)
class Wanted:
    """Which worlds; `folder` keeps logs and truths ("": nothing is kept, as on a cluster)."""

    first: int
    seeds: int
    clean: int
    only: str
    kind: tuple[str, ...]
    family: str
    folder: str
    analysed: bool = True


@lru_cache(1)
def numbered(a: Wanted) -> tuple[Case, ...]:
    """Every world asked for: its number is its cell."""
    return tuple(cases(a))


def work(a: Wanted, numbers: Sequence[int]) -> dict[str, list[object]]:
    """Rows of these cells, for `coaxlink.studies.campaign.engine.run`."""
    rows: dict[str, list[object]] = {"cell": [], "name": [], "truth": [], "answer": []}
    for number in numbers:
        case = numbered(a)[number]
        with tempfile.TemporaryDirectory() as scratch:
            truth, answer = run(case, Path(a.folder or scratch), a.analysed)
        for column, value in zip(rows, (number, case.name, truth, answer), strict=True):
            rows[column].append(value)
    return rows


def run(case: Case, folder: Path, analysed: bool) -> tuple[str, str]:
    """(truth, answer) of a world, made if it is not there."""
    truth = folder / "truth" / f"{case.name}.json"
    answer: dict[str, object] = {}
    try:
        task = folder / "logs" / f"{case.name}.task.json"
        for part in (task.parent, truth.parent):
            part.mkdir(parents=True, exist_ok=True)
        if not task.exists():
            make(case, folder)
        if analysed:
            answer = analyse(json.loads(task.read_text()), task.parent)
    except Exception:
        answer = {"failed": traceback.format_exc(limit=4)}
    return truth.read_text() if truth.exists() else "", json.dumps(answer)


def worth_of(seed: int) -> float:
    """Share of thrust of a seed's effects: one in five below 3 %, the others 3 to 10 %."""
    if seed % 5 == 4:
        return 0.01 + 0.02 * (seed // 5 % 4) / 3.5
    k = 7 * (seed // 5 * 4 + seed % 5) % 16  # out of order, so that a few seeds are a fair sample
    return 0.03 * (10.0 / 3.0) ** (k / 15.0)


def cases(a: Wanted) -> Iterator[Case]:
    """Every world asked for, seed by seed, so that a part of the run is a fair part."""
    only, families = set(filter(None, a.only.split(","))), set(a.family.split(","))
    stand = [*((n,) for n in blind_stand.ALL), *blind_stand.DOUBLES]
    bench = [*((n,) for n in blind_sim.ALL), *blind_sim.DOUBLES]
    physics = [*((n,) for n in blind_flight.WORTH), *blind_flight.DOUBLES]
    spoiled = [(n,) for n in (*blind_flight.FAULTS, *blind_flight.STRANGE)]
    groups = [("stand", "other", h) for h in stand] + [
        ("stand", f, h) for f in ("same", "law") for h in bench
    ]
    groups += [("flight", f, h) for f in ("same", "law") for h in physics] + [
        ("flight", "same", h) for h in spoiled
    ]
    for s in range(a.first, a.first + max(a.seeds, a.clean)):
        for kind, family, hidden in groups:
            wanted = "+".join(hidden) in only if only else True
            requested = kind in a.kind and family in families and s < a.first + a.seeds
            if wanted and requested and (family != "law" or has_law(kind, hidden)):
                yield Case(kind, family, hidden, s)
        for kind, family in (("stand", "other"), ("flight", "same")):
            if kind in a.kind and (not only or "clean" in only) and s < a.first + a.clean:
                yield Case(kind, family, (), s)


def has_law(kind: str, hidden: tuple[str, ...]) -> bool:
    """Whether the world knows another law for one of these."""
    from sim.truth import FORMS

    if kind == "stand":
        return blind_sim.has_law(hidden)
    return any(len(getattr(FORMS[n], "laws", ())) > 1 for n in hidden)


def make(case: Case, folder: Path) -> None:
    """The world's room: a log and a task for the guest, the truth for the judge."""
    from sim.flights import write_flight

    logs, secrets = folder / "logs", folder / "truth"
    task: dict[str, object] = {"kind": case.kind, "log": f"{case.name}.csv", "rotor": None}
    worth = worth_of(case.seed)
    if case.kind == "flight":
        flown = blind_flight.make(case.hidden, case.seed, worth, case.family, secrets)
        write_flight(logs / f"{case.name}.csv", flown.columns)
        task["airframe"] = f"{case.name}.airframe.toml"
        (logs / f"{case.name}.airframe.toml").write_text((secrets / flown.airframe).read_text())
        task["rotor"], truth = "rotor_paper.toml", flown.truth
    else:
        world = blind_stand if case.family == "other" else blind_sim
        made = world.make(case.hidden, case.seed, worth, *(() if case.family == "other" else (case.family,)))
        write_columns(logs / f"{case.name}.csv", made.columns)
        task["rotor"], truth = made.rotor, made.truth
    (secrets / f"{case.name}.json").write_text(json.dumps(truth))
    (logs / f"{case.name}.task.json").write_text(json.dumps(task))


def write_columns(path: Path, columns: dict[str, object]) -> None:
    """A CSV of six significant digits or better."""
    import numpy as np

    rows = np.column_stack([np.asarray(v, float) for v in columns.values()])
    np.savetxt(path, rows, fmt="%.8g", delimiter=",", header=",".join(columns), comments="")
