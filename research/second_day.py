"""What `refine` says of real stand maps whose truth nobody wrote: against their own model, another day's,
another spacing's, and of one rotor alone.

    python research/second_day.py [FOLDER] [--only u5] [--small]

FOLDER is the shared data's `coax` (default: ../shared/data/coax beside the repository). Of each map:

own      the model that `identify` makes of the map, held against the map itself: nothing is there
none     the map without a model: nothing is there
halves   the model of every second row, held against the others: nothing is there
day      the map's model against a separate run of the same pair and spacing
spacing  the map's model against the pair's next spacing: the wake is another one
alone    a pair's model against one of its rotors alone: what the stand of the pair did not measure

Prints a row a case and counts. In `own`, `none` and `halves` nothing differs but noise: a name is false. In
`day`, `spacing` and `alone` a name is printed to be looked at: lag, heat and play are not what differs.

`--small` takes seconds: the map of blades that `real_pairs.py` makes, against its own model and by halves;
exit 1 where an effect is named.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from real_pairs import made_map

from coaxlink.data import Samples, read_stand_log
from coaxlink.errors import InputError
from coaxlink.residual import Refinement, refine_stand
from coaxlink.rotor import RotorModel, identify

HERE = Path(__file__).resolve().parent
SWEEP = 10  # rows of the maps' inner levels
Case = tuple[str, str, RotorModel | None, Samples]  # kind, what, model, log


def read(path: Path) -> Samples:
    """A log of the shared data; on the platform of Buzzatto and Liarokapis left is the upper rotor."""
    return read_stand_log(path, upper="left" if re.match("mn4014|propdrive|u5", path.name) else None)


def model_of(log: Samples) -> RotorModel:
    """As `identify` writes it."""
    return identify(log).model


def cases(folder: Path, only: str = "") -> Iterator[Case]:
    """Of every map of a folder."""
    maps = sorted(folder.glob("*_zD*.csv"), key=lambda p: (p.name.split("_zD")[0], spacing(p)))
    maps = [p for p in maps if re.search(r"_zD\d+$", p.stem) and only in p.stem]
    for k, path in enumerate(maps):
        log, pair = read(path), path.name.split("_zD")[0]
        model = model_of(log)
        yield "own", path.stem, model, log
        yield "none", path.stem, None, log
        odd = (np.arange(log.rows) + np.arange(log.rows) // SWEEP) % 2 == 1  # as a chessboard
        yield "halves", path.stem, model_of(log.take(~odd)), log.take(odd)
        for other in sorted(folder.glob(f"{path.stem}_*.csv")):
            yield "day", other.stem, model, read(other)
        if k + 1 < len(maps) and maps[k + 1].name.startswith(f"{pair}_zD"):
            yield "spacing", f"{path.stem} <- {maps[k + 1].stem}", model, read(maps[k + 1])
        for other in sorted(folder.glob(f"{pair}_*alone.csv")) if k % 3 == 0 else ():
            yield "alone", f"{path.stem} <- {other.stem}", model, read(other)


def spacing(path: Path) -> float:
    """z/D, of a map's name: 055 is 0.55, 1 is 1."""
    digits = re.search(r"_zD(\d+)", path.stem)
    assert digits is not None
    return float(f"{digits[1][0]}.{digits[1][1:] or 0}")


def reported(answer: Refinement) -> str:
    """In one cell."""
    out = [e.name for e in answer.effects]
    out += [" / ".join(a.names) for a in answer.ambiguous]
    out += ["suspect " + ", ".join(s.column for s in answer.suspect_data)] * bool(answer.suspect_data)
    out += ["unexplained " + ", ".join(u.channel for u in answer.unexplained)] * bool(answer.unexplained)
    return "; ".join(out) or "nothing"


def main() -> int:
    """Ask and print; 1 where the small map has a name."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path, default=HERE.parents[1] / "shared" / "data" / "coax")
    parser.add_argument("--only", default="", help="maps with this in their names")
    parser.add_argument("--small", action="store_true", help="a map of our own, for CI")
    a = parser.parse_args()
    scratch = tempfile.TemporaryDirectory()
    if a.small:
        a.folder = Path(scratch.name)
        made_map(a.folder / "made_zD07.csv")
    if not a.folder.is_dir():
        sys.exit(f"second_day: no folder {a.folder}: the shared data's maps are expected")
    named: Counter[str] = Counter()
    for kind, what, model, log in cases(a.folder, a.only):
        begun = time.process_time()
        try:
            answer = refine_stand(log, model)
        except InputError as error:
            print(f"{kind:8s} {what:52s} refused: {error.problem[:60]}", flush=True)
            named[f"{kind} refused"] += 1
            continue
        print(f"{kind:8s} {what:52s} {reported(answer)}  {time.process_time() - begun:.1f} s", flush=True)
        named[f"{kind} asked"] += 1
        named[f"{kind} named"] += bool(answer.effects or answer.ambiguous)
        named[f"{kind} unexplained"] += bool(answer.unexplained)
    print(dict(sorted(named.items())))
    return int(a.small and (named["own asked"] == 0 or named["own named"] + named["halves named"] > 0))


if __name__ == "__main__":
    sys.exit(main())
