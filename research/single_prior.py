"""What a prior says of real pairs before any coaxial measurement, against their stands: docs/no_stand.md.

    python research/single_prior.py [FOLDER] [--write]

FOLDER defaults to ../shared/data/coax beside the repository. For every pair: a table of one of its rotors
alone, its size and spacing, `coaxlink identify --single`; then the coaxial stand log, of which the prior saw
nothing. Where no single-rotor table exists, the map's own rows with the other rotor at idle make one.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from coaxlink.data import Samples, read_stand_log
from coaxlink.data.single import STAND, SingleTable, read_single_table
from coaxlink.rotor.model import LOADS
from coaxlink.rotor.prior import PairPrior, Propeller, pair_prior

HERE = Path(__file__).resolve().parent
PAGE = HERE.parent / "docs" / "no_stand.md"
MARKS = ("<!-- begin: research/single_prior.py -->", "<!-- end: research/single_prior.py -->")
INCH = 0.0254
IDLE = 0.13  # of the fastest: the platform's idle rows run at a tenth
RATIO = (0.5, 1.4)  # upper over lower speed: where vehicles fly
FAST = 0.4  # of the highest speed, the faster of both
NORMAL_95 = 1.96


@dataclass(frozen=True)
class Pair:
    """A real pair, its propeller as it is sold, and its logs by spacing over diameter."""

    name: str
    diameter_in: float
    pitch_in: float | None
    single: str | None  # file of one rotor alone
    logs: dict[float, str]


SPACINGS = {0.55: "055", 0.7: "07", 0.85: "085", 1.0: "1"}
PAIRS = (
    Pair(
        "MN4014, 16.2 x 5.3 in", 16.2, 5.3, None,
        {z: f"mn4014_16in_zD{name}.csv" for z, name in SPACINGS.items()},
    ),
    Pair(
        "PropDrive, 11 in, pitch not known", 11.0, None, "propdrive_11in_upper_alone.csv",
        {z: f"propdrive_11in_zD{name}.csv" for z, name in SPACINGS.items()},
    ),
    Pair(
        "T-Motor 28 x 9.2 in", 28.0, 9.2, "tmotor28_data.csv", {0.115 / 0.7112: "tmotor28_coaxial_data.csv"}
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One load of one log."""

    pair: str
    spacing: float
    load: str
    unit: str
    measured: float  # at equal speeds, of a rotor alone: share
    said: float
    half: float
    rmse: float  # of the prior over the working rows, share of the largest load
    without: float  # of two rotors that do not disturb each other
    inside: float  # share of working rows inside the 95 % interval
    rows: int


def read(path: Path) -> Samples:
    """A coaxial log; on the platform of Buzzatto and Liarokapis left is the upper rotor."""
    return read_stand_log(path, upper=None if path.name.startswith("tmotor") else "left")


def alone(pair: Pair, folder: Path, log: Samples) -> SingleTable:
    """The table of one rotor: its own file, or the upper rotor's rows with the lower one at idle."""
    if pair.single is not None and pair.single.startswith("tmotor"):
        return read_single_table(folder / pair.single, pair.diameter_in * INCH)
    source = log if pair.single is None else read(folder / pair.single)
    upper, lower = source["upper_rpm"], source["lower_rpm"]
    rows = (lower < IDLE * upper.max()) & (upper > 2 * IDLE * upper.max())
    columns = (source[name][rows] for name in ("upper_rpm", "upper_thrust_N", "upper_torque_Nm"))
    rpm, thrust, torque = columns
    return SingleTable(rpm, thrust, torque, None, STAND, source.source)


def compared(pair: Pair, folder: Path) -> Iterator[Row]:
    """Every load of every log of a pair against its prior."""
    for spacing, name in pair.logs.items():
        log = read(folder / name)
        table = alone(pair, folder, log)
        pitch = None if pair.pitch_in is None else pair.pitch_in * INCH
        size = pair.diameter_in * INCH
        prior = pair_prior(table, Propeller(size, spacing * size, pitch))
        yield from _rows(pair, spacing, log, prior)


def _rows(pair: Pair, spacing: float, log: Samples, prior: PairPrior) -> Iterator[Row]:
    top = prior.model.speed_max_rpm
    u, v = log["upper_rpm"] / top, log["lower_rpm"] / top
    ratio = u / np.maximum(v, 1e-9)
    working = (ratio > RATIO[0]) & (ratio < RATIO[1]) & (np.maximum(u, v) > FAST * max(u.max(), v.max()))
    equal = working & (np.abs(ratio - 1) < 0.1)
    pairs, single = prior.model.loads(u, v), prior.model.loads(v, 0.0 * v)
    own = {"upper": prior.model.loads(u, 0.0 * u), "lower": single}
    for load in LOADS:
        side, quantity = load.split(".")
        field = f"{side}_{quantity.split('_')[0]}"
        measured, said = log[f"{side}_{quantity}"], getattr(pairs, field)
        free = getattr(own[side], f"upper_{quantity.split('_')[0]}")
        spread = prior.spread(load, u, v)
        largest = float(np.abs(measured[working]).max())
        off = measured - said
        yield Row(
            pair.name, spacing, load, "N" if quantity.endswith("N") else "N m",
            float(np.median(measured[equal] / free[equal])),
            float(np.median(said[equal] / free[equal])),
            NORMAL_95 * float(np.median(spread[equal] / free[equal])),
            float(np.sqrt(np.mean(off[working] ** 2))) / largest,
            float(np.sqrt(np.mean((measured - free)[working] ** 2))) / largest,
            float(np.mean(np.abs(off[working]) < NORMAL_95 * spread[working])),
            int(working.sum()),
        )  # fmt: skip


HEAD = (
    "| pair | z/D | load | stand | prior said | its error | of two rotors alone | rows inside |",
    "|---|---:|---|---:|---:|---:|---:|---:|",
)
NOTES = (
    "*Stand* and *prior said* are at equal speeds, as shares of what one such rotor gives alone by the",
    "prior; the prior's interval is its 95 %. *Its error* is the RMSE over the rows with the upper",
    "rotor at 0.5 to 1.4 of the lower one's speed and one of them above 0.4 of full, as a share of the",
    "largest load among them; *of two rotors alone*: the table used for both, no wake. *Inside*: rows",
    "within the prior's 95 % interval.",
)


def section(folder: Path) -> str:
    """The section of the page, in Markdown."""
    found = [row for pair in PAIRS for row in compared(pair, folder)]
    lines = [*NOTES, "", *HEAD]
    for r in found:
        name = r.load.replace(".", " ").split("_")[0]
        lines.append(
            f"| {r.pair} | {r.spacing:.2f} | {name} | {r.measured:.2f} | {r.said:.2f} +/- {r.half:.2f} | "
            f"{100 * r.rmse:.1f} % | {100 * r.without:.1f} % | {100 * r.inside:.0f} % of {r.rows} |"
        )
    lines.append("")
    for load in LOADS:
        rows = [r for r in found if r.load == load]
        inside = sum(r.inside * r.rows for r in rows) / sum(r.rows for r in rows)
        equal = sum(abs(r.measured - r.said) <= r.half for r in rows)
        name = load.replace(".", " ").split("_")[0]
        lines.append(
            f"- {name}: {100 * inside:.0f} % of the rows inside, at equal speeds {equal} of {len(rows)} "
            f"logs; errors {_range([r.rmse for r in rows])}, "
            f"two rotors alone {_range([r.without for r in rows])}"
        )
    return "\n".join([*lines, ""])


def _range(shares: list[float]) -> str:
    return f"{100 * min(shares):.1f} to {100 * max(shares):.1f} %"


def write(text: str) -> None:
    """Put the section between its marks; the rest of the page stays."""
    page = PAGE.read_text(encoding="utf-8")
    before, rest = page.split(MARKS[0], 1)
    PAGE.write_text(before + f"{MARKS[0]}\n{text}" + MARKS[1] + rest.split(MARKS[1], 1)[1], encoding="utf-8")


def main(arguments: list[str]) -> int:
    """Print the section, or write it into the page."""
    folders = [Path(a) for a in arguments if not a.startswith("--")]
    folder = folders[0] if folders else HERE.parent.parent / "shared" / "data" / "coax"
    if not folder.is_dir():
        print(f"{folder} is not there: name the folder of the stand data", file=sys.stderr)
        return 2
    text = section(folder)
    print(text)
    if "--write" in arguments:
        write(text)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
