"""The rotors of one airframe as plain numbers: speeds to loads to wrench in tens of microseconds.

The same physics as `Airframe.loads` and `Airframe.wrench`, for laws and the live loop, which ask one point
at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import mul

import numpy as np
from numpy.typing import NDArray

from coaxlink.mixer.surface import Surface
from coaxlink.vehicle import Vehicle


@dataclass(frozen=True)
class PlainRotors:
    """Pairs and singles with their four surfaces, and what each load does to the body."""

    pairs: tuple[tuple[int, int], ...]  # (upper, lower) indices
    singles: tuple[int, ...]
    upper_thrust: Surface
    upper_torque: Surface
    lower_thrust: Surface
    lower_torque: Surface
    per_load: NDArray[np.float64]  # (4, 2N) wrench per unit thrust of the model at each rotor, then torque
    rows: tuple[tuple[float, ...], ...]  # the same
    gains: tuple[tuple[float, float], ...]  # (N,) thrust and torque of each rotor over the model's

    @classmethod
    def of(cls, vehicle: Vehicle) -> PlainRotors:
        """The rotors of `vehicle`, each with its own gains."""
        airframe, model = vehicle.airframe, vehicle.model
        per_thrust, per_torque = airframe.effectiveness()
        thrust_gain, torque_gain = airframe.gains
        return cls(
            airframe.pairs,
            airframe.singles,
            Surface.of(model.upper_thrust),
            Surface.of(model.upper_torque),
            Surface.of(model.lower_thrust),
            Surface.of(model.lower_torque),
            per_load := np.concatenate([per_thrust * thrust_gain, per_torque * torque_gain], axis=1),
            tuple(map(tuple, per_load.tolist())),
            tuple((float(f), float(q)) for f, q in zip(thrust_gain, torque_gain, strict=True)),
        )

    def wrench(self, speeds: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
        """(4,) wrench of normalised speeds (N,)."""
        return np.array(self.plain_wrench(speeds))

    def plain_wrench(self, speeds: Sequence[float] | NDArray[np.float64]) -> list[float]:
        """`wrench` as a list, without an array made."""
        loads = self.loads(speeds)
        return [sum(map(mul, row, loads)) for row in self.rows]

    def loads(self, speeds: Sequence[float] | NDArray[np.float64]) -> list[float]:
        """(2N,) thrusts, then torques, by the model: without the rotors' own gains, which `per_load` has."""
        n = self.per_load.shape[1] // 2
        loads = [0.0] * (2 * n)
        for a, b in self.pairs:
            upper, lower = float(speeds[a]), float(speeds[b])
            loads[a], loads[n + a] = (
                self.upper_thrust.value(upper, lower),
                self.upper_torque.value(upper, lower),
            )
            loads[b], loads[n + b] = (
                self.lower_thrust.value(upper, lower),
                self.lower_torque.value(upper, lower),
            )
        for i in self.singles:
            u = float(speeds[i])
            loads[i], loads[n + i] = self.upper_thrust.value(u, 0.0), self.upper_torque.value(u, 0.0)
        return loads
