"""Linear mixers: squared speeds from the pseudo-inverse of one matrix, u^2 = A+ mu.

Standard mixer: Berra, Trujillo and Heredia 2024, eq. 18. Reduced coaxial mixer: eq. 7 and 15 (the paper
prints u = A+ mu; it is the squares).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coaxlink.airframe import Airframe
from coaxlink.errors import InputError
from coaxlink.mixer.coefficients import (
    ReducedCoefficients,
    StandardCoefficients,
    reduced_coefficients,
    standard_coefficients,
)
from coaxlink.mixer.law import checked_wrench
from coaxlink.vehicle import Vehicle


@dataclass(frozen=True)
class SquareLaw:
    """u^2 = A+ mu, clipped to 0 .. 1; what the clipping costs is not redistributed, as in the paper."""

    name: str
    matrix: NDArray[np.float64]  # (4, N) wrench per squared speed
    inverse: NDArray[np.float64]  # (N, 4)
    most: NDArray[np.float64]  # (N,) speeds at full command
    dropped: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"SquareLaw({self.name}, {len(self.most)} rotors)"

    def speeds(self, wrench: ArrayLike) -> NDArray[np.float64]:
        """Normalised speeds (N,) for a wrench (4,)."""
        return np.sqrt(np.clip(self.inverse @ checked_wrench(wrench), 0.0, self.most**2))


def square_law(name: str, vehicle: Vehicle, matrix: NDArray[np.float64]) -> SquareLaw:
    """The law of a (4, N) matrix. Raises InputError when the rotors cannot make all four axes."""
    airframe = vehicle.airframe
    scale = np.linalg.norm(matrix, axis=1, keepdims=True)
    if np.linalg.matrix_rank(matrix / np.where(scale > 0, scale, 1.0), tol=1e-9) < 4:
        raise InputError(
            airframe.source or airframe.name, "rotors", "these rotors cannot make thrust, roll, pitch and yaw"
        )
    return SquareLaw(name, matrix, np.asarray(np.linalg.pinv(matrix), np.float64), vehicle.full)


def reduced_matrix(airframe: Airframe, c: ReducedCoefficients) -> NDArray[np.float64]:
    """A (4, N) of eq. 7 and 15, wrench per squared speed, for any places, tilts and spins of the rotors."""
    n = len(airframe.rotors)
    thrust, torque = np.zeros((n, n)), np.zeros((n, n))  # load of rotor i per squared speed of rotor j
    for upper, lower in airframe.pairs:
        thrust[upper, upper], thrust[lower, lower], thrust[lower, upper] = c.p_0u, c.p_0l, c.p_1l
        torque[upper, upper], torque[lower, lower], torque[lower, upper] = c.q_0u, c.q_0l, c.q_1l
    for single in airframe.singles:
        thrust[single, single], torque[single, single] = c.p_0u, c.q_0u
    per_thrust, per_torque = airframe.effectiveness()
    thrust_gain, torque_gain = airframe.gains
    return (per_thrust * thrust_gain) @ thrust + (per_torque * torque_gain) @ torque


def standard_matrix(airframe: Airframe, c: StandardCoefficients) -> NDArray[np.float64]:
    """A (4, N) of eq. 18, wrench per squared speed, with the torque that its yaw row means."""
    per_thrust, per_torque = airframe.effectiveness()
    thrust_gain, torque_gain = airframe.gains
    return c.p * per_thrust * thrust_gain + c.q * per_torque * torque_gain


def reduced(vehicle: Vehicle) -> SquareLaw:
    """The reduced coaxial mixer of a vehicle."""
    return square_law(
        "reduced", vehicle, reduced_matrix(vehicle.airframe, reduced_coefficients(vehicle.model))
    )


def standard(vehicle: Vehicle) -> SquareLaw:
    """The standard mixer of a vehicle."""
    matrix = standard_matrix(vehicle.airframe, standard_coefficients(vehicle.model))
    return square_law("standard", vehicle, matrix)
