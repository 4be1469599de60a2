"""Messages of a flight log, each on its own stamps, brought onto the time base of the motor commands.

What arrives faster than the motor commands is averaged over one of their periods, so that vibration does
not alias; what arrives slower is interpolated. Stretches without data stay empty: they are left out.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.resolution import resolution_of
from coaxlink.data.samples import DAMAGED, Samples
from coaxlink.errors import InputError

Array = NDArray[np.float64]
Message = Mapping[str, Array]  # fields of one kind of message, each (n,) or (n, k), its stamps as time_s
ANGLES = ("roll_rad", "pitch_rad", "yaw_rad")
STATES = ("armed", "landed")  # hold their last value
MOST_EMPTY = 100  # periods a motor command: a log with more pauses than this has damaged stamps
GAP_PERIODS = 5.0  # a pause longer than this many periods of a series is a gap, not jitter
# what no sensor of a vehicle reads, in the units of our columns: accelerometers go to 200 g, gyros to
# 4000 deg/s; beyond is a damaged message
MOST_BY_QUANTITY = {"accel": 2e3, "gyro": 100.0, "vel": 1e3, "height": 1e5, "voltage": 2e3, "rpm": 1e6}
RARE_S = 0.25  # between two speeds of a rotor, which settles within a tenth of that
SELDOM = 0.1  # of the changes may follow another at once: rounding makes some pause, holding makes all


@dataclass(frozen=True)
class TimeSeries:
    """Columns that share the stamps of one message."""

    time_s: Array  # (n,) increasing
    columns: Mapping[str, Array]  # each (n,)

    @classmethod
    def of(cls, time_s: Array, columns: Mapping[str, NDArray[Any]]) -> TimeSeries | None:
        """In the order of the stamps, repeated stamps and rows with NaN left out; None without two rows."""
        if not columns:
            return None
        with np.errstate(invalid="ignore"):  # damaged logs hold numbers that are none: left out below
            stacked = np.stack([np.asarray(column, float) for column in columns.values()])
        good = np.isfinite(time_s) & np.isfinite(stacked).all(axis=0)
        time, index = np.unique(np.asarray(time_s, float)[good], return_index=True)
        if len(time) < 2:
            return None
        return cls(time, dict(zip(columns, stacked[:, good][:, index], strict=True)))

    @property
    def period_s(self) -> float:
        """The usual step between two stamps."""
        return float(np.median(np.diff(self.time_s)))

    def paces(self) -> bool:
        """Whether the rows of the log depend on it: motion, not batteries or states, which may pause."""
        return any(name.startswith(("motor", "accel", "gyro", "roll")) for name in self.columns)

    def has_gap(self, grid: Array) -> NDArray[np.bool_]:
        """(grid,) True between two stamps that stand too far apart."""
        after = np.clip(np.searchsorted(self.time_s, grid), 1, len(self.time_s) - 1)
        width = self.time_s[after] - self.time_s[after - 1]
        return (width > max(GAP_PERIODS * self.period_s, 0.1)) & (grid != self.time_s[after])

    def silent(self, grid: Array) -> NDArray[np.bool_]:
        """(grid,) True in a gap, before it begins and after it is over."""
        outside = (grid < self.time_s[0] - self.period_s) | (grid > self.time_s[-1] + self.period_s)
        return np.asarray(self.has_gap(grid) | outside)


def series(message: Message | None, fields: Mapping[str, str], scale: float = 1.0) -> TimeSeries | None:
    """Columns (our name: the message's field) times `scale`; None where one is not logged."""
    if message is None or any(f not in message for f in fields.values()):
        return None
    return TimeSeries.of(message["time_s"], {name: scale * message[f] for name, f in fields.items()})


def derived(
    message: Message | None, columns: Callable[[Message], Mapping[str, NDArray[Any]]]
) -> TimeSeries | None:
    """What is computed from a message, None where it is not logged."""
    return None if message is None else TimeSeries.of(message["time_s"], columns(message))


def rows_of(message: Message | None, mask: NDArray[np.bool_]) -> Message | None:
    """The rows of a mask (n,), None where there is none."""
    return {f: c[mask] for f, c in message.items()} if message is not None and mask.any() else None


def longest(*messages: Message | None) -> Message | None:
    """The one with most rows, the first of equals."""
    return max((m for m in messages if m is not None), key=lambda m: len(m["time_s"]), default=None)


def euler_of(quaternions: Sequence[Array]) -> dict[str, Array]:
    """Roll, pitch, yaw (ZYX, NED to FRD) of attitude quaternions, w first."""
    w, x, y, z = quaternions
    return {
        "roll_rad": np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        "pitch_rad": np.arcsin(np.clip(2 * (w * y - z * x), -1, 1)),
        "yaw_rad": np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    }


def possible(others: Sequence[TimeSeries | None], premises: list[str]) -> list[TimeSeries]:
    """Series without the rows that no sensor reads; where there were any, the log is damaged."""
    found = []
    for one in others:
        if one is None:
            continue
        limits = {name: MOST_BY_QUANTITY.get(re.split(r"[_\d]", name)[0], np.inf) for name in one.columns}
        sound = np.logical_and.reduce([np.abs(one.columns[n]) <= limits[n] for n in limits])
        if sound.all():
            found.append(one)
            continue
        premises.append(DAMAGED)
        rest = TimeSeries.of(one.time_s[sound], {n: c[sound] for n, c in one.columns.items()})
        found += [rest] if rest is not None else []
    return found


def merge(
    source: str, motors: TimeSeries | None, others: Sequence[TimeSeries | None], notes: Sequence[str]
) -> Samples:
    """All series on a uniform grid at the motor commands' rate, time_s from the log's own stamps.

    Raises InputError when there are no motor commands, or nothing was measured while they ran.
    """
    if motors is None:
        raise InputError(source, "", "no motor commands in this log (two at least are expected)")
    measured = [one for one in others if one is not None]
    if not measured:
        raise InputError(source, "", "no motion in this log (accelerations, rates or attitude expected)")
    period = motors.period_s
    pacing = [motors, *(s for s in measured if s.paces())]
    start, stop = max(s.time_s[0] for s in pacing), min(s.time_s[-1] for s in pacing)
    first = motors.time_s[np.searchsorted(motors.time_s, start)] if start <= motors.time_s[-1] else start
    if (stop - first) / period > MOST_EMPTY * len(motors.time_s) + 1000:
        raise InputError(
            source, "", f"time stamps are damaged: {stop - first:.3g} s, {len(motors.time_s)} commands"
        )
    grid = np.arange(first, stop + 1e-9, period)
    if len(grid) < 2:
        raise InputError(source, "", "motor commands and motion do not overlap in time")
    columns: dict[str, Array] = {"time_s": grid}
    steps: dict[str, float] = {}
    for one in (motors, *measured):
        for name, column in one.columns.items():
            steps[name] = resolution_of(column)
            values = _resampled(name, one.time_s, column, grid, period)
            columns[name] = np.where(one.silent(grid), np.nan, values) if name.startswith("rpm") else values
    rare = [n for one in measured if one.period_s > RARE_S for n in one.columns if n.startswith("rpm")]
    keep = ~np.logical_or.reduce([one.has_gap(grid) for one in pacing])
    reported = [f"{len(grid)} rows every {1e3 * period:.3g} ms, the rate of the motor commands"]
    if not keep.all():
        reported.append(f"{int((~keep).sum())} rows left out where the log has gaps")
    if rare:
        every = max(one.period_s for one in measured if rare[0] in one.columns)
        reported.append(
            f"{len(rare)} rotors' rpm come every {every:.2g} s: rows between them hold none (NaN)"
        )
    samples = Samples(columns, source, (*notes, *reported), resolution=steps).take(keep)
    if not samples.rows:
        raise InputError(source, "", "no stretch in which commands and motion were both logged")
    return samples


def _resampled(name: str, time: Array, values: Array, grid: Array, period: float) -> Array:
    if name in STATES:
        return values[np.clip(np.searchsorted(time, grid, side="right") - 1, 0, len(time) - 1)]
    if name in ANGLES:
        values = np.unwrap(values)
    step = float(np.median(np.diff(time)))
    if name.startswith("rpm") and step > RARE_S:  # what lies between two of them is not known
        after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
        nearest = after - (grid - time[after - 1] < time[after] - grid)
        return np.where(np.abs(time[nearest] - grid) <= period / 2, values[nearest], np.nan)
    fast = step < 0.75 * period
    values = _averaged(time, values, grid, period) if fast else np.interp(grid, time, values)
    return np.remainder(values + np.pi, 2 * np.pi) - np.pi if name in ANGLES else values


def _averaged(time: Array, values: Array, grid: Array, period: float) -> Array:
    """Mean of the straight-line interpolant over one period around each grid point."""
    area = np.concatenate([[0.0], np.cumsum(np.diff(time) * (values[1:] + values[:-1]) / 2)])

    def integral(at: Array) -> Array:
        i = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
        step = at - time[i]
        slope = (values[i + 1] - values[i]) / (time[i + 1] - time[i])
        return area[i] + step * (values[i] + slope * step / 2)

    low = np.clip(grid - period / 2, time[0], time[-1])
    high = np.clip(grid + period / 2, time[0], time[-1])
    return (integral(high) - integral(low)) / np.maximum(high - low, 1e-12)


def at_the_commands(samples: Samples, motors: list[str]) -> Samples:
    """A table at the rate of its commands, or as it is where they move from row to row.

    Commands of 10 Hz written into rows of 100 Hz by holding them are late by half a step on average and full
    of corners, which no motor saw. The rows at which they change are the log's own; all else is averaged onto
    them, as from any log whose commands are its slowest series.
    """
    commands = np.stack([samples[name] for name in motors], axis=1)
    moves = np.flatnonzero(np.any(np.diff(commands, axis=0) != 0.0, axis=1)) + 1
    if len(moves) < 20:
        return samples
    gaps = np.diff(moves)
    every = int(np.median(gaps))
    if every < 2 or np.quantile(gaps, SELDOM) < 2:
        return samples
    edges = [0, *moves.tolist(), samples.rows]
    pauses = [
        np.arange(a + every, b - every // 2, every) for a, b in pairwise(edges)
    ]  # nothing changes for long
    rows = np.unique(np.concatenate([[0], moves, *pauses]))
    time = samples["time_s"]
    rest = samples.without(*motors, "time_s")
    note = f"commands were logged every {every} rows and held between: the log is taken at their rate"
    merged = merge(
        samples.source,
        TimeSeries.of(time[rows], {name: samples[name][rows] for name in motors}),
        [TimeSeries.of(time, {name: rest[name] for name in rest.columns})],
        (*samples.notes, note),
    )
    return replace(merged, premises=samples.premises)
