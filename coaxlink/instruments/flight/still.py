"""A column that stands still to its last digit in the air, held against what the others make of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import SIGMA_PER_MAD
from coaxlink.frames import Array
from coaxlink.instruments.chain import SURE, log_evidence_of
from coaxlink.instruments.findings import Mask
from coaxlink.instruments.repeats import repeats_of

# priors: name = value  # unit, source
STUCK_S = 0.5  # less is a packet that was lost
LEAST_ROWS = 100  # for the fifteen numbers of a fit, judgement
FIT_ROWS = 4000  # effort
OUTLIER = 3.0  # standard deviations: less is noise
FEWEST = 1e-4  # of full command: what a mixer's own arithmetic leaves

Held = tuple[int, int, float]  # first row, row behind the last, nats against its length being an accident


def held_in_flight(values: Array, flying: Mask) -> list[Held]:
    """Runs of one value in the air that a log has less than once by chance; rows without a value are passed
    over."""
    known = np.flatnonzero(np.isfinite(values) & flying)
    found = repeats_of(values[known]) if len(known) else []
    return [
        (int(known[a]), int(known[b - 1]) + 1, log_evidence)
        for a, b, log_evidence in found
        if log_evidence > 0.0
    ]


def rows_of(held: list[Held], count: int) -> Mask:
    """(count,) rows of runs."""
    out = np.zeros(count, bool)
    for a, b, _ in held:
        out[a:b] = True
    return out


def away(values: Array, design: Array, usable: Mask, run: NDArray[np.intp], step: float) -> float:
    """Nats against rows of a column, of this resolution, being what a fit to the other rows makes of it.

    None where that moves no further than a reading that stands still for its resolution may be off.
    """
    rows = np.flatnonzero(usable & np.isfinite(values))
    if len(rows) < LEAST_ROWS or not len(run):
        return 0.0
    every = max(1, len(rows) // FIT_ROWS)
    rows = rows[::every]
    fit = np.linalg.lstsq(design[rows], values[rows], rcond=None)[0]
    rest = values[rows] - design[rows] @ fit
    # what it reads and what the others make of it are rounded each (a median of hovers shows less)
    rounding = np.sqrt(2.0 / 12.0) * (step if np.isfinite(step) else 0.0)
    sigma = max(SIGMA_PER_MAD * float(np.median(np.abs(rest))), FEWEST, rounding)
    due = design[run] @ fit
    if np.ptp(due) < step + 2.0 * OUTLIER * sigma:
        return 0.0
    inside = values[run] - due
    inside = inside[np.isfinite(inside)]
    usual = float(np.mean(log_evidence_of(rest / sigma)))
    against = float(np.sum(log_evidence_of(inside / sigma) - usual))
    return against * independent_share(rest, every)


def independent_share(rest: Array, every: int = 1) -> float:
    """How many independent rows one row counts as, of which each of so many is given."""
    x = rest - rest.mean()
    memory = float(np.clip(np.sum(x[1:] * x[:-1]) / max(float(np.sum(x**2)), 1e-30), 0.0, 0.99))
    memory **= 1.0 / every
    return (1.0 - memory) / (1.0 + memory)


def is_no_reading(away: float, run: Held) -> bool:
    """Whether a run is none, that goes away from what it should have read by so many nats: those have to be
    sure before its length, which a vehicle that rests has too, counts beside them, and by half, as readings
    that repeat are no independent ones (SURE is twice what is sure for that)."""
    return away > 0.5 * SURE and away + 0.5 * run[2] > SURE
