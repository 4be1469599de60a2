"""A log of what is true, for a judge: the plant itself beside what its vehicle's sensors read."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.physics.plant import Plant

PLANT = (
    *("time_s", "pos_n_m", "pos_e_m", "pos_d_m", "vel_n_m_s", "vel_e_m_s", "vel_d_m_s"),
    *("q_w", "q_x", "q_y", "q_z", "rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s"),
    *("wind_n_m_s", "wind_e_m_s", "wind_d_m_s", "voltage_V", "current_A", "charge"),
)
ROTOR = ("speed", "thrust{}_N", "torque{}_Nm", "motor_current{}_A", "winding{}_K")


class TruthLog:
    """Rows are kept by `watch`."""

    def __init__(self) -> None:
        self._rows: list[NDArray[np.float64]] = []

    def watch(self, plant: Plant) -> None:
        """Note the plant as it is now."""
        wind = plant.parameters[plant.index.WIND : plant.index.WIND + 3]
        body = [[plant.time_s], plant.state[:13], wind, [plant.voltage, plant.current, plant.charge]]
        rotors = [plant.speeds, plant.thrust, plant.torque, plant.motor_currents, plant.windings]
        self._rows.append(np.concatenate([*body, *rotors]))

    def columns(self) -> dict[str, NDArray[np.float64]]:
        """(rows,) each; empty before anything was watched."""
        table = np.array(self._rows)
        rotors = (table.shape[1] - len(PLANT)) // len(ROTOR) if len(table) else 0
        names = [*PLANT]
        for name in ROTOR:
            names += [name.format(n) if "{}" in name else f"{name}{n}" for n in range(1, rotors + 1)]
        return dict(zip(names, table.T, strict=False))
