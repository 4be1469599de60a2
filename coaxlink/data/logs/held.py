"""Commands that stand in a table more often than they were logged: the rows between hold the last one.

A stream of 10 Hz written into rows of 100 Hz by holding its values is late by half a step on average and full
of corners, which no motor saw. The rows at which commands change are the log's own; all else is averaged onto
them, as from any log whose commands are its slowest stream.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.logs.streams import Stream, merge
from coaxlink.data.samples import Samples

SELDOM = 0.1  # of the changes may follow another at once: rounding makes some pause, holding makes all


def at_the_commands(samples: Samples, motors: list[str]) -> Samples:
    """The log at the rate of its commands, or as it is where they move from row to row."""
    commands = np.stack([samples[name] for name in motors], axis=1)
    moves = np.flatnonzero(np.any(np.diff(commands, axis=0) != 0.0, axis=1)) + 1
    if len(moves) < 20:
        return samples
    gaps = np.diff(moves)
    every = int(np.median(gaps))
    if every < 2 or np.quantile(gaps, SELDOM) < 2:
        return samples
    rows = _with_pauses(moves, every, samples.rows)
    time = samples["time_s"]
    at_commands = Stream.of(time[rows], {name: samples[name][rows] for name in motors})
    rest = [name for name in samples.columns if name not in (*motors, "time_s")]
    note = f"commands were logged every {every} rows and held between: the log is taken at their rate"
    streams = [Stream.of(time, {name: samples[name] for name in rest})]
    return merge(samples.source, at_commands, streams, (*samples.notes, note))


def _with_pauses(moves: NDArray[np.intp], every: int, count: int) -> NDArray[np.intp]:
    """The rows of changes, and one in `every` where nothing changes for long."""
    edges = np.concatenate([[0], moves, [count]])
    filled = [np.arange(a + every, b - every // 2, every) for a, b in pairwise(edges.tolist())]
    return np.unique(np.concatenate([[0], moves, *filled]))
