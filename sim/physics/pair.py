"""The paper's coaxial pair as the world turns it: eq. 17 surfaces, by Horner on dense coefficients.

Upper and lower thrust (N) and torque (N m) are polynomials of the normalised speeds u_u, u_l = rpm / top
(Berra, Trujillo and Heredia 2024, eq. 1-3, 17). The evaluation is the world's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

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

    def compiled(self) -> tuple[Any, Any, Any]:
        """What the compiled plant turns: 24 coefficients of eq. 17, any powers, or blades; else None."""
        c = self.coefficients
        used = np.nonzero(c.any(axis=0))
        top = max(2, *(int(axis.max(initial=0)) for axis in used)) + 1
        if top > 3 or c[:2, :, 1:].any():
            return None, np.ascontiguousarray(c[:, :top, :top]), None
        upper = [c[s, a, 0] for s in (0, 1) for a in (2, 1, 0)]
        lower = [c[s, a, b] for s in (2, 3) for a in (2, 1, 0) for b in (2, 1, 0)]
        return tuple(float(x) for x in upper + lower), None, None

    def loads(self, u_upper: ArrayLike, u_lower: ArrayLike) -> NDArray[np.float64]:
        """(4, ...) upper thrust, upper torque, lower thrust, lower torque at normalised speeds."""
        upper, lower = np.broadcast_arrays(np.asarray(u_upper, float), np.asarray(u_lower, float))
        total = np.zeros((4, *upper.shape))
        for s in range(4):
            for a in range(ORDER, -1, -1):
                row = np.zeros(upper.shape)
                for b in range(ORDER, -1, -1):
                    row = row * lower + self.coefficients[s, a, b]
                total[s] = total[s] * upper + row
        return total
