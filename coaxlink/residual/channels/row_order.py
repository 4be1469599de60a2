"""Rows of a stand log that were shuffled, or sorted by another column, after they were measured."""

from __future__ import annotations

import numpy as np

from coaxlink.data.samples import Samples

LEAST_BACK = 0.05  # of the steps, judgement: fewer are clocks set back or sessions put together
RESTARTS = 0.1  # of the span of time, judgement: a clock that starts anew goes back to its start


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
