"""Hidden against found: logs with an undeclared effect, fault or nothing in them, through `refine`.

    python benchmarks/blind.py [--seeds 20] [--clean 100] [--only NAME,...] [--kind stand|flight]
                               [--family other,same,law] [--jobs 2] [--folder F] [--json F] [--report]

Three rooms that share no code. *Worlds* (`blind_stand`, `blind_flight`, `sim`) write a log into F/logs and
the truth into F/truth. *Analysis* is given the log, and the rotor model and airframe where a user would have
them; its answer, the contract's JSON, goes to F/answers-HASH (of the method's source: another method answers
anew). *Scoring* reads truth and answers. A kill loses nothing; the same command goes on where it was.

Families: `same` is `sim` with its first laws, `law` is `sim` with other laws of the same physics, `other` a
stand written for this benchmark alone, with rigs, schedules, pairs and laws of its own.
Sizes run from 1 to 10 % of thrust: a fifth of the seeds below 3 %.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import tempfile
import time
import traceback
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import blind_flight
import blind_sim
import blind_stand
from blind_score import Case, table

ROOT = Path(__file__).resolve().parents[1]


def worth_of(seed: int) -> float:
    """Share of thrust of a seed's effects: one in five below 3 %, the others 3 to 10 %."""
    if seed % 5 == 4:
        return 0.01 + 0.02 * (seed // 5 % 4) / 3.5
    k = 7 * (seed // 5 * 4 + seed % 5) % 16  # out of order, so that a few seeds are a fair sample
    return 0.03 * (10.0 / 3.0) ** (k / 15.0)


def cases(a: argparse.Namespace) -> Iterator[Case]:
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
            asked = kind in a.kind and family in families and s < a.first + a.seeds
            if wanted and asked and (family != "law" or has_law(kind, hidden)):
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


def method_hash() -> str:
    """Of everything that may change an answer."""
    digest = hashlib.sha256()
    for part in ("residual", "data", "rotor"):
        for path in sorted((ROOT / "coaxlink" / part).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:10]


def run(case: Case, folder: Path, answers: Path) -> str:
    """Make the world if it is not there, ask, keep the answer."""
    target = answers / f"{case.name}.json"
    if target.exists():
        return ""
    try:
        task = folder / "logs" / f"{case.name}.task.json"
        if not task.exists():
            make(case, folder)
        answer = analyse(json.loads(task.read_text()), folder / "logs")
    except Exception:
        answer = {"failed": traceback.format_exc(limit=4)}
    draft = target.with_suffix(f".{os.getpid()}")
    draft.write_text(json.dumps(answer))
    draft.replace(target)
    return case.name


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


def analyse(task: dict[str, str | None], logs: Path) -> dict[str, object]:
    """The guest's room: a log, and the files a user would have."""
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.data import read_flight_log, read_stand_log
    from coaxlink.residual import refine, refine_stand
    from coaxlink.rotor import load_rotor_model

    log = logs / str(task["log"])
    model = load_rotor_model(files.example(task["rotor"])) if task["rotor"] else None
    start = time.process_time()  # wall time would count who else uses the machine
    if task["kind"] == "stand":
        answer = refine_stand(read_stand_log(log), model)
    else:
        text = logs / str(task["airframe"])
        beside = logs / "rotor_paper.toml"
        if not beside.exists():
            beside.write_text(files.example("rotor_paper.toml").read_text())
        assert model is not None
        answer = refine(read_flight_log(log), load_airframe(text), model)
    out = answer.to_json()
    out.pop("trace", None)
    return {**out, "seconds": time.process_time() - start}


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--clean", type=int, default=100, help="clean logs, of each kind")
    parser.add_argument("--only", default="", help="names; doubles as A+B; clean")
    parser.add_argument("--kind", nargs="+", choices=("stand", "flight"), default=["stand", "flight"])
    parser.add_argument("--family", default="other,same,law")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "coaxlink-blind")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--report", action="store_true", help="score what is there, run nothing")
    parser.add_argument("--make", action="store_true", help="make the worlds only")
    parser.add_argument("--failures", action="store_true", help="list every wrong answer with its world")
    parser.add_argument("--method", default="", help="score the answers of another method's hash")
    a = parser.parse_args()
    answers = a.folder / f"answers-{a.method or method_hash()}"
    for part in (a.folder / "logs", a.folder / "truth", answers):
        part.mkdir(parents=True, exist_ok=True)
    todo = list(cases(a))
    if a.make:
        todo = [c for c in todo if not (a.folder / "logs" / f"{c.name}.task.json").exists()]
        with ProcessPoolExecutor(a.jobs) as pool:
            for _ in pool.map(make, todo, [a.folder] * len(todo)):
                pass
        return
    if not a.report:
        with ProcessPoolExecutor(a.jobs) as pool:
            for _ in pool.map(run, todo, [a.folder] * len(todo), [answers] * len(todo)):
                pass
    text, numbers = table(todo, a.folder, answers)
    print(text)
    if a.failures:
        print(numbers["failures"])
    if a.json:
        a.json.write_text(json.dumps(numbers, indent=1))


if __name__ == "__main__":
    main()
