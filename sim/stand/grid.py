"""A virtual thrust stand: the paper's grid of steady points on a coaxial pair, to CSV.

11 x 11 normalised speeds from 0 to 0.9 (Berra, Trujillo and Heredia 2024, section 3), white noise on the load
cells, a regulated supply.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.documents import write_atomic
from sim.physics.pair import Pair

GRID = tuple(round(0.09 * i, 2) for i in range(11))
THRUST_NOISE_N = 0.5
TORQUE_NOISE_NM = 0.01
SECONDS_A_POINT = 2.0
SUPPLY_V = 33.6
COLUMNS = (
    "time_s",
    "upper_rpm",
    "lower_rpm",
    "upper_throttle",
    "lower_throttle",
    "upper_thrust_N",
    "upper_torque_Nm",
    "lower_thrust_N",
    "lower_torque_Nm",
    "voltage_V",
)


def stand_rows(
    pair: Pair,
    *,
    seed: int = 0,
    thrust_noise_N: float = THRUST_NOISE_N,
    torque_noise_Nm: float = TORQUE_NOISE_NM,
) -> NDArray[np.float64]:
    """(121, len(COLUMNS)) readings of the grid, the lower rotor's speed swept at each upper speed."""
    random = np.random.default_rng(seed)
    upper, lower = (axis.ravel() for axis in np.meshgrid(GRID, GRID, indexing="ij"))
    loads = pair.loads(upper, lower)
    sigma = np.array([thrust_noise_N, torque_noise_Nm, thrust_noise_N, torque_noise_Nm])
    loads = loads + sigma[:, None] * random.standard_normal(loads.shape)
    time = SECONDS_A_POINT * np.arange(1, len(upper) + 1)
    voltage = SUPPLY_V + 0.01 * random.standard_normal(len(upper))
    rpm = pair.speed_max_rpm
    return np.column_stack([time, rpm * upper, rpm * lower, upper, lower, *loads, voltage])


def write_stand(path: Path, rows: NDArray[np.float64], columns: Sequence[str] = COLUMNS) -> None:
    """Write readings (rows, columns) as a stand log, whole or not at all. Raises WorldError."""
    digits = {"time_s": 2, "upper_rpm": 1, "lower_rpm": 1, "voltage_V": 3, "air_pressure_Pa": 0}
    lines = [",".join(columns)]
    lines += [
        ",".join(f"{value:.{digits.get(name, 4)}f}" for name, value in zip(columns, row, strict=True))
        for row in rows
    ]
    write_atomic(path, "\n".join(lines) + "\n")
