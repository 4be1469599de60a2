"""Residual check: an effect that leaves most of what is above the noise is not its cause.

Nor is one that mends nothing where far more is wrong, or for which another load pays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coaxlink.residual.regression.irls import channel_errors
from coaxlink.residual.regression.joint_model import Joint

Array = NDArray[np.float64]

CLEAR = 1.5  # of the noise, without the effect
PAYS = 2.0  # judgement: of the noise, and of the error without it: a load that errs so pays for the effect
SEEN = 1.02  # judgement: of the error with it; less is no mend
# with it, of the noise; and what it then must have taken of the squares above the noise
ENOUGH = ((1.2, 0.5), (3.0, 0.7))


def minor(joint: Joint, floor: Array) -> set[str]:
    """Names of members that nowhere take most of what is above the noise `floor` (C,), or do harm."""
    q = joint.problem
    enough = (
        ENOUGH[1:] if q.fitted_nuisance else ENOUGH
    )  # a nuisance model fitted to the log leaves more of its own
    noise = np.maximum(floor, 1e-12)
    found = set()
    after = channel_errors(q, q.options) / noise
    for option in q.options:
        before = channel_errors(q, [o for o in q.options if o is not option]) / noise
        clear = (before > CLEAR) & (before > SEEN * after)
        taken = (before**2 - after**2) / np.maximum(before**2 - 1.0, 1e-9)
        if any(np.any(clear & (after > left)) and np.all(taken[clear] < least) for left, least in enough):
            found.add(option.name)
        if np.any((after > PAYS) & (after > PAYS * before)):
            found.add(option.name)
        acts = np.any(q.design[:, :, option.columns] != 0.0, axis=(0, 2))
        if np.all(before <= SEEN * after) and np.any(acts & (after > enough[-1][0])):
            found.add(option.name)  # it mends nothing, and far more is wrong where it acts
    return found
