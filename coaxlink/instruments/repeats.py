"""How readings repeat, digit by digit: a column that stands still, a limit, a copy.

A column of fine resolution does not read the same twice, a coarse one does whenever little moves: a run
counts where so many equal readings are no accident by how often the rest of the log repeats itself, and, of
a coarse one, where what the column should have read moves. A copy counts where its sequence is none that the
log's own changes from one reading to the next would bring by chance.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.resolution import is_coarse, resolution_of
from coaxlink.frames import Array
from coaxlink.instruments.findings import Mask, runs_of

# priors: name = value  # unit, source
BY_CHANCE = 1e-6  # logs in which so long a run is an accident
STUCK_ROWS = 4  # a run
COPIED_ROWS = 6  # a run of copies
LAGS = 50  # the most common distances between equal readings are looked at
LEVELS, OFTEN = 10, 5.0  # readings of a cell with a limit; times the usual count that it reads the limit
ALIKE = 2.5  # steps of the readings: within them two cells may read the same by chance


def held_runs(values: Array, least: float = STUCK_ROWS) -> list[tuple[int, int]]:
    """First rows, and rows behind the last, of runs of one reading (rows,) which are no accident.

    >>> held_runs(np.concatenate([np.arange(50.0), np.full(9, 3.25), np.arange(50.0)]))
    [(50, 59)]
    """
    return [(a, b) for a, b, log_evidence in repeats_of(values, least) if log_evidence > -np.log(BY_CHANCE)]


def repeats_of(values: Array, least: float = STUCK_ROWS) -> list[tuple[int, int, float]]:
    """First row, and row behind the last, of every run of one reading (rows,), and the nats against so long a
    one somewhere in the log by how often the rows outside it repeat."""
    same = np.concatenate([[False], values[1:] == values[:-1]])
    runs = [(a - 1, b) for a, b in runs_of(same) if b - a + 1 >= max(least, STUCK_ROWS)]
    count, every = float(same.sum()), len(values)

    def against_chance(rows: int) -> float:
        return -(rows - 1) * float(np.log((count - (rows - 1) + 1.0) / (every - rows + 2.0)))

    return [(a, b, against_chance(b - a) - float(np.log(every))) for a, b in runs]


def is_fine(values: Array, step: float | None = None) -> bool:
    """Whether readings (rows,), of a smallest step where it is known, do not repeat for their resolution."""
    return not is_coarse(values, resolution_of(values) if step is None else step)


def copied_rows(values: Array) -> Mask:
    """(rows,) of readings (rows, K) that stand in the log before, in the same order."""
    finite = np.isfinite(values).all(axis=1)
    rows = np.flatnonzero(finite & np.concatenate([[True], np.any(values[1:] != values[:-1], axis=1)]))
    out = np.zeros(len(values), bool)
    if len(rows) < COPIED_ROWS:
        return out
    _, code = np.unique(values[rows], axis=0, return_inverse=True)
    code = code.ravel()
    surprise = _surprise(code)
    for lag in _lags(code):
        for a, b in ((a + lag, b + lag) for a, b in runs_of(code[lag:] == code[:-lag])):
            # wherever it begins, whatever the lag
            information = surprise[a:b].sum() - 2.0 * np.log(len(rows))
            if b - a >= COPIED_ROWS and information > -np.log(BY_CHANCE):
                out[rows[a] : rows[b - 1] + 1] = True
    return out


def _lags(code: NDArray[np.intp]) -> list[int]:
    """Distances at which readings come again so often that a copy may be behind it."""
    order = np.argsort(code, kind="stable")
    again = code[order][1:] == code[order][:-1]
    found = Counter((order[1:] - order[:-1])[again].tolist())
    return [lag for lag, count in found.most_common(LAGS) if count >= COPIED_ROWS]


def _surprise(code: NDArray[np.intp]) -> Array:
    """(rows,) -log of the chance of a reading after the one before it, by the rest of the log.

    Neither the row itself nor the one that it may be a copy of counts.
    """
    count = np.maximum(np.bincount(code) - 2, 0) + 1.0
    before, now = code[:-1], code[1:]
    _, kind, moves = np.unique(before * len(count) + now, return_inverse=True, return_counts=True)
    out = np.zeros(len(code))
    out[1:] = np.log(count[before]) - np.log(np.maximum(moves[kind] - 2, 0) + count[now] / len(code))
    return out


def alike_rows(usable: Mask, a: Array, b: Array) -> Mask:
    """Runs of rows in which two cells read the same, that coarse readings do not bring by chance.

    How often two sound cells agree is known by the rows outside a run in which they read alike; where there
    are none, by how often either reads each of its values.
    """
    equal = usable & (a == b)
    out = np.zeros(len(usable), bool)
    values, counts = np.unique(np.concatenate([a[usable], b[usable]]), return_counts=True)
    meeting = float(np.sum((counts / counts.sum()) ** 2))
    alike = usable & (np.abs(a - b) < ALIKE * float(np.min(np.diff(values), initial=np.inf)))
    for first, end in runs_of(equal):
        if end - first < COPIED_ROWS or len(np.unique(a[first:end])) < 3:
            continue
        others = alike.copy()
        others[first:end] = False
        agree = max(meeting, float(np.sum(equal & others)) / max(int(others.sum()), COPIED_ROWS))
        if -(end - first) * np.log(min(agree, 1.0)) > 2.0 * np.log(len(a)) - np.log(BY_CHANCE):
            out[first:end] = True
    return out


def limits_of(values: Array) -> list[tuple[float, float]]:
    """Largest and smallest of readings (rows,) that come far more often than others, with a sign."""
    levels, counts = np.unique(values[np.isfinite(values)], return_counts=True)
    if len(levels) < LEVELS:
        return []
    least = max(COPIED_ROWS, len(values) // 100, OFTEN * float(np.quantile(counts, 0.95)))
    ends = ((levels[-1], counts[-1], 1.0), (levels[0], counts[0], -1.0))
    return [(float(limit), sign) for limit, count, sign in ends if limit != 0.0 and count >= least]
