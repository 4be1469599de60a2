"""What rounding does to a flight's log: noise in its accelerations, errors in its commands.

A mixer has a few degrees of freedom, and a log rounds each of its N commands for itself (ArduPilot: whole
microseconds, 0.1 % of full). What the N then differ by moved no rotor, and least squares on it takes upper
rotors for too strong and lower ones for too weak by a tenth (errors in variables; Fuller 1987). Singular
values of the commands that rounding accounts for are shrunk as loses least (Gavish and Donoho, Optimal
Shrinkage of Singular Values, 2017, equation 7), noise being step^2 / 12 (Widrow and Kollar, Quantization
Noise, 2008). Commands of fine resolution stay as they are.
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
    """(6,) rms left by rounding in force (N) and torque (N m), low-passed; `weight` (6,): mass and inertia.

    White where a signal moves by more than a step from row to row; a lower bound for the noise floor, which
    sees the rest. Rows are taken as they were logged, at `rate_hz`. The coarsest log counts.
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


def before_rounding(commands: Array, steps: Array) -> Array:
    """(rows, N) commands, 0..1, as they were before they were rounded to `steps` (N,); NaN is not known.

    >>> mixed = 0.5 + 0.02 * np.sin(np.arange(400.0))[:, None] * np.array([1.0, -1.0, 0.6, -0.6])
    >>> rounded = np.round(mixed, 2)
    >>> off = [float(np.std(c - mixed)) for c in (rounded, before_rounding(rounded, np.full(4, 0.01)))]
    >>> off[1] < 0.8 * off[0]
    True
    """
    rows, count = commands.shape
    steps = np.fmax(steps, resolution_of(commands)) if np.isnan(steps).all() else steps
    steps = np.where(np.isnan(steps), np.nanmax(steps, initial=0.0), steps)
    if rows <= count or not np.all(steps > 0.0):
        return commands
    unit = steps * np.sqrt(rows / 12.0)
    mean = commands.mean(axis=0)
    left, size, right = np.linalg.svd((commands - mean) / unit, full_matrices=False)
    narrow = count / rows
    more = np.maximum((size**2 - narrow - 1.0) ** 2 - 4.0 * narrow, 0.0)
    kept = np.where(size > 1.0 + np.sqrt(narrow), np.sqrt(more) / np.maximum(size, 1e-300), 0.0)
    return np.asarray(mean + (left * kept) @ right * unit)
