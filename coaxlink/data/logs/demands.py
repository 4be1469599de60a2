"""Motor commands between their logged rows, from the demands that were logged more often.

PX4's default set has motor commands ten times a second, and what the mixer made them of fifty times:
torque and thrust demanded. Without a curve a mixer is linear, c = B d, and the log tells B: of second
differences from row to row. What B leaves at the rows (limits, a trim, another mixer) runs straight between
them, as all of it does without demands.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.logs.streams import Array, Message, TimeSeries
from coaxlink.data.resolution import resolution_of

DEMANDS = {"vehicle_torque_setpoint": (0, 1, 2), "vehicle_thrust_setpoint": (0, 1, 2)}
LEAST_ROWS = 40  # free of limits: ten a demand
MOST = 10.0  # times full thrust or torque, which are 1: beyond is a damaged message
OFTEN = 0.75  # of the commands' period: a slower demand tells nothing that they do not


def between_rows(own: TimeSeries, topics: Mapping[str, Message | None]) -> TimeSeries | None:
    """Commands before the thrust curve, at the stamps of the demands as well.

    None where demands are not logged, come no faster, or tell of rows left out no more than their neighbours.
    """
    found = [_demand(topics.get(name), axes) for name, axes in DEMANDS.items()]
    demands = [one for one in found if one is not None]
    if len(demands) < len(DEMANDS) or max(d.period_s for d in demands) > OFTEN * own.period_s:
        return None
    rows, given = own.time_s, np.stack([*own.columns.values()], axis=1)
    at_rows = _at(rows, demands)
    free = ((given > 0.0) & (given < 1.0)).all(axis=1) & ~_silent(rows, demands)
    determined = free[2:] & free[1:-1] & free[:-2] & (rows[2:] - rows[:-2] < 3.0 * own.period_s)
    if determined.sum() < LEAST_ROWS:
        return None
    bends = np.diff(given, 2, axis=0)[determined]
    causes = np.diff(at_rows, 2, axis=0)[determined]
    half = np.arange(len(bends)) < len(bends) // 2
    left = np.empty_like(bends)
    for mine in (half, ~half):
        left[mine] = bends[mine] - causes[mine] @ np.linalg.lstsq(causes[~mine], bends[~mine])[0]
    if np.sum(left**2) >= np.sum(bends**2):
        return None
    mixer = np.linalg.lstsq(causes, bends)[0]
    stamps = np.union1d(rows, demands[0].time_s)
    stamps = stamps[(stamps >= rows[0]) & (stamps <= rows[-1]) & ~own.has_gap(stamps)]
    made, at_rows = _at(stamps, demands) @ mixer, at_rows @ mixer
    after = np.clip(np.searchsorted(rows, stamps), 1, len(rows) - 1)
    open_ = free[after] & free[after - 1] & ~_silent(stamps, demands)
    columns = {}
    for n, (name, command) in enumerate(own.columns.items()):
        along = made[:, n] + np.interp(stamps, rows, command - at_rows[:, n])
        follows = open_ & ~_held(command, at_rows[:, n])[after - 1]
        columns[name] = np.where(follows, np.clip(along, 0.0, 1.0), np.interp(stamps, rows, command))
    return TimeSeries.of(stamps, columns)


def _held(command: Array, made: Array) -> NDArray[np.bool_]:
    """(rows - 1,) between which a command (rows,) stands still and its demand does not, rounding aside: a
    row hides one step of it, and its neighbour another."""
    out = np.zeros(len(command) - 1, bool)
    edges = np.flatnonzero(np.diff(command) != 0.0)
    for first, last in pairwise([-1, *edges.tolist(), len(command) - 1]):
        run = slice(first + 1, last + 1)
        if last - first > 1:
            out[run.start : last] = np.ptp(made[run]) > 2.0 * resolution_of(command)
    return out


def _demand(topic: Message | None, axes: tuple[int, ...]) -> TimeSeries | None:
    if topic is None or any(f"xyz[{i}]" not in topic for i in axes):
        return None
    given = {f"xyz{i}": np.where(np.isnan(topic[f"xyz[{i}]"]), 0.0, topic[f"xyz[{i}]"]) for i in axes}
    none = np.logical_or.reduce([np.abs(one) > MOST for one in given.values()])
    return TimeSeries.of(topic["time_s"], {name: np.where(none, np.nan, one) for name, one in given.items()})


def _at(stamps: Array, demands: list[TimeSeries]) -> Array:
    """(stamps, K)."""
    return np.stack([np.interp(stamps, d.time_s, c) for d in demands for c in d.columns.values()], axis=1)


def _silent(stamps: Array, demands: list[TimeSeries]) -> NDArray[np.bool_]:
    return np.asarray(demands[0].silent(stamps) | demands[1].silent(stamps))
