"""How far residuals hang together in time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]


def autocorrelation_time(residual: Array, block: Index) -> Array:
    """(C,) variance inflation of sums of residuals (rows, C): 1 + 2 sum rho, summed while rho is positive."""
    same = [block[k:] == block[:-k] for k in range(1, 60) if k < len(block)]
    out = np.ones(residual.shape[1])
    for c in range(residual.shape[1]):
        r = residual[:, c]
        power = float(np.mean(r * r)) or 1.0
        for k, inside in enumerate(same, start=1):
            if inside.sum() < 30:
                break
            rho = float(np.mean(r[k:][inside] * r[:-k][inside])) / power
            if rho < 0.05:
                break
            out[c] += 2.0 * rho
    return out
