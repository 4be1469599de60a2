"""Residual check: an effect that leaves most of what is above the noise is not its cause."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coaxlink.residual.regression.irls import channel_errors
from coaxlink.residual.regression.joint_model import Joint

Array = NDArray[np.float64]

CLEAR = 1.5  # of the noise, without the effect
# with it, of the noise; and what it then must have taken of the squares above the noise
ENOUGH = ((1.2, 0.5), (3.0, 0.7))


def minor(joint: Joint, floor: Array) -> set[str]:
    """Names of members that nowhere take most of what is above the noise `floor` (C,), and leave much."""
    q = joint.problem
    enough = ENOUGH[1:] if q.fitted_base else ENOUGH  # a base fitted to the log leaves more of its own
    noise = np.maximum(floor, 1e-12)
    found = set()
    after = channel_errors(q, q.options) / noise
    for option in q.options:
        before = channel_errors(q, [o for o in q.options if o is not option]) / noise
        clear = (before > CLEAR) & (before > 1.02 * after)
        taken = (before**2 - after**2) / np.maximum(before**2 - 1.0, 1e-9)
        if any(np.any(clear & (after > left)) and np.all(taken[clear] < least) for left, least in enough):
            found.add(option.name)
    return found
