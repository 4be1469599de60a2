"""Long logs made short: means of neighbouring rows at steady speed, or every so manieth row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from coaxlink.data.aliases import SIDES
from coaxlink.data.samples import Samples

MOST = 5_000  # rows: more only repeat what the stand has said
STEADY = 0.02  # of the fastest speed: spread within which rows show one condition


def thinned(samples: Samples, most: int = MOST) -> Samples:
    """Every so manieth row, at most about `most`: enough to tell rotors, signs and units by."""
    step = max(1, samples.rows // most)
    return samples if step == 1 else samples.take(np.arange(0, samples.rows, step))


def shortened(samples: Samples, most: int = MOST) -> Samples:
    """A log of at most about `most` rows, itself when it is short.

    Rows are averaged over stretches in which the speeds hold still; where they never do, rows are left out at
    even distances instead. The notes say which.
    """
    if samples.rows <= most:
        return samples
    size = -(-samples.rows // most)
    count = samples.rows // size
    steady = np.ones(count, bool)
    for name in (f"{side}_{what}" for what in ("rpm", "throttle") for side in SIDES):
        if samples.has(name):
            parts = samples[name][: count * size].reshape(count, size)
            steady &= np.ptp(parts, axis=1) <= STEADY * max(float(np.abs(samples[name]).max()), 1e-300)
    if 2 * steady.sum() < count:
        sparse = samples.take(np.arange(0, samples.rows, size))
        return sparse.with_notes(f"every {size}th of {samples.rows} rows: the speeds never hold still")
    columns = {
        name: column[: count * size].reshape(count, size).mean(axis=1)[steady]
        for name, column in samples.columns.items()
    }
    lines = None if samples.lines is None else samples.lines[: count * size : size][steady]
    short = replace(samples, columns=columns, lines=lines)
    left = count - int(steady.sum())
    return short.with_notes(
        f"{samples.rows} rows as {short.rows} means of {size}; {left} in which a speed changed left out"
    )
