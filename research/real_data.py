"""Rotor models on real data: what `coaxlink identify` says, against stands and flights not made here.

    python research/real_data.py [FOLDER] [--small]

FOLDER is the shared data (default: ../shared/data beside the repository). Prints three sections:

forms    every form of rotor model on every coaxial map: on sweeps left out, and on a separate run
prior    what `identify --single` says of a pair before any coaxial measurement, against the pair's stand
flights  whether the 95 % intervals of `identify FLIGHT...` hold what is true, on logs of PX4 and ArduCopter

`--small` takes seconds: the shipped stand log, and of the shared data, where it is there, one of each.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from coaxlink.airframe import load_airframe
from coaxlink.data import Samples, read_flight_log, read_stand_log
from coaxlink.data.single import STAND, SingleTable, read_single_table
from coaxlink.load import Load
from coaxlink.rotor import Identification, RotorModel, identify, load_rotor_model
from coaxlink.rotor.fit import FORMS
from coaxlink.rotor.prior import PairPrior, Propeller, pair_prior
from coaxlink.rotor.stand_data import COAXIAL, unit_of
from coaxlink.rotor_update.coefficients import coefficients_from_flights

HERE = Path(__file__).resolve().parent
EXAMPLES = HERE.parent / "examples"
INCH = 0.0254
NORMAL_95 = 1.96
IDLE = 0.13  # of the fastest: the platform's idle rows run at a tenth
RATIO = (0.5, 1.4)  # upper over lower speed: where vehicles fly
FAST = 0.4  # of the highest speed, the faster of both
FLIGHTS = ("px4_null_fitted.ulg", "px4_rotor_drag.ulg", "ap_null.bin")
OFF, EVERY = 0.15, 5  # each load of a prior is off by this; every fifth of the 16 ways to be off


@dataclass(frozen=True)
class Pair:
    """A real pair, its propeller as it is sold, and its logs by spacing over diameter."""

    name: str
    diameter_in: float
    pitch_in: float | None
    single: str | None  # file of one rotor alone
    logs: dict[float, str]


def _logs(stem: str) -> dict[float, str]:
    return {z: f"{stem}_zD{name}.csv" for z, name in ((0.55, "055"), (0.7, "07"), (0.85, "085"), (1.0, "1"))}


PAIRS = (
    Pair("MN4014, 16.2 x 5.3 in", 16.2, 5.3, None, _logs("mn4014_16in")),
    Pair(
        "PropDrive, 11 in, pitch unknown",
        11.0,
        None,
        "propdrive_11in_upper_alone.csv",
        _logs("propdrive_11in"),
    ),
    Pair(
        "T-Motor 28 x 9.2 in", 28.0, 9.2, "tmotor28_data.csv", {0.115 / 0.7112: "tmotor28_coaxial_data.csv"}
    ),
)


def read(path: Path) -> Samples:
    """A coaxial log; on the platform of Buzzatto and Liarokapis left is the upper rotor."""
    return read_stand_log(path, upper="left" if path.name.startswith(("mn4014", "propdrive")) else None)


def forms(paths: list[Path]) -> Iterator[str]:
    """RMSE of the coaxial sum by every form; the floor is how neighbouring points scatter."""
    yield f"| file | channel | {' | '.join(FORMS)} | floor |"
    yield f"|---|---|{'---:|' * (len(FORMS) + 1)}"
    for path in paths:
        log = read(path)
        results = {form: identify(log, form, compare=False) for form in FORMS}
        other = path.with_name(f"{path.stem}_run2.csv")
        run = read(other) if other.is_file() else None
        for channel, (upper, lower) in COAXIAL.items():
            floor = f"{results['crm'].noise_floor[channel]:.3g}"
            held = [f"{result.channels[channel].rmse:.4g}" for result in results.values()]
            where = f"{path.stem} | {channel}, {unit_of(channel)}"
            yield f"| {where}, sweeps left out | {' | '.join(held)} | {floor} |"
            if run is not None:
                loads = Load.of(upper), Load.of(lower)
                apart = [f"{separate_error(result, run, loads):.4g}" for result in results.values()]
                yield f"| {where}, separate run | {' | '.join(apart)} | {floor} |"


def separate_error(result: Identification, run: Samples, loads: tuple[Load, Load]) -> float:
    """RMSE of the sum of two loads on rows of another run, by the model of the map."""
    u, v = (run[f"{side}_rpm"] / result.model.speed_max_rpm for side in ("upper", "lower"))
    predicted = result.model.loads(u, v)
    error = sum(run[load.column] - predicted[load] for load in loads)
    return float(np.sqrt(np.mean(np.square(error))))


@dataclass(frozen=True)
class Row:
    """One load of one log against the prior, as shares of what such a rotor gives alone."""

    pair: str
    spacing: float
    load: Load
    measured: float  # at equal speeds
    prior: float
    half: float  # of the prior's 95 % interval
    rmse: float  # of the prior over the working rows, of the largest load
    without: float  # of two rotors that do not disturb each other
    inside: float  # share of working rows inside the interval
    rows: int


def single_table(pair: Pair, folder: Path, log: Samples) -> SingleTable:
    """The table of one rotor: its own file, or the upper rotor's rows with the lower one at idle."""
    if pair.single is not None and pair.single.startswith("tmotor"):
        return read_single_table(folder / pair.single, pair.diameter_in * INCH)
    source = log if pair.single is None else read(folder / pair.single)
    upper, lower = source["upper_rpm"], source["lower_rpm"]
    rows = (lower < IDLE * upper.max()) & (upper > 2 * IDLE * upper.max())
    rpm, thrust, torque = (source[n][rows] for n in ("upper_rpm", "upper_thrust_N", "upper_torque_Nm"))
    return SingleTable(rpm, thrust, torque, None, STAND, source.source)


def prior_rows(pair: Pair, folder: Path) -> Iterator[Row]:
    """Every load of every log of a pair against its prior, which saw nothing of the log but lone rows."""
    size = pair.diameter_in * INCH
    pitch = None if pair.pitch_in is None else pair.pitch_in * INCH
    for spacing, name in pair.logs.items():
        log = read(folder / name)
        prior = pair_prior(single_table(pair, folder, log), Propeller(size, spacing * size, pitch))
        yield from (_row(pair.name, spacing, load, log, prior) for load in Load)


def _row(pair: str, spacing: float, load: Load, log: Samples, prior: PairPrior) -> Row:
    u, v = (log[f"{side}_rpm"] / prior.model.speed_max_rpm for side in ("upper", "lower"))
    ratio = u / np.maximum(v, 1e-9)
    working = (ratio > RATIO[0]) & (ratio < RATIO[1]) & (np.maximum(u, v) > FAST * max(u.max(), v.max()))
    equal = working & (np.abs(ratio - 1) < 0.1)
    alone = prior.model.surface(Load(load % 2))(v if load.rotor else u)  # the upper rotor is undisturbed
    measured, reported = log[load.column], prior.model.loads(u, v)[load]
    spread = NORMAL_95 * prior.spread(load.key, u, v)
    off, largest = measured - reported, float(np.abs(measured[working]).max())
    return Row(
        pair,
        spacing,
        load,
        *(float(np.median(x[equal] / alone[equal])) for x in (measured, reported, spread)),
        float(np.sqrt(np.mean(off[working] ** 2))) / largest,
        float(np.sqrt(np.mean((measured - alone)[working] ** 2))) / largest,
        float(np.mean(np.abs(off[working]) < spread[working])),
        int(working.sum()),
    )


def prior_lines(pairs: tuple[Pair, ...], folder: Path) -> Iterator[str]:
    """A line a load and log, and how many intervals hold."""
    yield "| pair | z/D | load | stand | prior | its error | of two rotors alone | rows inside |"
    yield "|---|---:|---|---:|---:|---:|---:|---:|"
    rows = [row for pair in pairs for row in prior_rows(pair, folder)]
    for r in rows:
        shares = f"{r.measured:.2f} | {r.prior:.2f} +/- {r.half:.2f} | {100 * r.rmse:.1f} %"
        inside = f"{100 * r.without:.1f} % | {100 * r.inside:.0f} % of {r.rows}"
        yield f"| {r.pair} | {r.spacing:.2f} | {r.load.side} {r.load.quantity} | {shares} | {inside} |"
    for load in Load:
        own = [r for r in rows if r.load is load]
        inside = sum(r.inside * r.rows for r in own) / sum(r.rows for r in own)
        equal = sum(abs(r.measured - r.prior) <= r.half for r in own)
        yield (
            f"- {load.side} {load.quantity}: {100 * inside:.0f} % of the rows inside, at equal speeds "
            f"{equal} of {len(own)} logs; errors {_range([r.rmse for r in own])}, two rotors alone "
            f"{_range([r.without for r in own])}"
        )


def _range(shares: list[float]) -> str:
    return f"{100 * min(shares):.1f} to {100 * max(shares):.1f} %"


def flight_lines(paths: list[Path], priors: int) -> Iterator[str]:
    """A line a log and prior; each load of a prior is 15 % larger or smaller than the flown rotors'."""
    true = load_rotor_model(EXAMPLES / "rotor_paper.toml")
    airframe = replace(load_airframe(EXAMPLES / "x8_paper.toml"), motor_lag_s=0.02)
    for path in paths:
        log = read_flight_log(path)
        ways = itertools.islice(itertools.product((-1, 1), repeat=4), 0, EVERY * priors, EVERY)
        for signs in ways:
            terms = {
                load: {term: (1.0 + OFF * sign) * c for term, c in own.items()}
                for (load, own), sign in zip(true.terms().items(), signs, strict=True)
            }
            prior = RotorModel.from_terms(true.form, true.speed_max_rpm, terms)
            update = coefficients_from_flights([log], airframe, prior)
            off = [(c.value - true.terms()[c.load][c.term]) / c.sd for c in update.coefficients]
            inside = sum(abs(z) <= NORMAL_95 for z in off)
            worst = float(np.abs(off).max())
            yield f"{path.name} {signs}: {inside} of {len(off)} inside, worst {worst:.1f} sd"


def main(arguments: list[str]) -> int:
    """Print the sections."""
    small = "--small" in arguments
    given = [Path(a) for a in arguments if not a.startswith("--")]
    folder = given[0] if given else HERE.parent.parent / "shared" / "data"
    if not small and not folder.is_dir():
        print(f"{folder} is not there: name the folder of the shared data", file=sys.stderr)
        return 2
    coax = folder / "coax"
    example = EXAMPLES / "stand_eq17.csv"
    maps = [example] if small else [coax / name for pair in PAIRS for name in pair.logs.values()]
    sections = {"forms": forms(maps)}
    if folder.is_dir():
        pairs, logs = (PAIRS[2:], FLIGHTS[:1]) if small else (PAIRS, FLIGHTS)
        sections["prior"] = prior_lines(pairs, coax)
        sections["flights"] = flight_lines([folder / "flights" / name for name in logs], 1 if small else 4)
    for name, lines in sections.items():
        print(f"\n## {name}\n")
        for line in lines:
            print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
