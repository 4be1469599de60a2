"""One cell under the whole pair: the model of the sum, and the run that makes a model of each rotor of it.

The cell reads T = T_u + T_l, and about the axis Q = Q_u - Q_l, as the rotors turn against one another. A sum
stays as it is where one rotor is taken to lift more and the other less: their split is not in it. Rows in
which the upper rotor turns alone tell T_u(u) and Q_u(u), and what is left is the lower one's. That takes the
upper rotor for undisturbed by the lower one, as every form of ours does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from coaxlink.data import Samples
from coaxlink.data.aliases import PAIR, QUANTITIES, SIDES
from coaxlink.data.averaging import conditions
from coaxlink.data.samples import FEWEST_ROWS
from coaxlink.data.tare import STANDS
from coaxlink.errors import InputError
from coaxlink.load import Load
from coaxlink.rotor.fit import Array, LoadFit, Options
from coaxlink.rotor.selection import fit_load
from coaxlink.rotor.stand_data import LoadRows, Speeds, blocks, folds, normalised_speeds
from coaxlink.rotor.uncertainty import HeldOutError, held_out_error

FOLDS = 5  # in which rows of the upper rotor alone are held out in turn
COLUMNS = {q: f"{PAIR}_{QUANTITIES[q].suffix}" for q in ("thrust", "torque")}
OPEN = (
    "which rotor lifts how much is not in a sum: neither the split nor each rotor's torque, and so no table",
    "one more run tells them: the upper rotor alone over its speeds, the lower one standing, on the same "
    "cell; `join` takes both logs",
)
ALONE = "the upper rotor's loads are those it has alone ({rows} rows), the lower one's the rest of the pair's"


@dataclass(frozen=True)
class PairSum:
    """What a cell under both rotors tells."""

    samples: Samples
    speeds: Speeds
    fits: Mapping[str, LoadFit]  # by the column's name
    errors: Mapping[str, HeldOutError]  # held out

    def as_json(self) -> dict[str, Any]:
        """The contract's keys of `identify`; no load of a rotor is among the terms."""
        return {
            "form": "sum",
            "speed_max_rpm": self.speeds.speed_max_rpm,
            "terms": {
                f"{PAIR}.{name[len(PAIR) + 1 :]}": dict(f.polynomial.terms()) for name, f in self.fits.items()
            },
            "channels": {
                f"{PAIR}_{q}": e.as_json() for q, name in COLUMNS.items() if (e := self.errors.get(name))
            },
            "open": list(OPEN),
        }


def is_pair(samples: Samples) -> bool:
    """Whether a log has the thrust of both rotors together and of neither alone."""
    return samples.has(COLUMNS["thrust"]) and not any(
        samples.has(name) and np.isfinite(samples[name]).all() for name in (f"{s}_thrust_N" for s in SIDES)
    )


def pair_sum(samples: Samples, speed_max_rpm: float | None = None) -> PairSum:
    """The sums over both speeds. Raises InputError where the log has no speeds of both rotors, or too few."""
    read, samples = samples, conditions(samples)
    speeds = normalised_speeds(samples, speed_max_rpm)
    still = [side for side, u in zip(SIDES, (speeds.upper, speeds.lower), strict=True) if np.all(u <= STANDS)]
    if still:
        problem = (
            f"rows in which both rotors turn are expected: the {still[0]} one stands still in all of them"
        )
        raise InputError(samples.source, "", problem)
    if samples.rows < FEWEST_ROWS or np.ptp(speeds.upper) <= 0 or np.ptp(speeds.lower) <= 0:
        found = f"{samples.rows} rows{samples.rows_lost()}"
        raise InputError(
            samples.source, "", f"{FEWEST_ROWS} rows in which both speeds vary are expected, found {found}"
        )
    held = folds(blocks(samples, speeds))
    fits, errors = {}, {}
    for name in COLUMNS.values():
        if not samples.has(name) or np.isfinite(samples[name]).sum() < FEWEST_ROWS:
            continue
        y = samples[name] * (_sign(samples[name]) if name == COLUMNS["thrust"] else 1.0)
        rows = LoadRows(name, speeds.upper, speeds.lower, y, held)
        fits[name] = fit_load("crm", rows, Options(max_order=2))
        errors[name] = held_out_error(y, _held_out(rows, fits[name]))
    return PairSum(read, speeds, fits, errors)


def _sign(readings: Array) -> float:
    """With which a stand reads a lift, or the upper rotor's torque."""
    return float(np.sign(np.nanmedian(readings))) or 1.0


def _held_out(rows: LoadRows, fit: LoadFit) -> Array:
    """(n,) predictions of the kept terms refitted without each row's fold."""
    X = rows.design(tuple(fit.polynomial.terms()))
    out = np.full(len(rows.y), np.nan)
    for fold in np.unique(rows.fold):
        left = rows.fold == fold
        out[left] = X[left] @ np.linalg.lstsq(X[~left], rows.y[~left], rcond=None)[0]
    return out


def of_each_rotor(samples: Samples) -> Samples:
    """A log of the pair with each rotor's loads, where the upper one also turned alone; else as it was."""
    if not is_pair(samples):
        return samples
    speeds = normalised_speeds(samples)
    alone = (speeds.lower <= STANDS) & (speeds.upper > STANDS)
    columns: dict[str, Array] = {}
    for quantity, name in COLUMNS.items():
        known = alone & np.isfinite(samples[name]) if samples.has(name) else np.zeros(samples.rows, bool)
        if known.sum() < FEWEST_ROWS:
            if quantity == "thrust":
                return samples
            continue
        total = samples[name] * _sign(samples[name][known])
        load = Load.UPPER_THRUST if quantity == "thrust" else Load.UPPER_TORQUE
        u, still = speeds.upper[known], np.zeros(known.sum())
        fit = fit_load(
            "crm", LoadRows(load.key, u, still, total[known], np.arange(len(u)) % FOLDS), Options()
        )
        left, order = total[known] - fit.predict(u, still), np.argsort(u)
        upper = fit.predict(speeds.upper, 0.0 * speeds.lower)
        upper += np.interp(
            speeds.upper, u[order], left[order]
        )  # between the rows measured, their noise with it
        rest = total - upper if quantity == "thrust" else upper - total
        suffix = QUANTITIES[quantity].suffix
        columns |= {f"upper_{suffix}": upper, f"lower_{suffix}": np.where(alone, np.nan, rest)}
    split = samples.with_columns(**columns).without(*COLUMNS.values())
    return split.with_notes(ALONE.format(rows=int(alone.sum())))
