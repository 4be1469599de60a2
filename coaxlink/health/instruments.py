"""Instrumental variables for the lift: gusts are kept from passing for what a rotor does.

A gust that lifts the vehicle is answered by less thrust: what the rotors were told goes with the disturbance,
and least squares of the measured force on it takes some of the gust for a rotor that pulls less the faster it
turns (Ljung 1999, System Identification, 13.4; some 5 % of the slope in a wind of 4 m/s, and more with every
hover). Two-stage least squares (Söderström and Stoica 1983) sees of every column that follows the commands
only what instruments explain, and these do not follow the gust: how the vehicle moved, slowly, where a loop
of height leaves nothing of a gust; the flight's mean and course; velocity, attitude and rates.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coaxlink.frames import Array, FlightFrame
from coaxlink.health.columns import Column, rows_of
from coaxlink.signals import low_pass

LIFT = 0  # of the channels of `rows_of`
SLOW_HZ = 0.5  # below a loop of height's bandwidth
COURSE = 3  # order in time: a pack empties
ALIKE = 1e-6  # of the largest singular value: instruments that say the same
# columns that follow the commands
ENDOGENOUS = ("weighing", "force_delay", "voltage", "ground")


def endogenous(columns: Sequence[Column]) -> NDArray[np.bool_]:
    """(K,) which columns follow the commands."""
    return np.array([c.name.startswith(ENDOGENOUS) for c in columns], bool)


def instruments(frame: FlightFrame, exogenous: Array) -> Array:
    """(kept, M) instruments for the lift; `exogenous` (kept, 4, K) are columns that no command is in."""
    slow = low_pass(frame.measured, frame.rate_hz, SLOW_HZ)
    moved = rows_of(frame, slow[..., None])[:, LIFT, 0]
    course = np.polynomial.chebyshev.chebvander(np.linspace(-1.0, 1.0, len(moved)), COURSE)
    known = np.column_stack([course, moved - moved.mean(), exogenous[:, LIFT]])
    size = np.abs(known).max(axis=0)
    return np.asarray(known[:, size > 0.0] / size[size > 0.0])


def explained(columns: Array, known: Array) -> Array:
    """(kept, 4, K) columns of which the lift's rows are what the instruments explain of them."""
    out = columns.copy()
    out[:, LIFT] = known @ np.linalg.lstsq(known, columns[:, LIFT], rcond=ALIKE)[0]
    return out
