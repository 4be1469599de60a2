"""The paper's coaxial pair as the world turns it: eq. 17 surfaces, by Horner on dense coefficients.

Upper and lower thrust (N) and torque (N m) are polynomials of the normalised speeds u_u, u_l = rpm / top
(Berra, Trujillo and Heredia 2024, eq. 1-3, 17). The evaluation is the world's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

ORDER = 4  # highest power of either speed a rotor file may use


@dataclass(frozen=True)
class Pair:
    """A coaxial pair: coefficients[s, a, b] multiplies u_u^a u_l^b of surface s (rotors.SURFACES)."""

    speed_max_rpm: float
    coefficients: NDArray[np.float64]  # (4, ORDER + 1, ORDER + 1)

    @property
    def radius_m(self) -> float:
        """Of the disc; where a rotor file does not say: 18.5 in."""
        return 0.235

    def compiled(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """What the compiled plant turns: coefficients (4, A, B) up to the powers used, and no blades."""
        used = np.nonzero(self.coefficients.any(axis=0))
        top = max(int(axis.max(initial=0)) for axis in used) + 1
        return np.ascontiguousarray(self.coefficients[:, :top, :top]), np.empty(0)

    @property
    def cells(self) -> int | None:
        """In series, of the pack that it was measured on; None: not known."""
        return None

    @property
    def reference_V(self) -> float | None:  # noqa: N802
        """Supply at which commands mean what they mean; None: any."""
        return None

    def turned(self, upper: ArrayLike, lower: ArrayLike) -> NDArray[np.float64]:
        """(2, ...) steady normalised speeds at commands."""
        return np.stack(np.broadcast_arrays(np.asarray(upper, float), np.asarray(lower, float)))

    def watts(self, u_upper: ArrayLike, u_lower: ArrayLike) -> NDArray[np.float64] | None:
        """(2, ...) that both sides draw at normalised speeds; None: by their shafts."""
        return None

    def loads(self, u_upper: ArrayLike, u_lower: ArrayLike) -> NDArray[np.float64]:
        """(4, ...) upper thrust, upper torque, lower thrust, lower torque at normalised speeds."""
        upper, lower = np.broadcast_arrays(np.asarray(u_upper, float), np.asarray(u_lower, float))
        # (4, ORDER + 1, 1...): all surfaces and rows of powers at once
        terms = self.coefficients.reshape(*self.coefficients.shape, *[1] * upper.ndim)
        rows = np.zeros((4, ORDER + 1, *upper.shape))
        for b in range(ORDER, -1, -1):
            rows = rows * lower + terms[:, :, b]
        total = np.zeros((4, *upper.shape))
        for a in range(ORDER, -1, -1):
            total = total * upper + rows[:, a]
        return total
