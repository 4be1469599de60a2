"""Effects that begin in mid-flight: a blade chips, a payload falls."""

from __future__ import annotations

import numpy as np

from coaxlink.effects.parameter import Numbers, Parameter, Range
from coaxlink.effects.tracing import Array
from coaxlink.frames import FlightFrame

COMES = ("onset_s", "over_s")  # numbers: when, and how long it takes
MARGIN_S = 3.0  # of flight on either side
LONGEST_S = (0.0, 1e6)  # of a log


def since(frame: FlightFrame, p: Numbers) -> Array:
    """(rows,) 0 before the onset, 1 behind it, straight between; 1 where there is none.

    From 0 to 1 it takes `over_s`, a row at the least.
    """
    if "onset_s" not in p:
        return np.ones(len(frame.time_s))
    row = 1.0 / frame.rate_hz
    over = max(p.get("over_s", 0.0), row)
    after: Array = np.clip((frame.time_s - p["onset_s"] + 0.5 * row) / over, 0.0, 1.0)
    return after


def _flown(frame: FlightFrame) -> Range:
    flown = frame.time_s[frame.keep]
    return float(flown[0]), float(flown[-1])


def _when(frame: FlightFrame | None, p: Numbers) -> Range:
    """With some flight before and behind it; what comes gradually may have begun before the log did."""
    if frame is None:
        return LONGEST_S
    first, last = _flown(frame)
    return first + (0.0 if "over_s" in p else MARGIN_S), last - MARGIN_S


def _how_long(frame: FlightFrame | None, _: Numbers) -> Range:
    if frame is None:
        return LONGEST_S
    first, last = _flown(frame)
    return 0.0, last - first


ONSET = (
    Parameter("onset_s", "s", *LONGEST_S, moves=True, within=_when,
        source="wide: any value between the bounds; the second of the log at which it began"),
    Parameter("over_s", "s", *LONGEST_S, moves=True, within=_how_long,
        source="wide: any value between the bounds; the seconds that it took: a tank, a sliding load"),
)  # fmt: skip
