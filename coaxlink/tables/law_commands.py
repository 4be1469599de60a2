"""What a law demands of every rotor, to hold a firmware's mix against it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from firmware_params import px4


def wanted_mix(table: px4.Px4Table) -> NDArray[np.float64]:
    """(N, 4) A+ of a table: u^2 per N m of roll, pitch and yaw and per N of thrust."""
    columns = px4.effectiveness(table)
    matrix = np.stack([columns[0], columns[1], columns[2], -columns[5]])
    return np.asarray(np.linalg.pinv(matrix), np.float64)


def nearest(mixed: NDArray[np.float64], demanded: NDArray[np.float64]) -> NDArray[np.float64]:
    """Each column of `mixed` times the one number that brings it nearest to `demanded`."""
    power = (mixed**2).sum(axis=0)
    scale = np.divide((mixed * demanded).sum(axis=0), power, out=np.zeros(mixed.shape[1]), where=power > 0)
    return mixed * scale


def worst_relative(demanded: NDArray[np.float64], done: NDArray[np.float64]) -> tuple[float, ...]:
    """Largest difference of `done` from `demanded` on each axis, relative to the axis's largest entry."""
    scale = np.abs(demanded).max(axis=0)
    error = np.abs(done - demanded).max(axis=0)
    return tuple(float(e / s) if s else float(e) for e, s in zip(error, scale, strict=True))
