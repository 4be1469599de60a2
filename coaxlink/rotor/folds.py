"""Blocks of rows that are held out together: a sweep, a level, or a stretch where there are neither.

Neighbouring rows share drift, temperature and rig: an error on a row between fitted neighbours is too good.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coaxlink.data import Samples
from coaxlink.rotor.speeds import Speeds

STEP = 0.05  # of the speed range: a smaller change is not a new level
MOST_FOLDS = 12


def blocks(samples: Samples, speeds: Speeds) -> NDArray[np.int64]:
    """(rows,) block number of each row: runs of a constant slow axis, or ten stretches in log order."""
    candidates = []
    for side, u in (("upper", speeds.upper), ("lower", speeds.lower)):
        axis = samples[f"{side}_throttle"] if samples.has(f"{side}_throttle") else u
        span = np.ptp(axis)
        if span <= 0:
            continue
        new = np.concatenate([[0], np.cumsum(np.abs(np.diff(axis)) > STEP * span)])
        if 4 <= new[-1] + 1 <= samples.rows // 3:
            candidates.append(new)
    if candidates:
        return np.asarray(min(candidates, key=lambda b: b[-1]), np.int64)
    count = max(2, min(10, samples.rows // 3))
    return np.asarray(np.arange(samples.rows) * count // max(samples.rows, 1), np.int64)


def folds(block: NDArray[np.int64]) -> NDArray[np.int64]:
    """(rows,) fold number: a block each up to twelve, beyond that blocks are dealt out in turn."""
    count = int(block.max()) + 1
    return block if count <= MOST_FOLDS else block % MOST_FOLDS
