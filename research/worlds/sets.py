"""Sets of logs whose truth is known: an author's by seeds, which are written first, or a folder's.

Author six stays here as the example of what a generator is called with and writes; the other authors' are in
`../shared/worlds/authors`, where that is.
"""

from __future__ import annotations

import json
import lzma
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
EXAMPLES = HERE.parent.parent / "examples"
WORLDS = (HERE.parent.parent.parent / "shared" / "worlds").resolve()
KINDS = ("effect", "two", "odd", "fault", "ambiguous", "clean", "real")
GENERATORS = {"stand": "stand.py", "flight": "gen.py"}  # of author one
NUMBERS = (
    *("one", "two", "three", "four", "five", "six", "seven"),
    *("eight", "nine", "ten", "eleven", "twelve", "thirteen", "fourteen"),
)
Truth = dict[str, Any]


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
        at = root.relative_to(WORLDS) if root.is_relative_to(WORLDS) else Path(*root.parts[-2:])
        yield from _read(str(at), root, kinds)
        return
    author, _, reported = name.partition(":")
    first, _, last = reported.partition("-")
    if not first.isdecimal():
        sys.exit(f"tracing: '{name}' is no folder with a truth.json, and no author with seeds, as own:0-2")
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
        script = generator_of(author, GENERATORS[kind] if author == "one" else "generate.py")
        arguments = [str(seed)] if author == "one" else ["--kind", kind, "--seed", str(seed), "--out"]
        command = [sys.executable, str(script), *arguments, str(draft)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=script.parent)
    if not root.exists():
        draft.replace(root)


def generator_of(author: str, name: str) -> Path:
    """An author's script, ours first. Ends with one line where there is none."""
    number = author.removeprefix("author")
    word = NUMBERS[int(number) - 1] if number.isdecimal() and 0 < int(number) <= len(NUMBERS) else author
    places = [folder / name for folder in (HERE / author, WORLDS / "authors" / word)]
    for script in places:
        if script.exists():
            return script
    sys.exit(f"tracing: no author '{author}': {' or '.join(map(str, places))} is expected")


def _of_boards(root: Path) -> dict[str, Truth]:
    """Real firmware on the paper's vehicle, whose motors lag by 20 ms."""
    vehicle = (EXAMPLES / "x8_paper.toml").read_text()
    (root / "x8.toml").write_text(f"motor_lag_s = 0.02\n{vehicle}")
    shutil.copy(EXAMPLES / "rotor_paper.toml", root / "rotor_paper.toml")
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
    sys.path.insert(0, str(generator_of("two", f"{kind}.py").parent))
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
        shutil.copy(EXAMPLES / "rotor_paper.toml", root / "rotor.toml")
        shutil.copy(EXAMPLES / "rotor_paper.toml", root / "rotor_paper.toml")
        shutil.copy(EXAMPLES / "x8_paper.toml", root / "x8.toml")
    return truths


def _ours(author: str, kind: str, seed: int, root: Path, only: Collection[str]) -> dict[str, Truth]:
    """`own`: the stand of `worlds/own.py`; `sim`: the bench and the flights of `sim`, by its other laws."""
    import numpy as np
    from worlds import own as worlds

    from sim.flights import write_flight

    shutil.copy(EXAMPLES / "rotor_paper.toml", root / "rotor_paper.toml")
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
