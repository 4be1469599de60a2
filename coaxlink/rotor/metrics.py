"""Errors as the paper's Table 2 gives them, on rows the fit did not use."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

NORMALISER = "max - min of the held-out measurements"  # the paper uses two and names neither


@dataclass(frozen=True)
class ChannelError:
    """Held-out error of one channel."""

    rmse: float  # N or N m
    nrmse: float  # rmse / (max - min of the held-out measurements)
    r: float  # Pearson correlation of measured and predicted
    held_out_rows: int

    def as_json(self) -> dict[str, float | int]:
        """Plain numbers for the JSON report."""
        return {"rmse": self.rmse, "nrmse": self.nrmse, "r": self.r, "held_out_rows": self.held_out_rows}


def channel_error(measured: NDArray[np.float64], predicted: NDArray[np.float64]) -> ChannelError:
    """Error over the rows (n,) in which both are known (not NaN)."""
    known = np.isfinite(measured) & np.isfinite(predicted)
    y, p = measured[known], predicted[known]
    if not len(y):
        return ChannelError(0.0, 0.0, 0.0, 0)
    rmse = float(np.sqrt(np.mean((y - p) ** 2)))
    span = float(np.ptp(y))
    spread = float(np.std(y) * np.std(p))
    r = float(np.mean((y - y.mean()) * (p - p.mean())) / spread) if spread > 0 else 0.0
    return ChannelError(rmse, rmse / span if span > 0 else 0.0, r, len(y))
