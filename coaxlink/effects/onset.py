"""Effects that begin in mid-flight: a blade chips, a payload falls."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from coaxlink.effects.base import Parameter
from coaxlink.effects.tracing import Array, Shape
from coaxlink.frames import FlightFrame

COMES = ("onset_s", "over_s")  # shape numbers: when, and how long it takes
GRADUAL = (0.3, 0.9)  # of the rest of the flight: shares to begin a search with
MARGIN_S = 3.0  # of flight on either side


def since(frame: FlightFrame, shape: Mapping[str, float]) -> Array:
    """(rows,) 0 before the shape's onset, 1 behind it, straight between; 1 where it names none.

    From 0 to 1 it takes `over_s`, a row at the least.
    """
    if "onset_s" not in shape:
        return np.ones(len(frame.time_s))
    row = 1.0 / frame.rate_hz
    over = max(shape.get("over_s", 0.0), row)
    after: Array = np.clip((frame.time_s - shape["onset_s"] + 0.5 * row) / over, 0.0, 1.0)
    return after


def onset_limits(frame: FlightFrame, shape: Shape) -> Mapping[str, tuple[float, float]]:
    """Where the onset may lie: with some flight before and behind it; and how long it may take."""
    if "onset_s" not in shape:
        return {}
    flown = frame.time_s[frame.keep]
    first, last = float(flown[0]), float(flown[-1])
    if "over_s" not in shape:
        return {"onset_s": (first + MARGIN_S, last - MARGIN_S)}
    # gradual: it may have begun before the log did
    return {"onset_s": (first, last - MARGIN_S), "over_s": (0.0, last - first)}


def gradual(frame: FlightFrame, shape: Shape) -> list[Shape]:
    """A sudden shape as one that comes gradually, over a part or the rest of the flight."""
    if "onset_s" not in shape or "over_s" in shape:
        return []
    flown = frame.time_s[frame.keep]
    left = float(flown[-1]) - shape["onset_s"]
    return [{**shape, "over_s": share * left} for share in GRADUAL]


OVER = Parameter(
    "over_s",
    "s",
    0.0,
    1e5,
    source="wide: any value between the bounds; the seconds that it took to come: a tank, a sliding load",
)
