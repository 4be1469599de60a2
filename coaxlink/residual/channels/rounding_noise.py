"""The noise that rounding leaves in a residual: step^2 / 12 of each axis, as the low-pass passes it.

White as rounding is where a signal moves by more than a step from row to row (Widrow and Kollar, Quantization
Noise, 2008); it is a lower bound for the noise floor, which sees the rest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coaxlink.data.resolution import resolution_of
from coaxlink.data.samples import Samples
from coaxlink.frames import IMU_COLUMNS, Array
from coaxlink.signals import derivative, low_pass

SETTLED_S = 2.0  # of the low-pass's answer to an impulse, either side


def rounding_noise(logs: Sequence[Samples], weight: Array, rate_hz: float, cutoff_hz: float) -> Array:
    """(6,) rms in force (N) and torque (N m), low-passed; `weight` (6,) is mass and inertia.

    Rows are taken as they were logged, at `rate_hz`. The coarsest log counts.
    """
    steps = np.zeros(6)
    for log in logs:
        resolution = np.array([log.resolution.get(name, resolution_of(log[name])) for name in IMU_COLUMNS])
        steps = np.fmax(steps, resolution)
    count = max(int(SETTLED_S * rate_hz), 8)
    impulse = np.zeros((2 * count + 1, 1))
    impulse[count] = 1.0
    gain = np.array(
        [float(np.sum(low_pass(x, rate_hz, cutoff_hz) ** 2)) for x in (impulse, derivative(impulse, rate_hz))]
    )
    return np.asarray(weight * steps * np.sqrt(np.repeat(gain, 3) / 12.0))
