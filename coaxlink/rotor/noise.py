"""How small an error the data allow: scatter between neighbours once a rich model is taken off."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def noise_floor(
    upper: NDArray[np.float64], lower: NDArray[np.float64], residual: NDArray[np.float64], terms: int
) -> float:
    """Root mean square of the noise in one channel, from differences between nearest neighbours.

    Speeds and residual of a rich fit are (n,); `terms` is what the fit took off the degrees of freedom.
    """
    from scipy.spatial import cKDTree

    known = np.isfinite(residual)
    points = np.column_stack([upper[known], lower[known]])
    values = residual[known]
    if len(values) < 4:
        return 0.0
    _, index = cKDTree(points).query(points, k=2)
    own = np.arange(len(values))
    other = np.where(index[:, 0] == own, index[:, 1], index[:, 0])
    pairs = np.unique(np.sort(np.column_stack([own, other]), axis=1), axis=0)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    difference = values[pairs[:, 0]] - values[pairs[:, 1]]
    spare = max(1.0 - terms / len(values), 0.1)
    return float(np.sqrt(np.mean(difference**2) / 2 / spare))
