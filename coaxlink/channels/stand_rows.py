"""Rows of a stand log that can be judged: with a number in each cell that counts, in the order of time."""

from __future__ import annotations

import numpy as np

from coaxlink.data.aliases import SIDES
from coaxlink.data.samples import Samples
from coaxlink.errors import InputError
from coaxlink.load import Load

LEAST_BACK = 0.05  # of the steps, judgement: fewer are clocks set back or sessions put together
RESTARTS = 0.1  # of the span of time, judgement: a clock that starts anew goes back to its start


def without_empty_cells(log: Samples) -> Samples:
    """The rows whose loads and speeds are all numbers, of what has a number in each of them; notes say so.

    Nothing is filled in: what a cell would have read is not known.
    Raises InputError when no row is left.

    >>> log = without_empty_cells(Samples({"upper_thrust_N": np.array([1.0, np.nan])}, "x.csv"))
    >>> log.rows, log.notes
    (1, ('1 rows without a number in upper_thrust_N are left out and not counted',))
    """
    empty = {name: ~np.isfinite(values) for name, values in log.columns.items()}
    bare = [name for name, cells in empty.items() if cells.all()] if log.rows else []
    notes = [f"{name}: no row has a number: left out" for name in bare]
    log = log.without(*bare)
    speeds = "rpm" if any(log.has(f"{side}_rpm") for side in SIDES) else "throttle"
    needed = [
        name for name in (*(x.column for x in Load), *(f"{s}_{speeds}" for s in SIDES)) if log.has(name)
    ]
    lost = np.any([empty[name] for name in needed], axis=0) if needed else np.zeros(log.rows, bool)
    if lost.any():
        names = ", ".join(name for name in needed if empty[name].any())
        if lost.all():
            raise InputError(log.source, "", f"no row has a number in each of {names}")
        notes.append(f"{lost.sum()} rows without a number in {names} are left out and not counted")
        log = log.take(~lost)
    for name, cells in empty.items():
        count = int(np.sum(cells[~lost])) if log.has(name) else 0
        if count:
            notes.append(f"{name}: empty in {count} rows: left out")
            log = log.without(name)
    return log.with_notes(*notes) if notes else log


def in_order_of_time(log: Samples) -> Samples:
    """The rows by `time_s` where they stand in another order, each with a stamp of its own; a note says so.

    What lags, remembers or drifts goes by the order of time. A clock that starts again and again tells none.

    >>> log = Samples({"time_s": np.array([3.0, 1.0, 4.0, 2.0]), "upper_rpm": np.arange(4.0)}, "x.csv")
    >>> in_order_of_time(log)["upper_rpm"].tolist()
    [1.0, 3.0, 0.0, 2.0]
    """
    if not log.has("time_s") or log.rows < 2 or not np.isfinite(log["time_s"]).all():
        return log
    time = log["time_s"]
    back = np.flatnonzero(np.diff(time) < 0.0)
    if len(back) < LEAST_BACK * log.rows or len(np.unique(time)) < log.rows:
        return log
    after = (time[back + 1] - time.min()) / np.ptp(time)
    if np.median(after) < RESTARTS:
        return log
    place = log.place(int(back[0]) + 1)
    note = f"time_s goes back in {len(back)} rows, first at {place}: rows are sorted by it, and counted so"
    return log.take(np.argsort(time)).with_notes(note)
