"""Effects that begin in mid-flight: a blade chips, a payload falls."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from coaxlink.effects.tracing import Array, Shape
from coaxlink.frames import FlightFrame

MARGIN_S = 3.0  # of flight on either side


def since(frame: FlightFrame, shape: Mapping[str, float]) -> Array:
    """(rows,) 0 before the shape's onset, 1 behind it, straight over one row; 1 where it names none."""
    if "onset_s" not in shape:
        return np.ones(len(frame.time_s))
    after: Array = np.clip((frame.time_s - shape["onset_s"]) * frame.rate_hz + 0.5, 0.0, 1.0)
    return after


def onset_limits(frame: FlightFrame, shape: Shape) -> Mapping[str, tuple[float, float]]:
    """Where the onset may lie: with some flight before and behind it."""
    if "onset_s" not in shape:
        return {}
    flown = frame.time_s[frame.keep]
    return {"onset_s": (float(flown[0]) + MARGIN_S, float(flown[-1]) - MARGIN_S)}
