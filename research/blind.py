"""Hidden against found: logs with an undeclared effect, fault or nothing in them, through `refine`.

    python research/blind.py [--small] [--seeds 20] [--clean 100] [--only NAME,...] [--kind stand|flight]
                             [--family other,same,law] [--every 2] [--jobs 2 | --scheduler ADDRESS]
                             [--folder F] [--json F] [--report] [--failures]
    PYTHONPATH=../old python research/blind.py --folder F --answer old

Three parts that share nothing but files. *Worlds* (`blind_worlds`, `sim`) write a log into F/logs and the
truth into F/truth. *Analysis* is given the log, and the rotor model and airframe where a user would have
them; its answer, the contract's JSON, goes to F/answers-HASH (of the method's source: another method answers
anew). *Scoring* reads truth and answers. A kill loses nothing; the same command goes on where it was. Worlds
run on the engine of `coaxlink campaign`: processes here, or a Dask cluster whose workers have this folder on
their PYTHONPATH. `--answer NAME` answers the worlds that are there by whatever coaxlink is imported;
`--report --method NAME` scores that.

Families: `same` is `sim` with its first laws, `law` is `sim` with other laws of the same physics, `other` a
stand written for this alone. Sizes run from 1 to 10 % of thrust: a fifth of the seeds below 3 %.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import statistics
import sys
import tempfile
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parents[1]
FAULTS = {
    "lying_tachometer", "swapped_labels", "stuck_cell", "repeated_batch",
    "swapped_motors", "stuck_accel", "reversed_gyro", "repeated_stretch",
}  # fmt: skip
SMALL = 0.03  # of thrust: below it an effect may be missed


@dataclass(frozen=True)
class Case:
    """One hidden world."""

    kind: str  # stand, flight
    family: str  # other, same, law
    hidden: tuple[str, ...]
    seed: int

    @property
    def name(self) -> str:
        """Of its files."""
        return f"{self.kind}-{self.family}-{'+'.join(self.hidden) or 'clean'}-{self.seed}"

    @property
    def sort(self) -> str:
        """single, double, fault, strange or clean."""
        if not self.hidden:
            return "clean"
        if self.hidden[0].startswith("strange"):
            return "strange"
        if self.hidden[0] in FAULTS:
            return "fault"
        return "single" if len(self.hidden) == 1 else "double"

    @property
    def worth(self) -> float:
        """Share of thrust of its effects: one seed in five below 3 %, the others 3 to 10 %."""
        seed = self.seed
        if seed % 5 == 4:
            return 0.01 + 0.02 * (seed // 5 % 4) / 3.5
        k = 7 * (seed // 5 * 4 + seed % 5) % 16  # out of order, so that a few seeds are a fair sample
        return SMALL * (10.0 / 3.0) ** (k / 15.0)


# worlds


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
def cases(a: Wanted) -> tuple[Case, ...]:
    """Every world that is wanted, seed by seed, so that a part of the run is a fair part."""
    return tuple(_cases(a))


def _cases(a: Wanted) -> Iterator[Case]:
    import blind_worlds as worlds

    only, families = set(filter(None, a.only.split(","))), set(a.family.split(","))
    stand = [*((n,) for n in worlds.STAND), *worlds.STAND_DOUBLES]
    bench = [*((n,) for n in worlds.BENCH), *worlds.BENCH_DOUBLES]
    physics = [*((n,) for n in worlds.WORTH), *worlds.FLIGHT_DOUBLES]
    spoiled = [(n,) for n in (*worlds.FLIGHT_FAULTS, *worlds.FLIGHT_STRANGE)]
    groups = [("stand", "other", h) for h in stand]
    groups += [("stand", f, h) for f in ("same", "law") for h in bench]
    groups += [("flight", f, h) for f in ("same", "law") for h in physics]
    groups += [("flight", "same", h) for h in spoiled]
    for s in range(a.first, a.first + max(a.seeds, a.clean)):
        for kind, family, hidden in groups:
            wanted = "+".join(hidden) in only if only else True
            requested = kind in a.kind and family in families and s < a.first + a.seeds
            if wanted and requested and (family != "law" or worlds.has_other_law(kind, hidden)):
                yield Case(kind, family, hidden, s)
        for kind, family in (("stand", "other"), ("flight", "same")):
            if kind in a.kind and (not only or "clean" in only) and s < a.first + a.clean:
                yield Case(kind, family, (), s)


def work(a: Wanted, numbers: Sequence[int]) -> list[dict[str, object]]:
    """Rows of these worlds, for `coaxlink.studies.engine.run`: made if it is not there, and answered."""
    rows: list[dict[str, object]] = []
    for number in numbers:
        case = cases(a)[number]
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(a.folder or scratch)
            task = folder / "logs" / f"{case.name}.task.json"
            if not task.exists():
                make(case, folder)
            answer = answered(task) if a.analysed else {}
            truth = (folder / "truth" / f"{case.name}.json").read_text()
        rows.append({"cell": number, "name": case.name, "truth": truth, "answer": json.dumps(answer)})
    return rows


def make(case: Case, folder: Path) -> None:
    """A log and a task for the guest, the truth for the judge."""
    import blind_worlds as worlds
    import numpy as np

    from sim.flights import write_flight

    logs, secrets = folder / "logs", folder / "truth"
    for part in (logs, secrets):
        part.mkdir(parents=True, exist_ok=True)
    task: dict[str, object] = {"kind": case.kind, "log": f"{case.name}.csv"}
    log = logs / f"{case.name}.csv"
    if case.kind == "flight":
        made = worlds.make_flight(case.hidden, case.seed, case.worth, case.family, secrets)
        write_flight(log, made.columns)
        task["airframe"] = f"{case.name}.airframe.toml"
        (logs / f"{case.name}.airframe.toml").write_text(made.airframe)
    else:
        if case.family == "other":
            made = worlds.make_stand(case.hidden, case.seed, case.worth)
        else:
            made = worlds.make_bench(case.hidden, case.seed, case.worth, case.family)
        rows = np.column_stack([np.asarray(v, float) for v in made.columns.values()])
        np.savetxt(log, rows, fmt="%.8g", delimiter=",", header=",".join(made.columns), comments="")
    (secrets / f"{case.name}.json").write_text(json.dumps(made.truth))
    write(logs / f"{case.name}.task.json", json.dumps(task | {"rotor": made.rotor}))


def write(path: Path, text: str) -> None:
    """A file that is there whole or not at all."""
    draft = path.with_suffix(f".{os.getpid()}")
    draft.write_text(text)
    draft.replace(path)


# analysis: no world is imported, another checkout has others


def answered(task: Path) -> dict[str, Any]:
    """What coaxlink says of a task's log, and the seconds of processor that it took; its failure."""
    try:
        return _analysed(json.loads(task.read_text()), task.parent)
    except Exception:
        return {"failed": traceback.format_exc(limit=4)}


def _analysed(task: dict[str, str | None], logs: Path) -> dict[str, Any]:
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
        beside = logs / "rotor_paper.toml"
        if not beside.exists():
            beside.write_text(files.example("rotor_paper.toml").read_text())
        assert model is not None
        answer = refine(read_flight_log(log), load_airframe(logs / str(task["airframe"])), model)
    out = answer.to_json()
    out.pop("trace", None)
    return {**out, "seconds": time.process_time() - start}


def answer_all(folder: Path, name: str) -> None:
    """Answers of whatever coaxlink is imported to the worlds that are there."""
    answers = folder / f"answers-{name}"
    answers.mkdir(exist_ok=True)
    for task in sorted((folder / "logs").glob("*.task.json")):
        kept = answers / task.name.replace(".task", "")
        if not kept.exists():
            write(kept, json.dumps(answered(task)))


def method_hash() -> str:
    """Of everything that may change an answer."""
    digest = hashlib.sha256()
    for part in ("residual", "diagnosis", "effects", "data", "rotor"):
        for path in sorted((ROOT / "coaxlink" / part).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:10]


# scoring: neither world nor guest


@dataclass(frozen=True)
class Score:
    """How one answer compares with the truth."""

    case: Case
    worth: float
    right: bool
    alarm: bool  # an effect that is not there
    said: str
    floor: float  # worst channel after over its noise floor, as reported
    seconds: float
    world: str  # what the judge knows of the rig or the flight

    @property
    def large(self) -> bool:
        """Whether it has to be found."""
        return self.worth >= SMALL - 1e-9 or self.case.sort in ("clean", "fault")


def score(case: Case, truth: dict[str, Any], answer: dict[str, Any]) -> Score:
    """Right means: these effects, no others, nothing left ambiguous, no instrument flagged."""
    worth = float(truth.get("worth", 0.0))
    world = ", ".join(f"{k} {v}" for k, v in truth.items() if k not in ("told", "sigma", "worth"))
    world += " | " + " ".join(str(truth.get("told", "")).split())
    if "failed" in answer:
        last = answer["failed"].strip().splitlines()[-1][:90]
        return Score(case, worth, False, False, f"FAILED {last}", math.nan, math.nan, world)
    found = tuple(sorted(e["name"] for e in answer["effects"]))
    doubts = ["/".join(a["names"]) for a in answer["ambiguous"]]
    suspects, open_ends = answer["suspect_data"], answer["unexplained"]
    right = {
        "clean": not (found or doubts or suspects),
        "strange": not found and not doubts and bool(open_ends) and not suspects,
        "fault": not found and bool(suspects),
    }.get(case.sort, found == tuple(sorted(case.hidden)) and not doubts and not suspects)
    said = "+".join(found) or "nothing"
    said += f" (ambiguous {', '.join(doubts)})" if doubts else ""
    said += f" ({len(suspects)} suspect: {suspects[0]['column']})" if suspects else ""
    said += " (unexplained)" if open_ends else ""
    channels = answer["channels"].values()
    floor = max(
        (c["rmse_after"] / c["noise_floor"] for c in channels if c["noise_floor"] > 0), default=math.nan
    )
    alarm = bool(set(found) - set(case.hidden))
    return Score(case, worth, right, alarm, said, floor, answer["seconds"], world)


def wilson(good: int, count: int) -> tuple[float, float]:
    """95 % interval of a rate (Wilson 1927)."""
    if not count:
        return 0.0, 1.0
    z, p = 1.96, good / count
    middle, half = p + z * z / (2 * count), z * math.sqrt(p * (1 - p) / count + z * z / (4 * count * count))
    return (middle - half) / (1 + z * z / count), (middle + half) / (1 + z * z / count)


def rate(scores: Sequence[Score]) -> str:
    """In words."""
    good = sum(s.right for s in scores)
    low, high = wilson(good, len(scores))
    return f"{100 * good / max(len(scores), 1):5.1f} % ({100 * low:.1f} to {100 * high:.1f}) of {len(scores)}"


def report(scores: Sequence[Score]) -> tuple[str, dict[str, Any]]:
    """The tables and their numbers: a row a hidden thing, then rates by kind, sort and family."""
    lines = [
        f"{'kind':6s} {'family':6s} {'hidden':46s} {'>= 3 %':>8s} {'< 3 %':>7s} {'floor':>6s} {'CPU s':>5s}"
    ]
    groups: dict[tuple[str, str, str], list[Score]] = defaultdict(list)
    for s in scores:
        groups[s.case.kind, s.case.family, " + ".join(s.case.hidden) or "clean"].append(s)
    for (kind, family, hidden), mine in groups.items():
        lines.append(f"{kind:6s} {family:6s} {hidden:46s} {_row(mine)}")
    rates: dict[str, Any] = {}
    for kind in ("stand", "flight"):
        for sort in ("single", "double", "fault", "strange", "clean"):
            every = [s for s in scores if s.case.kind == kind and s.case.sort == sort]
            families = sorted({s.case.family for s in every})
            for family in [*families, *(["all"] if len(families) > 1 else [])]:
                mine = [s for s in every if family in ("all", s.case.family)]
                big, small = [s for s in mine if s.large], [s for s in mine if not s.large]
                alarms = sum(s.alarm for s in mine)
                text = f"{kind} {sort} {family}: right {rate(big)}"
                text += f"; below 3 %: {rate(small)}" if small else ""
                lines.append(f"{text}; an effect that is not there: {alarms}/{len(mine)}")
                rates[f"{kind} {sort} {family}"] = {
                    "right": sum(s.right for s in big), "of": len(big), "alarms": alarms, "all": len(mine),
                    "small_right": sum(s.right for s in small), "small_of": len(small),
                }  # fmt: skip
    wrong = [s for s in scores if not s.right]
    failures = [f"{s.case.name}: worth {100 * s.worth:.1f} %, said {s.said}; {s.world}" for s in wrong]
    plain = [{**vars(s), "case": s.case.name} for s in scores]
    return "\n".join(lines), {"rates": rates, "cases": plain, "failures": failures}


def _row(mine: Sequence[Score]) -> str:
    big, small = [s for s in mine if s.large], [s for s in mine if not s.large]
    other = Counter(s.said for s in big if not s.right)
    shown = "; ".join(f"{n} x {said}" for said, n in other.most_common(4))
    floor, seconds = (
        statistics.median(values) if (values := [v for v in each if not math.isnan(v)]) else math.nan
        for each in ([s.floor for s in mine], [s.seconds for s in mine])
    )
    rates = f"{sum(s.right for s in big)}/{len(big)}", f"{sum(s.right for s in small)}/{len(small)}"
    return f"{rates[0]:>8s} {rates[1]:>7s} {floor:6.2f} {seconds:5.1f}  {shown}"


def scored(todo: Sequence[Case], folder: Path, answers: Path) -> list[Score]:
    """Of whatever has been answered."""
    found = []
    for case in todo:
        truth, said = folder / "truth" / f"{case.name}.json", answers / f"{case.name}.json"
        if said.exists():
            known = json.loads(truth.read_text()) if truth.exists() else {}
            found.append(score(case, known, json.loads(said.read_text())))
    return found


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--small", action="store_true", help="three worlds in a folder of their own, for CI")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--clean", type=int, default=100, help="clean logs, of each kind")
    parser.add_argument("--only", default="", help="names; doubles as A+B; clean")
    parser.add_argument("--kind", nargs="+", choices=("stand", "flight"), default=["stand", "flight"])
    parser.add_argument("--family", default="other,same,law")
    parser.add_argument("--every", type=int, default=1, help="only every so many worlds of these, all seeds")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--scheduler", help="of a Dask cluster, instead of processes here")
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "coaxlink-blind")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--report", action="store_true", help="score what is there, run nothing")
    parser.add_argument("--make", action="store_true", help="make the worlds only")
    parser.add_argument("--failures", action="store_true", help="list every wrong answer with its world")
    parser.add_argument("--method", default="", help="score the answers of this name")
    parser.add_argument("--answer", default="", help="answer the worlds that are there, under this name")
    a = parser.parse_args()
    if a.answer:
        answer_all(a.folder, a.answer)
        return
    if a.small:
        a.folder, a.seeds, a.clean = Path(tempfile.mkdtemp()), 1, 1
        a.only, a.kind, a.family = "air_density,clean", ["stand"], "other,same"
    answers = a.folder / f"answers-{a.method or method_hash()}"
    for part in (a.folder / "truth", answers):
        part.mkdir(parents=True, exist_ok=True)
    kept = "" if a.scheduler else str(a.folder)
    wanted = Wanted(a.first, a.seeds, a.clean, a.only, tuple(a.kind), a.family, kept, not a.make)
    todo = cases(wanted)
    if not a.report:
        from coaxlink.studies.engine import Machine, run

        there, ending = (a.folder / "logs", ".task.json") if a.make else (answers, ".json")
        missing = [k for k, c in enumerate(todo) if not (there / f"{c.name}{ending}").exists()]
        missing = [k for k in missing if k % a.every == 0]
        for rows in run(work, wanted, missing, Machine(a.jobs, a.scheduler)):
            for row in rows:
                write(a.folder / "truth" / f"{row['name']}.json", row["truth"])
                if not a.make:
                    write(answers / f"{row['name']}.json", row["answer"])
                print(row["name"], file=sys.stderr)
    if a.make:
        return
    scores = scored(todo, a.folder, answers)
    text, numbers = report(scores)
    print(f"{len(scores)} of {len(todo)} answered\n{text}")
    if a.failures:
        print("\n".join(numbers["failures"]))
    if a.json:
        a.json.write_text(json.dumps(numbers, indent=1))
    if a.small:
        assert len(scores) == len(todo) == 3 and not any(s.said.startswith("FAILED") for s in scores)
        assert not any(s.alarm for s in scores)


if __name__ == "__main__":
    main()
