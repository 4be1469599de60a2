"""Hidden against found: logs with an undeclared effect, fault or nothing in them, through `refine`.

    python research/blind.py [--seeds 20] [--clean 100] [--only NAME,...] [--kind stand|flight]
                               [--family other,same,law] [--every 2] [--jobs 2 | --scheduler ADDRESS]
                               [--folder F] [--json F] [--report]

Three rooms that share no code. *Worlds* (`blind_stand`, `blind_flight`, `sim`) write a log into F/logs and
the truth into F/truth. *Analysis* is given the log, and the rotor model and airframe where a user would have
them; its answer, the contract's JSON, goes to F/answers-HASH (of the method's source: another method answers
anew). *Scoring* reads truth and answers. A kill loses nothing; the same command goes on where it was.
Worlds run on the engine of `coaxlink campaign`: processes here, or a Dask cluster whose workers have this
folder on their PYTHONPATH.

Families: `same` is `sim` with its first laws, `law` is `sim` with other laws of the same physics, `other` a
stand written for this benchmark alone, with rigs, schedules, pairs and laws of its own.
Sizes run from 1 to 10 % of thrust: a fifth of the seeds below 3 %.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

from blind_cells import Wanted, numbered, work
from blind_score import table

from coaxlink.studies.campaign.engine import Machine, run

ROOT = Path(__file__).resolve().parents[1]


def method_hash() -> str:
    """Of everything that may change an answer."""
    digest = hashlib.sha256()
    for part in ("residual", "diagnosis", "effects", "data", "rotor"):
        for path in sorted((ROOT / "coaxlink" / part).rglob("*.py")):
            digest.update(path.read_bytes())
    digest.update(os.environ.get("COAXLINK_ENGINE", "").encode())
    return digest.hexdigest()[:10]


def write(path: Path, text: str) -> None:
    """A file that is there whole or not at all."""
    draft = path.with_suffix(f".{os.getpid()}")
    draft.write_text(text)
    draft.replace(path)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
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
    parser.add_argument("--method", default="", help="score the answers of another method's hash")
    a = parser.parse_args()
    answers = a.folder / f"answers-{a.method or method_hash()}"
    for part in (a.folder / "logs", a.folder / "truth", answers):
        part.mkdir(parents=True, exist_ok=True)
    wanted = Wanted(
        a.first,
        a.seeds,
        a.clean,
        a.only,
        tuple(a.kind),
        a.family,
        "" if a.scheduler else str(a.folder),
        not a.make,
    )
    todo = list(numbered(wanted))
    if not a.report:
        made_in = a.folder / "logs" if a.make else answers
        ending = ".task.json" if a.make else ".json"
        missing = [k for k, c in enumerate(todo) if not (made_in / f"{c.name}{ending}").exists()]
        missing = [k for k in missing if k % a.every == 0]
        for done in run(work, wanted, iter(missing), Machine(a.jobs, a.scheduler)):
            for name, truth, answer in zip(*(done.rows[c] for c in ("name", "truth", "answer")), strict=True):
                write(a.folder / "truth" / f"{name}.json", truth)
                if not a.make:
                    write(answers / f"{name}.json", answer)
            print(f"{done.rows['name'][-1]}", file=sys.stderr)
    if a.make:
        return
    text, numbers = table(todo, a.folder, answers)
    print(text)
    if a.failures:
        print(numbers["failures"])
    if a.json:
        a.json.write_text(json.dumps(numbers, indent=1))


if __name__ == "__main__":
    main()
