"""What `refine` says of logs with known truths, author by author and kind by kind; and the decision's
numbers.

    python research/tracing.py SET... [--kind stand|flight] [--name NAME] [--only CASE,...] [--rows]
    python research/tracing.py SET... --against NAME    # rows: the answers of two methods side by side
    python research/tracing.py SET... --train coaxlink/residual/diagnosis/calibration.toml [--models open]
    python research/tracing.py SET... --picture F.svg    # the reliability diagram, also with --train
    python research/tracing.py SET... --kind flight --train .../diagnosis/calibration_flights.toml
    PYTHONPATH=../old python research/tracing.py SET... --name old    # another checkout
    python research/tracing.py --small

A SET is a folder with a `truth.json` (`../shared/worlds/closed1/stand`), or an author and seeds: `own:0-2`
and `sim:0-2` (`worlds/own.py`: our stands, the bench and the flights of `sim`), `board:0` (real autopilots on
the paper's vehicle, `../shared/data/flights`), `author6:1` (`worlds/author6`, the example of what a
generator is called with and writes), and where `../shared/worlds/authors` is, `one:11`, `two:3` and
`author3:1` to `author14:1` (its folders `three` to `fourteen`). What a generator writes is kept in
`--folder`, and so is every answer, under the method's hash or a name; the same command goes on.

Right: the names are the truth's or an accepted set; of an oddity nothing is named and something is
unexplained; of a fault something is suspect and nothing named; of an ambiguous log a group holds the names;
of a clean one nothing is said. False: a name that is in no accepted set. Silent: "nothing to mend" where
something is hidden; of these, `> 100` where the author's own oracle found more than 100 nats. After: the
largest error after over the true noise. `real` cases with a `reference` are judged on what their answer has
beside the reference's.

Ljung, System Identification (1999), 16.4, on validation; leave-one-author-out: no figure of the decision is
of logs whose author it was trained on.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import decision
from worlds.scores import Answer, Score, score, table
from worlds.sets import Log, logs_of

for threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(threads, "1")  # before numpy is imported


def answered(folder: Path, name: str, log: Log) -> Answer:
    """The answer of the coaxlink that is imported, kept; its failure."""
    kept = folder / "answers" / name / log.author / log.root.name / f"{log.case}.json"
    if kept.exists():
        return dict(json.loads(kept.read_text()))
    kept.parent.mkdir(parents=True, exist_ok=True)
    try:
        answer = _asked(log)
    except Exception:
        answer = {"failed": traceback.format_exc(limit=6)}
    draft = kept.with_suffix(f".{os.getpid()}")
    draft.write_text(json.dumps(answer))
    draft.replace(kept)
    return answer


def _asked(log: Log) -> Answer:
    from coaxlink.airframe import load_airframe
    from coaxlink.data import read_flight_log, read_stand_log
    from coaxlink.residual import refine, refine_stand
    from coaxlink.rotor import load_rotor_model

    rotor, airframe, path = log.file("rotor"), log.file("airframe"), log.file("log")
    assert path is not None
    model = load_rotor_model(rotor) if rotor else None
    start = time.process_time()  # wall time would count who else uses the machine
    if airframe is None:
        reported = refine_stand(read_stand_log(path), model)
    else:
        assert model is not None
        reported = refine(read_flight_log(path), load_airframe(airframe), model)
    seconds = time.process_time() - start
    out = dict(reported.to_json())
    out.pop("trace", None)
    return {**out, "seconds": seconds}


def method_hash() -> str:
    """Of everything that may change an answer."""
    import coaxlink

    digest = hashlib.sha256()
    for part in ("residual", "instruments", "channels", "evidence", "effects", "data", "rotor", "premises"):
        for path in sorted((Path(coaxlink.__file__).parent / part).rglob("*.*")):
            if path.suffix in (".py", ".toml"):
                digest.update(path.read_bytes())
    return digest.hexdigest()[:10]


def scored(logs: Sequence[Log], answer: Callable[[Log], Answer]) -> list[Score]:
    """Of logs whose answers are there."""
    answers = {(log.root, log.case): answer(log) for log in logs}
    out = []
    for log in logs:
        reference = log.truth.get("reference")
        out.append(score(log, answers[log.root, log.case], answers.get((log.root, reference))))
    return out


def row(s: Score) -> str:
    """Of the list."""
    verdict = "ok" if s.right == 1 else "half" if s.right else "WRONG"
    log_evidence = s.log.truth.get("llr_null")
    hidden = "+".join(s.log.truth["effects"]) or "-"
    form = s.log.truth.get("form") or s.log.truth.get("forms") or ""
    head = f"{s.log.author:15s} {s.log.case:24.24s} {s.log.sort:9s} {hidden} [{form}] {log_evidence or ''}"
    return f"{head} -> {s.reported} {verdict} {s.seconds:.1f}s"


def main() -> None:
    """Answer what is not yet answered, and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("sets", nargs="*")
    parser.add_argument("--small", action="store_true", help="a few worlds of our own, for CI")
    parser.add_argument("--kind", nargs="+", choices=("stand", "flight"), default=["stand", "flight"])
    parser.add_argument("--name", default="", help="of the method, instead of the hash of its source")
    parser.add_argument("--against", default="", help="the name of another method's answers")
    parser.add_argument("--only", default="", help="cases")
    parser.add_argument("--every", type=int, default=1, help="one log in so many")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--rows", action="store_true", help="a row a log")
    parser.add_argument("--kept", action="store_true", help="score what is answered already")
    parser.add_argument("--train", type=Path, metavar="F.toml", help="write the decision's numbers")
    parser.add_argument("--models", nargs="+", choices=("name", "open"), default=["name", "open"])
    parser.add_argument("--picture", type=Path, metavar="F.svg", help="the reliability diagram")
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "coaxlink-tracing")
    a = parser.parse_args()
    if a.small:
        a.folder, a.sets, a.kind = Path(tempfile.mkdtemp()), ["own:0"], ["stand"]
        a.only = "air_density-0,clean-0"
        a.picture = a.folder / "reliability.svg"
    only = a.only.split(",") if a.small else ()
    logs = [log for name in a.sets for log in logs_of(name, a.folder, a.kind, only)]
    logs = [log for k, log in enumerate(logs) if k % a.every == 0]
    if a.only:
        logs = [log for log in logs if log.case in a.only.split(",")]
    name = a.name or method_hash()
    if a.kept:
        there = a.folder / "answers" / name
        logs = [x for x in logs if (there / x.author / x.root.name / f"{x.case}.json").exists()]
    ask = partial(answered, a.folder, name)
    with ProcessPoolExecutor(a.jobs) as pool:
        for k, _ in enumerate(pool.map(ask, logs), 1):
            print(f"\r{k}/{len(logs)}", end="", file=sys.stderr, flush=True)
    scores = scored(logs, ask)
    if a.against:
        others = scored(logs, partial(answered, a.folder, a.against))
        for one, other in zip(scores, others, strict=True):
            if (one.right, one.wrong) != (other.right, other.wrong):
                print(f"{row(one)}\n{'':26s}{a.against}: {other.reported} ({other.right:g})")
        print(table(others))
    if a.train:
        answers = [ask(log) for log in logs]
        if a.kind == ["flight"]:
            decision.train_flights(logs, answers, a.train, a.picture, a.models)
        else:
            decision.train(logs, answers, a.train, a.picture, a.models)
    elif a.picture:
        decision.determined(logs, [ask(log) for log in logs], a.picture)
    if a.rows and not a.train:
        print("\n".join(row(s) for s in scores))
    print(table(scores))
    if a.small:
        assert len(scores) == 2 and all(s.right == 1.0 for s in scores), [s.reported for s in scores]


if __name__ == "__main__":
    main()
