"""Cells of a stand log that hold no number: rows without a load or a speed, columns with gaps."""

from __future__ import annotations

import numpy as np

from coaxlink.data.samples import Samples
from coaxlink.errors import InputError
from coaxlink.load import Load

SIDES = ("upper", "lower")


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
