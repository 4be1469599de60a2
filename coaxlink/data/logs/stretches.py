"""A flight log as its stretches: it is cut where its clock goes back or its board started again, and nothing
of two stretches ever stands in one table. The one gate of tlog, ULog and DataFlash.

A reader gives the stamps of its paced messages in the order of the file (`Stream`), cuts what it holds at
`cuts`, and reads every part by itself in `each_stretch`, which says what was cut and what was left.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.samples import Samples
from coaxlink.errors import InputError

Part = TypeVar("Part")
LONE = 5  # stamps, of which the middle one counts: one or two that are damaged or late are no restart
ONBOARD_S = 0.1  # by which stamps may go back on board: an estimator's when another takes over, some ms
LATE_S = 1.0  # by which a link may exchange messages; no board starts in less
UNHEARD_S = 30.0  # by which recorder and board may differ over a pause: a link's buffers hold seconds
BESIDE = 0.1  # of the steps: a link exchanges some packets; above, two clocks run beside one another


@dataclass(frozen=True)
class Stream:
    """Messages of one kind, in the order of the file."""

    at: NDArray[np.int64]  # (n,) place in the file, increasing
    stamp_s: NDArray[np.float64]  # (n,) the board's clock
    heard_s: NDArray[np.float64] | None = None  # (n,) the recorder's, where there is one


def cuts(source: str, streams: Iterable[Stream], late_s: float, begins: Iterable[int] = ()) -> list[int]:
    """Places in the file at which a new stretch begins, increasing; `begins` are known to be some.

    Raises InputError for two boards at once, and for stamps of one board that do not go on.

    >>> clock = np.r_[0:12.0:0.02, 3.0:9.0:0.02]
    >>> cuts("two.bin", [Stream(np.arange(len(clock)), clock)], ONBOARD_S)
    [600]
    """
    # first place after a restart, last place before it, of each stream
    between = [(place, place - 1) for place in begins]
    for stream in streams:
        good = np.isfinite(stream.stamp_s)
        at, clock = stream.at[good], stream.stamp_s[good]
        if len(at) < LONE:
            continue
        step = np.diff(clock)
        # on board several sensors write one moment; over a link one moment is one message
        if np.mean(step < 0.0 if stream.heard_s is None else step <= 0.0) > BESIDE:
            problem = (
                "its clock goes back again and again: the file is damaged"
                if stream.heard_s is None  # a board writes its own log, and no other's
                else "two boards under one number: their clocks run beside one another; give each its own"
            )
            raise InputError(source, "", problem)
        starts = np.diff(_middle(clock)) < -late_s
        if stream.heard_s is not None:
            paused = np.diff(stream.heard_s[good])
            # a board that was started in a pause runs for less than that pause
            starts |= (step > late_s) & (paused - step > UNHEARD_S) & (clock[1:] < paused)
        between += [(int(at[i + 1]), int(at[i])) for i in np.flatnonzero(starts)]
    found: list[int] = []
    for after, before in sorted(between):
        if not found or before >= found[-1]:
            found.append(after)
    return found


def joined(heard_s: NDArray[np.float64]) -> NDArray[np.intp]:
    """Places at which another recording begins, in the recorder's clock of every frame (n,) of a file.

    >>> joined(np.r_[600.0:700.0, 0.0:50.0])
    array([100])
    """
    return np.flatnonzero(np.diff(_middle(heard_s)) < -UNHEARD_S) + 1


def _middle(clock: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) the middle one of LONE stamps around each."""
    half = LONE // 2
    padded = np.pad(clock, half, mode="reflect")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, LONE), axis=1))


def each_stretch(source: str, parts: Sequence[Part], read: Callable[[Part], Samples]) -> list[Samples]:
    """Every stretch of a log that can be read, each with what must be reported of the whole.

    Raises InputError where none can, as the first does.
    """
    found: list[Samples] = []
    reported: list[str] = []
    problems: list[InputError] = []
    for number, part in enumerate(parts, 1):
        try:
            one = read(part)
        except InputError as error:
            problems.append(error)
            reported.append(f"number {number} is not read ({error.problem})")
            continue
        if len(parts) == 1:
            return [one]
        found.append(replace(one, source=f"{source}, stretch {number} of {len(parts)}"))
        reported.append(f"{one['time_s'][-1] - one['time_s'][0]:.3g} s")
    if not found:
        raise problems[0]
    why = "its clock goes back or its board started again in between"
    words = f"{source}: {len(parts)} stretches, {' and '.join(reported)}: {why}"
    return [replace(one, provenance=(words, *one.provenance)) for one in found]
