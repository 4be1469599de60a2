"""A pair's prior as a table, in words and as a picture. Numbers come from the prior; nothing is fitted
here."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from coaxlink.constants import NORMAL_95
from coaxlink.load import Load
from coaxlink.report.pictures.figures import drawn, new_figure, plain_axis
from coaxlink.report.pictures.looks import THRUST, TORQUE
from coaxlink.report.terminal import grouped, table
from coaxlink.rotor.model import LOADS
from coaxlink.rotor.prior import RATIOS, WORKING, PairPrior


def prior_table(prior: PairPrior) -> Any:
    """Rich table: every coefficient with its interval."""
    rows = []
    for load, terms in prior.model.terms().items():
        for i, (term, value) in enumerate(terms.items()):
            low, high = prior.intervals[load][term]
            rows.append((load if i == 0 else "", term, f"{value:.4f}", f"{low:.4f} .. {high:.4f}"))
    heads = ("load", "term", "value", "95 % interval")
    return table("prior of the pair: terms", heads, rows, left=2, boxed=True, sections=grouped(rows))


def what_it_says(prior: PairPrior) -> Iterator[str]:
    """The loads of both rotors at equal speeds, with intervals."""
    u = np.array([WORKING])
    pair = prior.model.loads(u, u)
    values = (pair.upper_thrust, pair.upper_torque, pair.lower_thrust, pair.lower_torque)
    rpm = WORKING * prior.model.speed_max_rpm
    yield f"both rotors at {rpm:.0f} rpm:"
    for load, value in zip(LOADS, values, strict=True):
        half = NORMAL_95 * float(prior.spread(load, u, u)[0])
        side, _, quantity = load.partition(".")
        name, _, unit = quantity.partition("_")
        shown = "N m" if unit == "Nm" else unit
        yield f"  {side} {name} {float(value[0]):.3g} {shown} +/- {half:.2g} (95 %)"
    share = float(pair.lower_thrust[0] / pair.upper_thrust[0])
    yield f"  the lower rotor lifts {100 * share:.0f} % of what the upper one does"


def picture(prior: PairPrior) -> bytes:
    """PNG: what the lower rotor gives over the ratio of the speeds, as shares of a rotor alone."""
    figure = new_figure(4.2)
    axis = figure.add_subplot()
    lower = np.full(len(RATIOS), WORKING)
    upper = RATIOS * WORKING
    alone = prior.model.loads(0.0 * lower, lower)
    pair = prior.model.loads(upper, lower)
    for load, value, own, look in (
        (Load.LOWER_THRUST.key, pair.lower_thrust, alone.lower_thrust, THRUST),
        (Load.LOWER_TORQUE.key, pair.lower_torque, alone.lower_torque, TORQUE),
    ):
        half = NORMAL_95 * prior.spread(load, upper, lower)
        axis.plot(RATIOS, value / own, **look.line, label=load.split(".")[1].split("_")[0])
        around = (value - half) / own, (value + half) / own
        axis.fill_between(RATIOS, *around, color=look.colour, alpha=0.2, lw=0)
    axis.set_xlabel("upper over lower speed")
    axis.set_ylabel("lower rotor, share of a rotor alone")
    axis.legend(frameon=False)
    plain_axis(axis)
    return drawn(figure)
