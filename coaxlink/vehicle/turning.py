"""What effects of the drive leave of a speed: nominal speeds to true ones, and back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
TOP, POINTS = 1.6, 4097  # normalised speeds of the tabulated inverse


@dataclass(frozen=True)
class Turning:
    """True speeds are `bends` of `share` of the nominal ones, which the commands alone would give."""

    share: float = 1.0
    bends: Sequence[Callable[[Array], Array]] = field(default=())

    def true(self, nominal: ArrayLike) -> Array:
        """Normalised speeds (...) that rotors turn at where the drive alone would give these (...)."""
        u = self.share * np.asarray(nominal, float)
        for bend in self.bends:
            u = bend(u)
        return u

    def nominal(self, speeds: ArrayLike) -> Array:
        """The inverse: what has to be commanded for true speeds (...)."""
        u = np.asarray(speeds, float)
        if not self.bends:
            return u / self.share
        grid, bent = self._table
        return np.asarray(np.interp(u, bent, grid))

    @cached_property
    def _table(self) -> tuple[Array, Array]:
        grid = np.linspace(0.0, TOP, POINTS)
        # a dead band gives no speed for many commands: a slope too small to be felt orders them
        return grid, np.maximum.accumulate(self.true(grid)) + 1e-12 * np.arange(POINTS)
