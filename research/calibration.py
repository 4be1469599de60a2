"""Of the names that `refine` gave at probability p, how many were there: a reliability table and picture.

    python research/blind.py --first 3000 --seeds 20 --clean 20 --every 3 --folder F
    python research/calibration.py F/answers-HASH [--plot reliability.png] [--set TRUTH.json FOLDER]

Reads the answers that `blind.py` keeps, where a world's name is the truth
(`stand-other-drift+ground_effect-950`), and of graded sets the answers that `side_by_side.py` keeps: every
effect that is claimed and every name of a doubt (`ambiguous`) counts with its probability. Gneiting,
Balabdaoui and Raftery 2007 for what calibrated means; Wilson intervals.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

from blind_score import wilson

Answered = tuple[set[str], dict[str, Any]]  # what is there, the answer
EDGES = (0.0, 0.1, 0.35, 0.65, 0.9, 1.0 + 1e-9)


def blind_answers(folder: Path) -> Iterator[Answered]:
    """What `blind.py` hid and what was answered."""
    for path in sorted(folder.glob("*.json")):
        yield set(path.stem.split("-", 2)[2].rsplit("-", 1)[0].split("+")), json.loads(path.read_text())


def graded_answers(truth: Path, folder: Path) -> Iterator[Answered]:
    """What is right in a set's truth file and what was answered."""
    for case, known in json.loads(truth.read_text()).items():
        path = folder / f"{case}.json"
        if path.exists() and known["kind"] != "ambiguous":  # there, nobody knows which it is
            accepted = {name for names in known["accept"] for name in names}
            yield {*known["effects"], *accepted}, json.loads(path.read_text())


def weighed(answers: Iterable[Answered]) -> Iterator[tuple[float, bool, bool]]:
    """(probability, whether it is there, whether it was claimed) of every name of every answer."""
    for hidden, answer in answers:
        if "failed" in answer or "error" in answer:
            continue
        for effect in answer["effects"]:
            if "probability" in effect["evidence"]:  # a mass told by its torques is not weighed
                yield float(effect["evidence"]["probability"]), effect["name"] in hidden, True
        for doubt in answer["ambiguous"]:
            for name, p in zip(doubt["names"], doubt.get("probability", ()), strict=False):
                yield float(p), name in hidden, False


def bins(every: list[tuple[float, bool, bool]]) -> list[tuple[float, float, int, int, float]]:
    """(from, to, effects, there, mean probability) of every bin that holds any."""
    out = []
    for low, high in pairwise(EDGES):
        mine = [(p, there) for p, there, _ in every if low <= p < high]
        if mine:
            there, mean = sum(t for _, t in mine), sum(p for p, _ in mine) / len(mine)
            out.append((low, min(high, 1.0), len(mine), there, mean))
    return out


def main() -> None:
    """Print, and draw where asked."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("answers", type=Path, nargs="*")
    parser.add_argument("--set", type=Path, nargs=2, action="append", default=[])
    parser.add_argument("--plot", type=Path)
    a = parser.parse_args()
    answers = [x for folder in a.answers for x in blind_answers(folder)]
    answers += [x for truth, folder in a.set for x in graded_answers(truth, folder)]
    every = list(weighed(answers))
    rows = bins(every)
    print("| probability | effects weighed | there | share, 95 % | mean probability |")
    print("|---|---:|---:|---|---:|")
    for low, high, count, there, mean in rows:
        share = f"{100 * there / count:.1f} % ({interval(there, count)})"
        print(f"| {low:g} to {high:g} | {count} | {there} | {share} | {100 * mean:.2f} % |")
    claims = [there for _, there, claimed in every if claimed]
    share = interval(sum(claims), len(claims))
    print(f"\nclaimed {len(claims)}, there {sum(claims)} ({share} %), {len(answers)} worlds")
    if a.plot:
        draw(rows, a.plot)


def interval(good: int, count: int) -> str:
    """95 %, per cent."""
    return " to ".join(f"{100 * x:.1f}" for x in wilson(good, count))


def draw(rows: list[tuple[float, float, int, int, float]], target: Path) -> None:
    """Share there over mean probability, with its intervals."""
    from matplotlib.figure import Figure

    axis = (figure := Figure((4.5, 4.5))).subplots()
    axis.plot([0, 1], [0, 1], color="0.7")
    for _, _, count, there, mean in rows:
        low, high = wilson(there, count)
        axis.plot([mean, mean], [low, high], color="C0")
        axis.plot(mean, there / count, "o", color="C0")
    axis.set(xlabel="probability that refine gives a name", ylabel="share that is there (95 %)")
    axis.set(xlim=(0, 1), ylim=(0, 1))
    figure.savefig(target, dpi=120, bbox_inches="tight")


if __name__ == "__main__":
    main()
