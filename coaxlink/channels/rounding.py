"""What rounding does to the commands of a flight's log.

A mixer has a few degrees of freedom, and a log rounds each of its N commands for itself (ArduPilot: whole
microseconds, 0.1 % of full). What the N then differ by moved no rotor, and least squares on it takes upper
rotors for too strong and lower ones for too weak by a tenth (errors in variables; Fuller 1987). Singular
values of the commands that rounding accounts for are shrunk as loses least (Gavish and Donoho, Optimal
Shrinkage of Singular Values, 2017, equation 7), noise being step^2 / 12 (Widrow and Kollar, Quantization
Noise, 2008). Commands of fine resolution stay as they are.
"""

from __future__ import annotations

import numpy as np

from coaxlink.data.resolution import resolution_of
from coaxlink.frames import Array


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
