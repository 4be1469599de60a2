"""Messages of a flight log, each on its own stamps, brought onto the time base of the motor commands.

What arrives faster than the motor commands is averaged over one of their periods, so that vibration does
not alias; what arrives slower is interpolated. Stretches without data stay empty: they are left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.resolution import resolution_of
from coaxlink.data.samples import Samples
from coaxlink.errors import InputError

ANGLES = ("roll_rad", "pitch_rad", "yaw_rad")
STATES = ("armed", "landed")  # hold their last value
MOST_EMPTY = 100  # periods a motor command: a log with more pauses than this has damaged stamps
GAP_PERIODS = 5.0  # a pause longer than this many periods of a stream is a gap, not jitter


@dataclass(frozen=True)
class Stream:
    """Columns that share the stamps of one message."""

    time_s: NDArray[np.float64]  # (n,) increasing
    columns: Mapping[str, NDArray[np.float64]]  # each (n,)

    @classmethod
    def of(cls, time_s: NDArray[np.float64], columns: Mapping[str, NDArray[np.float64]]) -> Stream | None:
        """In the order of the stamps, repeated stamps and rows with NaN left out; None without two rows."""
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


def merge(
    source: str, motors: Stream | None, streams: Sequence[Stream | None], notes: Sequence[str]
) -> Samples:
    """All streams on a uniform grid at the motor commands' rate, time_s from the log's own stamps.

    Raises InputError when there are no motor commands, or nothing was measured while they ran.
    """
    if motors is None:
        raise InputError(source, "", "no motor commands in this log (two at least are expected)")
    measured = [stream for stream in streams if stream is not None]
    if not measured:
        raise InputError(source, "", "no motion in this log (accelerations, rates or attitude expected)")
    period = motors.period_s
    start = max([motors.time_s[0], *(s.time_s[0] for s in measured if _paces(s))])
    stop = min([motors.time_s[-1], *(s.time_s[-1] for s in measured if _paces(s))])
    first = motors.time_s[np.searchsorted(motors.time_s, start)] if start <= motors.time_s[-1] else start
    if (stop - first) / period > MOST_EMPTY * len(motors.time_s) + 1000:
        raise InputError(
            source, "", f"time stamps are damaged: {stop - first:.3g} s, {len(motors.time_s)} commands"
        )
    grid = np.arange(first, stop + 1e-9, period)
    if len(grid) < 2:
        raise InputError(source, "", "motor commands and motion do not overlap in time")
    keep = ~_in_gap(motors, grid)
    columns: dict[str, NDArray[np.float64]] = {"time_s": grid}
    steps: dict[str, float] = {}
    for stream in (motors, *measured):
        for name, column in stream.columns.items():
            steps[name] = resolution_of(column)
            columns[name] = _resampled(name, stream.time_s, column, grid, period)
        if _paces(stream):
            keep &= ~_in_gap(stream, grid)
    said = [f"{len(grid)} rows every {1e3 * period:.3g} ms, the rate of the motor commands"]
    if not keep.all():
        said.append(f"{int((~keep).sum())} rows left out where the log has gaps")
    samples = Samples(columns, source, (*notes, *said), resolution=steps).take(keep)
    if not samples.rows:
        raise InputError(source, "", "no stretch in which commands and motion were both logged")
    return samples


def _paces(stream: Stream) -> bool:
    """Whether the rows depend on this stream: motion, not batteries or states, which may pause."""
    return any(name.startswith(("motor", "accel", "gyro", "roll")) for name in stream.columns)


def _in_gap(stream: Stream, grid: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(grid,) True between two stamps that stand too far apart."""
    after = np.clip(np.searchsorted(stream.time_s, grid), 1, len(stream.time_s) - 1)
    width = stream.time_s[after] - stream.time_s[after - 1]
    return (width > max(GAP_PERIODS * stream.period_s, 0.1)) & (grid != stream.time_s[after])


def _resampled(
    name: str,
    time: NDArray[np.float64],
    values: NDArray[np.float64],
    grid: NDArray[np.float64],
    period: float,
) -> NDArray[np.float64]:
    if name in STATES:
        return values[np.clip(np.searchsorted(time, grid, side="right") - 1, 0, len(time) - 1)]
    if name in ANGLES:
        values = np.unwrap(values)
    if np.median(np.diff(time)) < 0.75 * period:
        values = _averaged(time, values, grid, period)
    else:
        values = np.interp(grid, time, values)
    return np.remainder(values + np.pi, 2 * np.pi) - np.pi if name in ANGLES else values


def _averaged(
    time: NDArray[np.float64], values: NDArray[np.float64], grid: NDArray[np.float64], period: float
) -> NDArray[np.float64]:
    """Mean of the straight-line interpolant over one period around each grid point."""
    area = np.concatenate([[0.0], np.cumsum(np.diff(time) * (values[1:] + values[:-1]) / 2)])

    def integral(at: NDArray[np.float64]) -> NDArray[np.float64]:
        i = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
        step = at - time[i]
        slope = (values[i + 1] - values[i]) / (time[i + 1] - time[i])
        return area[i] + step * (values[i] + slope * step / 2)

    low = np.clip(grid - period / 2, time[0], time[-1])
    high = np.clip(grid + period / 2, time[0], time[-1])
    width = np.maximum(high - low, 1e-12)
    return (integral(high) - integral(low)) / width


def euler_of(
    w: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    """Roll, pitch, yaw (ZYX, NED to FRD) of attitude quaternions."""
    return {
        "roll_rad": np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        "pitch_rad": np.arcsin(np.clip(2 * (w * y - z * x), -1, 1)),
        "yaw_rad": np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    }
