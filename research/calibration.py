"""What coaxlink names of nothing in noise with a colour.

    python research/calibration.py [--logs 25] [--seed 0]
    python research/calibration.py --small

Own blind stands without anything hidden, and on every load noise of one colour, one to three times the white
noise's rms; anything but "nothing" is counted.
"""

from __future__ import annotations

import argparse
import itertools
import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.signal import lfilter

from coaxlink.data import Samples
from coaxlink.errors import InputError
from coaxlink.residual import refine_stand
from coaxlink.rotor import load_rotor_model

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
Array = np.ndarray
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
SMALL = ("ringing", "wandering")  # what an answer costs hangs on what it finds: these two are seconds


def coloured(name: str, seed: int, number: int) -> tuple[dict[str, Array], str | None, str]:
    """Columns, the rotor file that is given, and what was added to each load."""
    from worlds.own import make_stand

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
    counts = {name: Counter[str]() for name in (SMALL if a.small else COLOURS)}
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
    parser.add_argument("--logs", type=int, default=25, help="of each colour")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--small", action="store_true", help="a log of two colours, for CI")
    a = parser.parse_args()
    if a.small:
        a.logs = 1
    colours(a)


if __name__ == "__main__":
    main()
