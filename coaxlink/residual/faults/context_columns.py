"""What a stand log reads beside loads and speeds, such as supply and current, where it stands still."""

from __future__ import annotations

import numpy as np

from coaxlink.data.resolution import is_coarse, resolution_of
from coaxlink.frames import Array, StandFrame
from coaxlink.residual.channels.stand import COLUMN_OF
from coaxlink.residual.faults.row_ranges import Mask

LEAST_ROWS, LEAST_SHARE = 12, 0.02  # of one reading; and of the log
ELSEWHERE = 0.01  # of the other rows: a column that repeats itself more often than that may do so for long
PAUSE = 10.0  # times the usual step of time: another session begins
OTHERS = 0.1  # of the rows, and LEAST_ROWS: so many must read otherwise
MOVES = 0.1  # of the reference load, from quantile to quantile: of a rig at rest all may stand still
NO_CONTEXT = {"time_s", "log", *COLUMN_OF.values()}


def frozen_columns(frame: StandFrame) -> list[tuple[str, Mask]]:
    """Columns that else never read the same twice, and the rows (rows,) in which they do.

    Not a whole session of one number, which somebody wrote down, not a reading of exactly nothing (a range
    has a lower end), and not a column whose steps are coarse.
    """
    found = []
    for name, values in frame.columns.items():
        if name in NO_CONTEXT or name.endswith(("_rpm", "_throttle")) or len(values) < 2 * LEAST_ROWS:
            continue
        rows = _frozen(frame, values)
        if rows.any():
            found.append((name, rows))
    return found


def _frozen(frame: StandFrame, values: Array) -> Mask:
    out = np.zeros(len(values), bool)
    same = np.concatenate([[False], np.diff(values) == 0.0])
    first = np.flatnonzero(~same)
    end = np.append(first[1:], len(values))
    long = end - first >= max(LEAST_ROWS, LEAST_SHARE * len(values))
    if not long.any() or is_coarse(values, resolution_of(values)):
        return out
    loads = [c for c in frame.present if c < 4]
    step = np.diff(frame.time_s)
    begins = np.concatenate([[True], step > PAUSE * float(np.median(step)), [True]])  # a session, at each row
    for a, b in zip(first[long], end[long], strict=True):
        whole = begins[a] and begins[b]
        low, high = np.quantile(frame.measured[a:b, loads], [0.05, 0.95], axis=0)
        moves = np.any(high - low > MOVES * frame.reference[loads])
        if values[a] != 0.0 and not whole and moves:
            out[a:b] = True
    others = np.sum(~out)
    enough = others >= max(LEAST_ROWS, OTHERS * len(out)) and np.sum(same & ~out) <= ELSEWHERE * others
    return out if enough else np.zeros_like(out)
