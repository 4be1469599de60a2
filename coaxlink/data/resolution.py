"""The resolution of a column, read from the column: a reading that was rounded moves in steps.

Autopilots send what their sensors read as whole numbers (ArduPilot's RAW_IMU and SCALED_IMU: 1 mg and
1 mrad/s), logs keep so many digits. A column that is coarse against what it measures repeats itself for that
reason, and its rounding is a noise of step^2 / 12 (Widrow and Kollar, Quantization Noise, 2008).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

EXACT = 1e-6  # of the largest value: differences below are the numbers' own last bits
# a tenth of the readings that differ from the one before do so by no more than two steps: where little moves,
# many will not differ at all. Of a sensor whose noise is a hundred steps one in a hundred does
COARSE, SHARE = 2.0, 0.1


def resolution_of(values: NDArray[np.float64]) -> float:
    """The smallest step between distinct values of (rows,); NaN where there is only one."""
    known = values[np.isfinite(values)]
    if not len(known):
        return float("nan")
    steps = np.diff(np.unique(known))
    steps = steps[steps > EXACT * max(float(np.max(np.abs(known))), 1e-300)]
    return float(steps.min()) if len(steps) else float("nan")


def is_coarse(values: NDArray[np.float64], step: float) -> bool:
    """Whether (rows,) moves, where it moves little, by so few steps that it repeats itself for that alone."""
    moved = np.abs(np.diff(values[np.isfinite(values)]))
    moved = moved[moved > 0.0]
    return bool(np.isfinite(step) and len(moved) and np.quantile(moved, SHARE) <= COARSE * step)
