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
import lzma
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
import traceback
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

for threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

HERE = Path(__file__).resolve().parent
WORLDS = (HERE.parent.parent / "shared" / "worlds").resolve()
KINDS = ("effect", "two", "odd", "fault", "ambiguous", "clean", "real")
GENERATORS = {"stand": "stand.py", "flight": "gen.py"}  # of author one
NUMBERS = (
    *("one", "two", "three", "four", "five", "six", "seven"),
    *("eight", "nine", "ten", "eleven", "twelve", "thirteen", "fourteen"),
)
NATS = 100.0  # an oracle's: more must not be answered by silence
Truth = dict[str, Any]
Answer = dict[str, Any]


# sets of logs: an author's, or a folder's


@dataclass(frozen=True)
class Log:
    """A log with its truth."""

    author: str
    root: Path
    case: str
    truth: Truth

    @property
    def kind(self) -> str:
        """stand or flight."""
        return "flight" if self.truth.get("airframe") else "stand"

    @property
    def sort(self) -> str:
        """effect, two, odd, fault, ambiguous, clean or real."""
        return self.truth["kind"] if self.truth["kind"] in KINDS else "real"

    def file(self, what: str) -> Path | None:
        """A file that the truth names, unpacked where it is packed."""
        name = self.truth.get(what)
        if not name:
            return None
        path = self.root / name
        if path.exists():
            return path
        packed = path.with_name(path.name + ".xz")
        out = Path(tempfile.mkdtemp()) / path.name
        with lzma.open(packed) as source, out.open("wb") as target:
            shutil.copyfileobj(source, target)
        return out


def logs_of(name: str, folder: Path, kinds: Sequence[str], only: Collection[str] = ()) -> Iterator[Log]:
    """The logs of a set; what a generator would write is written first."""
    if (Path(name) / "truth.json").exists():
        root = Path(name).resolve()
        at = root.relative_to(WORLDS) if root.is_relative_to(WORLDS) else Path(root.name)
        yield from _read(str(at), root, kinds)
        return
    author, _, said = name.partition(":")
    first, _, last = said.partition("-")
    for seed in range(int(first), int(last or first) + 1):
        for kind in kinds:
            root = folder / "worlds" / f"{author}-{kind}-{seed}"
            if not (root / "truth.json").exists():
                write_worlds(author, kind, seed, root, only)
            yield from _read(f"{author}/{kind}", root, kinds)


def _read(author: str, root: Path, kinds: Sequence[str]) -> Iterator[Log]:
    for case, truth in json.loads((root / "truth.json").read_text()).items():
        log = Log(author, root, case, truth)
        if log.kind in kinds:
            yield log


def write_worlds(author: str, kind: str, seed: int, root: Path, only: Collection[str] = ()) -> None:
    """Have an author's generator write a seed's logs and truths into a folder."""
    draft = root.with_name(f"{root.name}.{os.getpid()}")
    shutil.rmtree(draft, ignore_errors=True)
    draft.mkdir(parents=True)
    if author in ("own", "sim"):
        truths = _ours(author, kind, seed, draft, only)
        (draft / "truth.json").write_text(json.dumps(truths))
    elif author == "board":
        truths = _of_boards(draft) if kind == "flight" else {}
        (draft / "truth.json").write_text(json.dumps(truths))
    elif author == "two":
        truths = _of_two(kind, seed, draft)
        (draft / "truth.json").write_text(json.dumps(truths))
    else:
        script, arguments = generator_of(author), ["--kind", kind, "--seed", str(seed), "--out"]
        if author == "one":
            script, arguments = WORLDS / "authors" / "one" / GENERATORS[kind], [str(seed)]
        command = [sys.executable, str(script), *arguments, str(draft)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=script.parent)
    if not root.exists():
        draft.replace(root)


def generator_of(author: str) -> Path:
    """The script of author3 to author14, ours first. Ends with one line where there is none."""
    number = author.removeprefix("author")
    word = NUMBERS[int(number) - 1] if number.isdecimal() and 0 < int(number) <= len(NUMBERS) else author
    places = [folder / "generate.py" for folder in (HERE / "worlds" / author, WORLDS / "authors" / word)]
    for script in places:
        if script.exists():
            return script
    sys.exit(f"tracing: no author '{author}': {' or '.join(map(str, places))} is expected")


def _of_boards(root: Path) -> dict[str, Truth]:
    """Real firmware on the paper's vehicle, whose motors lag by 20 ms."""
    examples = HERE.parent / "examples"
    vehicle = (examples / "x8_paper.toml").read_text()
    (root / "x8.toml").write_text(f"motor_lag_s = 0.02\n{vehicle}")
    shutil.copy(examples / "rotor_paper.toml", root / "rotor_paper.toml")
    found = {"px4_null_fitted.ulg": [], "ap_null.bin": [], "px4_rotor_drag.ulg": ["rotor_drag"]}
    return {
        log.split(".")[0]: {
            "log": str(WORLDS.parent / "data" / "flights" / log),
            "kind": "effect" if hidden else "clean",
            "effects": hidden,
            "accept": [],
            "airframe": "x8.toml",
            "rotor": "rotor_paper.toml",
        }
        for log, hidden in found.items()
    }


def _of_two(kind: str, seed: int, root: Path) -> dict[str, Truth]:
    sys.path.insert(0, str(WORLDS / "authors" / "two"))
    generator = __import__(kind)
    sys.path.pop(0)
    truths = {}
    for case in generator.NAMES:
        try:
            noise = generator.write(case, seed, root / f"{case}.csv")
        except RuntimeError:  # a vehicle that was lost
            continue
        hidden = list(generator.CASES[case][0] if kind == "stand" else generator.CASES[case])
        sort = ("clean", "effect", "two")[len(hidden)]
        if hidden == ["unexplained"]:
            sort, hidden = "odd", []
        elif hidden and hidden[0].startswith("ambiguous:"):
            sort, hidden = "ambiguous", hidden[0].split(":")[1].split("|")
        truths[case] = {"log": f"{case}.csv", "kind": sort, "effects": hidden, "accept": []}
        if kind == "flight":
            truths[case] |= {"airframe": "x8.toml", "rotor": "rotor.toml"}
        else:
            truths[case] |= {"rotor": None, "noise": noise}
    if kind == "flight":
        examples = HERE.parent / "examples"
        shutil.copy(examples / "rotor_paper.toml", root / "rotor.toml")
        shutil.copy(examples / "rotor_paper.toml", root / "rotor_paper.toml")
        shutil.copy(examples / "x8_paper.toml", root / "x8.toml")
    return truths


def _ours(author: str, kind: str, seed: int, root: Path, only: Collection[str]) -> dict[str, Truth]:
    """`own`: the stand of `worlds/own.py`; `sim`: the bench and the flights of `sim`, by its other laws."""
    import numpy as np
    from worlds import own as worlds

    from sim.flights import write_flight

    examples = HERE.parent / "examples"
    shutil.copy(examples / "rotor_paper.toml", root / "rotor_paper.toml")
    if kind == "stand":
        hidden = [(n,) for n in (worlds.STAND if author == "own" else worlds.BENCH)]
        hidden += list(worlds.STAND_DOUBLES if author == "own" else worlds.BENCH_DOUBLES)
    elif author == "own":
        return {}
    else:
        hidden = [*((n,) for n in worlds.WORTH), *worlds.FLIGHT_DOUBLES]
        hidden += [(n,) for n in (*worlds.FLIGHT_FAULTS, *worlds.FLIGHT_STRANGE)]
    hidden += [()] * 4
    truths = {}
    for k, names in enumerate(hidden):
        number = seed if names else 4 * seed + k % 4
        worth = worlds.worth_of(number)
        case = f"{'+'.join(names) or 'clean'}-{number}"
        drawn = kind == "stand" or all(n in worlds.WORTH for n in names)
        if only and case not in only:
            continue
        law = "law" if drawn and worlds.has_other_law(kind, names) else "same"
        truth: Truth = {"log": f"{case}.csv", "rotor": None, "accept": []}
        if kind == "flight":
            made = worlds.make_flight(names, number, worth, law, root)
            write_flight(root / f"{case}.csv", made.columns)
            (root / f"{case}.airframe.toml").write_text(made.airframe)
            truth["airframe"] = f"{case}.airframe.toml"
        else:
            made = worlds.make_stand(names, number, worth) if author == "own" or not names else None
            made = made or worlds.make_bench(names, number, worth, law)
            rows = np.column_stack([np.asarray(v, float) for v in made.columns.values()])
            heading = ",".join(made.columns)
            np.savetxt(root / truth["log"], rows, fmt="%.8g", delimiter=",", header=heading, comments="")
        sigma = made.truth.get("sigma")
        if isinstance(sigma, dict):
            truth["noise"] = {name.rsplit("_", 1)[0]: s for name, s in sigma.items()}
        odd, fault = (
            bool(names) and names[0].startswith("strange"),
            bool(names) and names[0] in worlds.FAULTS,
        )
        sort = "odd" if odd else "fault" if fault else ("clean", "effect", "two")[len(names)]
        effects = [] if odd or fault else list(names)
        truth |= {"kind": sort, "effects": effects, "rotor": made.rotor, "worth": made.truth.get("worth")}
        truths[case] = truth
    return truths


# answers: each log once by a method


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
        said = refine_stand(read_stand_log(path), model)
    else:
        assert model is not None
        said = refine(read_flight_log(path), load_airframe(airframe), model)
    seconds = time.process_time() - start
    out = dict(said.to_json())
    out.pop("trace", None)
    return {**out, "seconds": seconds}


def method_hash() -> str:
    """Of everything that may change an answer."""
    import coaxlink

    digest = hashlib.sha256(os.environ.get("COAXLINK_ENGINE", "").encode())
    for part in ("residual", "effects", "data", "rotor", "premises"):
        for path in sorted((Path(coaxlink.__file__).parent / part).rglob("*.*")):
            if path.suffix in (".py", ".toml"):
                digest.update(path.read_bytes())
    return digest.hexdigest()[:10]


# scoring


@dataclass(frozen=True)
class Score:
    """How an answer compares with the truth."""

    log: Log
    right: float
    wrong: frozenset[str]  # names that are not there
    silent: bool
    over: float  # error after over the true noise, of the worst channel
    seconds: float
    said: str
    names: tuple[str, ...] = ()

    @property
    def missed(self) -> bool:
        """Silent where the author's oracle found more than 100 nats."""
        return self.silent and float(self.log.truth.get("llr_null") or 0.0) > NATS


def names_of(answer: Answer) -> frozenset[str]:
    """That are claimed."""
    return frozenset(e["name"] for e in answer.get("effects", []))


def accepted(truth: Truth) -> list[frozenset[str]]:
    """Sets of names that are right, without words for other answers."""
    words = {"unexplained", "suspect_data", "suspect", "ambiguous", "nothing"}
    sets = [truth["effects"], *(truth.get("accept") or [])]
    return [frozenset(s) - words for s in sets if not isinstance(s, str)]


def score(log: Log, answer: Answer, reference: Answer | None = None) -> Score:
    """The answer held against the truth, as `../shared/worlds/grade.py` does."""
    t, nan = log.truth, float("nan")
    if "failed" in answer:
        last = answer["failed"].strip().splitlines()[-1][:100]
        return Score(log, 0.0, frozenset(), False, nan, nan, f"FAILED {last}")
    found = names_of(answer)
    groups = [frozenset(n.split(" of ")[0] for n in a["names"]) for a in answer["ambiguous"]]
    open_ends, suspects = answer["unexplained"], answer["suspect_data"]
    if reference is not None and "failed" not in reference:
        found = found - (names_of(reference) - set(t["effects"]))
        had = {(u["channel"], tuple(u["depends_on"])) for u in reference["unexplained"]}
        open_ends = [u for u in open_ends if (u["channel"], tuple(u["depends_on"])) not in had]
        lies = {(s["column"], s["why"]) for s in reference["suspect_data"]}
        suspects = [s for s in suspects if (s["column"], s["why"]) not in lies]
    silent = not (found or groups or open_ends or suspects or answer.get("cannot_judge"))
    silent = silent and not answer.get("not_this_vehicle") and log.sort != "clean"
    right, wrong = _verdict(log, found, groups, bool(open_ends), bool(suspects))
    over, noise = nan, t.get("noise")
    if isinstance(noise, dict):
        ratios = [
            answer["channels"][c]["rmse_after"] / s for c, s in noise.items() if c in answer["channels"] and s
        ]
        over = max(ratios, default=nan)
    said = " + ".join(sorted(found)) or "nothing"
    said += "".join(f" ({' / '.join(sorted(g))})" for g in groups)
    said += "".join(f"; unexplained {u['channel']} over {', '.join(u['depends_on'])}" for u in open_ends[:1])
    said += "".join(f"; suspect {s['column']}" for s in suspects[:1])
    said += "; cannot judge" if answer.get("cannot_judge") or answer.get("not_this_vehicle") else ""
    return Score(log, right, wrong, silent, over, answer["seconds"], said, tuple(sorted(found)))


def _verdict(
    log: Log, found: frozenset[str], groups: list[frozenset[str]], is_open: bool, suspect: bool
) -> tuple[float, frozenset[str]]:
    t, sets = log.truth, accepted(log.truth)
    truth = frozenset(t["effects"])
    if log.sort == "real":
        wrong, together = found - truth - frozenset(t.get("accept") or []), found.union(*groups)
        if truth:
            right = 1.0 if truth <= found else 0.5 * (truth <= together)
        else:
            right = float(suspect if t.get("suspect") else is_open if t.get("unexplained") else True)
        return (0.0 if wrong else right), wrong
    words = {w for a in t.get("accept") or [] for w in a}
    wrong = found - frozenset().union(*sets)
    if log.sort == "clean":
        right = float(not (found or groups or suspect or is_open))
    elif log.sort == "odd":
        right = float((not found and is_open) or (bool(found) and found in sets[1:]))
    elif log.sort == "fault":
        right = float(not found and (suspect or ("unexplained" in words and is_open) or "nothing" in words))
    elif log.sort == "ambiguous":
        right = float(
            (any(truth <= g for g in groups) and not wrong) or (len(sets) > 1 and found in sets[1:])
        )
    else:
        right = float(found in sets) if found else float("unexplained" in words and is_open)
        if not right and any(truth & g for g in groups) and found <= truth.union(*groups):
            right = 0.5
    return right, wrong


def table(scores: Sequence[Score]) -> str:
    """A row an author, rates by kind."""
    by: dict[str, list[Score]] = defaultdict(list)
    for s in scores:
        by[s.log.author].append(s)
    lines = [
        f"{'author':18s}"
        + "".join(f"{k:>12s}" for k in KINDS)
        + "   right  false silent >100  after   s (95 %)"
    ]
    for author, mine in [*sorted(by.items()), *([("all", list(scores))] if len(by) > 1 else [])]:
        cells = []
        for kind in KINDS:
            own = [s.right for s in mine if s.log.sort == kind]
            cells.append(f"{sum(own):g}/{len(own)}" if own else "")
        overs = sorted(s.over for s in mine if s.over == s.over)
        seconds = sorted(s.seconds for s in mine if s.seconds == s.seconds) or [float("nan")]
        lines.append(
            f"{author:18s}"
            + "".join(f"{c:>12s}" for c in cells)
            + f"{100 * sum(s.right for s in mine) / len(mine):7.1f}%{sum(bool(s.wrong) for s in mine):7d}"
            + f"{sum(s.silent for s in mine):7d}{sum(s.missed for s in mine):5d}"
            + (f"{statistics.median(overs):7.2f}" if overs else "       ")
            + f"{statistics.median(seconds):6.1f} ({seconds[int(0.95 * (len(seconds) - 1))]:.0f})"
        )
    return "\n".join(lines)


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
    nats = s.log.truth.get("llr_null")
    hidden = "+".join(s.log.truth["effects"]) or "-"
    form = s.log.truth.get("form") or s.log.truth.get("forms") or ""
    head = f"{s.log.author:15s} {s.log.case:24.24s} {s.log.sort:9s} {hidden} [{form}] {nats or ''}"
    return f"{head} -> {s.said} {verdict} {s.seconds:.1f}s"


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
                print(f"{row(one)}\n{'':26s}{a.against}: {other.said} ({other.right:g})")
        print(table(others))
    if a.train:
        import decision

        answers = [ask(log) for log in logs]
        if a.kind == ["flight"]:
            decision.train_flights(logs, answers, a.train, a.picture, a.models)
        else:
            decision.train(logs, answers, a.train, a.picture, a.models)
    elif a.picture:
        import decision

        decision.told(logs, [ask(log) for log in logs], a.picture)
    if a.rows and not a.train:
        print("\n".join(row(s) for s in scores))
    print(table(scores))
    if a.small:
        assert len(scores) == 2 and all(s.right == 1.0 for s in scores), [s.said for s in scores]


if __name__ == "__main__":
    main()
