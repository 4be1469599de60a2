"""What a power module makes of the pack's current: scale, offset, filter, noise, steps."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np


@dataclass
class PowerModule:
    """A sensor between pack and ESCs; the usual ones read 0.1 A steps through a filter of a second."""

    scale: float = 1.0
    offset_A: float = 0.0
    delay_s: float = 0.0  # time constant of its filter
    noise_A: float = 0.0  # standard deviation of a reading
    step_A: float = 0.0  # 0: none
    seed: int = 0
    _kept: float = math.nan
    _random: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng([self.seed, 0xA3])

    def read(self, amps: float, since_s: float) -> float:
        """The reading of a current, `since_s` after the one before."""
        if math.isnan(self._kept):
            self._kept = amps
        part = 1.0 - math.exp(-since_s / self.delay_s) if self.delay_s > 0.0 else 1.0
        self._kept += part * (amps - self._kept)
        seen = self.scale * self._kept + self.offset_A + self.noise_A * self._random.standard_normal()
        return max(round(seen / self.step_A) * self.step_A if self.step_A > 0.0 else seen, 0.0)
