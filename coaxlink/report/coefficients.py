"""A rotor model after flights as tables and words: prior beside posterior, coefficient by coefficient."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from coaxlink.constants import NORMAL_95
from coaxlink.report.terminal import grouped, table
from coaxlink.rotor_update.coefficients import Update
from coaxlink.rotor_update.next_flight import NextFlight

REPORTED = {"told": "identified", "partly": "partly", "not told": "not identified"}
CHANNELS = ("force down, N", "roll, N m", "pitch, N m", "yaw, N m")


def coefficient_table(update: Update, planned: NextFlight | None = None) -> Any:
    """Rich table: every coefficient before and after, and the interval expected behind the planned flight."""
    heads = ["load", "term", "prior", "after the flights", "these flights"]
    heads += ["next flight"] if planned else []
    expected = {(c.load, c.term): c.after for c in planned.coefficients} if planned else {}
    rows: list[list[str]] = []
    before = ""
    for t in update.coefficients:
        prior, after = (rounded(v, NORMAL_95 * sd) for v, sd in ((t.prior, t.prior_sd), (t.value, t.sd)))
        rows.append([t.load if t.load != before else "", t.term, prior, after, REPORTED[t.verdict]])
        if planned:
            half = NORMAL_95 * expected[t.load, t.term]
            rows[-1].append("± " + rounded(0.0, half).rpartition(" ")[2])
        before = t.load
    title = "coefficients: prior and posterior, 95 %"
    return table(title, heads, rows, left=2, boxed=True, sections=grouped(rows))


def rounded(value: float, half: float) -> str:
    """A value and half its interval, to three digits of the latter.

    >>> rounded(55.9517, 16.4498), rounded(-0.695, 0.2043), rounded(2.0, 0.0)
    ('56.0 ± 16.4', '-0.695 ± 0.204', '2.0000 ± 0.0000')
    """
    decimals = min(max(2 - math.floor(math.log10(half)), 0), 6) if half > 0 else 4
    return f"{value:.{decimals}f} ± {half:.{decimals}f}"


def hover_table(update: Update) -> Any:
    """Rich table: the loads of both rotors at the flights' median speeds."""
    u, v = update.hover
    rows = [
        (load, rounded(prior, NORMAL_95 * prior_sd), rounded(value, NORMAL_95 * sd))
        for load, (prior, prior_sd, value, sd) in update.loads.items()
    ]
    title = f"one pair at {u:.2f} and {v:.2f} of full speed, 95 %"
    return table(title, ("load", "prior", "after the flights"), rows, boxed=True)


def words(update: Update) -> Iterator[str]:
    """What the flights identified, what they did not, and which flight would identify more."""
    yield from update.notes
    for name, before, after in zip(CHANNELS, *update.rms, strict=True):
        yield f"{name}: residual of the model alone {before:.3g} before, {after:.3g} after"
    open_terms = [f"{t.load} {t.term}" for t in update.coefficients if t.verdict == "not told"]
    if open_terms:
        yield f"not determined by these flights, as believed before: {', '.join(open_terms)}"
    thrust = {load: sds for load, (*_, sds) in update.loads.items() if load.endswith("thrust_N")}
    largest = max(thrust.values())
    if largest > 0.02 * float(np.sum([update.loads[load][2] for load in thrust])):
        yield (
            f"upper against lower thrust stays open by {NORMAL_95 * largest:.2g} N a rotor: flights identify "
            "their sum, which is what a table needs; a plan of the next flight weighs another split"
        )
