"""Whether what coaxlink says of its own certainty is so: names, noise with a colour.

    python research/blind.py --first 3000 --seeds 20 --clean 20 --every 3 --folder F
    python research/calibration.py names F/answers-HASH [--plot reliability.png] [--set TRUTH.json FOLDER]
    python research/calibration.py colours [--logs 25] [--seed 0]
    python research/calibration.py --small

*names*: of the names that `refine` gave at probability p, how many were there. Reads the answers that
`blind.py` keeps, where a world's name is the truth, and of graded sets the answers that `authors.py` keeps:
every effect that is claimed and every name of a doubt (`ambiguous`) counts with its probability (Gneiting,
Balabdaoui and Raftery 2007; Wilson intervals). *colours*: own blind stands without anything hidden, and on
every load noise of one colour, one to three times the white noise's rms; anything but "nothing" is counted.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from blind import wilson
from scipy.signal import lfilter

from coaxlink.data import Samples
from coaxlink.errors import InputError
from coaxlink.residual import refine_stand
from coaxlink.rotor import load_rotor_model

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
Array = np.ndarray

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


def names(a: argparse.Namespace) -> None:
    """The reliability table; the picture where one is named."""
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


Colour = Callable[[dict[str, Array], np.random.Generator], tuple[Array, str]]


def autoregressive(columns: dict[str, Array], random: np.random.Generator) -> tuple[Array, str]:
    """First order, settled before the first row."""
    share = random.uniform(0.3, 0.95)
    noise = lfilter([1.0], [1.0, -share], random.standard_normal(len(columns["time_s"]) + 200))[200:]
    return noise, f"{share:.2f}"


def ringing(columns: dict[str, Array], random: np.random.Generator) -> tuple[Array, str]:
    """A damped cell that rings at 0.05 to 0.4 of the rows' rate."""
    turn, radius = 2 * np.pi * random.uniform(0.05, 0.4), random.uniform(0.8, 0.97)
    poles = [1.0, -2 * radius * np.cos(turn), radius**2]
    noise = lfilter([1.0], poles, random.standard_normal(len(columns["time_s"]) + 400))[400:]
    return noise, f"{turn / 2 / np.pi:.2f} of the rate, {radius:.2f}"


def aliased(columns: dict[str, Array], random: np.random.Generator) -> tuple[Array, str]:
    """Once a revolution, seen between the rows; the rotor's speed wanders by a part in a thousand."""
    time = columns["time_s"]
    rate = 90.0 * (0.3 + 0.7 * np.abs(columns["upper_thrust_N"]) / np.abs(columns["upper_thrust_N"]).max())
    turns = np.cumsum(rate * np.gradient(time) * (1.0 + 1e-3 * random.standard_normal(len(time))))
    return np.sin(2 * np.pi * turns), ""


def wandering(columns: dict[str, Array], random: np.random.Generator) -> tuple[Array, str]:
    """A cell's zero that goes to and fro ten times or so a log."""
    rows = len(columns["time_s"])
    share = 1.0 - 20.0 / rows
    return lfilter([1.0], [1.0, -share], random.standard_normal(2 * rows))[rows:], ""


COLOURS: dict[str, Colour] = {
    "autoregressive": autoregressive,
    "ringing": ringing,
    "aliased": aliased,
    "wandering": wandering,
}


def coloured(name: str, seed: int, number: int) -> tuple[dict[str, Array], str | None, str]:
    """Columns, the rotor file that is given, and what was added to each load."""
    from blind_worlds import make_stand

    kind = list(COLOURS).index(name)
    world = make_stand((), 100_000 * (seed + 1) + number * len(COLOURS) + kind, 0.0)
    random = np.random.default_rng([seed, number, kind])
    columns, words = dict(world.columns), []
    for load, white in world.truth["sigma"].items():  # type: ignore[attr-defined]
        noise, word = COLOURS[name](world.columns, random)
        size = random.uniform(0.5, 1.0) if name == "wandering" else random.uniform(1.0, 3.0)
        columns[load] = columns[load] + size * white * noise / np.std(noise)
        words.append(f"{size:.1f} {word}")
    return columns, world.rotor, "; ".join(words)


def colours(a: argparse.Namespace) -> None:
    """What is said of clean logs with coloured noise."""
    counts = {name: Counter[str]() for name in COLOURS}
    for number, (name, count) in itertools.product(range(a.logs), counts.items()):
        columns, rotor, words = coloured(name, a.seed, number)
        log, model = (
            Samples(columns, f"{name} {number}"),
            load_rotor_model(EXAMPLES / rotor) if rotor else None,
        )
        try:
            answer = refine_stand([log], model)
        except InputError as error:
            count["refused"] += 1
            print(error, flush=True)
            continue
        said = {
            "named": [e.name for e in answer.effects] + ["/".join(x.names) for x in answer.ambiguous],
            "unexplained": [f"{u.channel} over {', '.join(u.depends_on)}" for u in answer.unexplained],
            "suspect": [s.column for s in answer.suspect_data],
        }
        count["nothing"] += not any(said.values())
        for kind, what in said.items():
            count[kind] += bool(what)
            if what:
                print(f"{name} {number} ({log.rows} rows; {words}): {kind} {'; '.join(what)}", flush=True)
    kinds = ("nothing", "named", "unexplained", "suspect", "refused")
    print(f"| noise | logs | {' | '.join(kinds)} |\n|---|{len(kinds) * '---|'}---|")
    for name, count in counts.items():
        print(f"| {name} | {a.logs} | {' | '.join(str(count[kind]) for kind in kinds)} |")
    assert not a.small or not any(count["named"] for count in counts.values())


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=("names", "colours"), nargs="?", default="colours")
    parser.add_argument("answers", type=Path, nargs="*")
    parser.add_argument("--set", type=Path, nargs=2, action="append", default=[])
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--logs", type=int, default=25, help="of each colour")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--small", action="store_true", help="a log of each colour, for CI")
    a = parser.parse_args()
    if a.small:
        a.logs = 1
    {"names": names, "colours": colours}[a.what](a)


if __name__ == "__main__":
    main()
