"""Instrumental variables: gusts and a log's last digit are kept from passing for what a rotor does.

A gust that lifts the vehicle is answered by less thrust: the commands go with the disturbance, and least
squares of the measured force on it takes some of the gust for a rotor that pulls less the faster it
turns (Ljung 1999, System Identification, 13.4; some 5 % of the slope in a wind of 4 m/s, and more with every
hover). Two-stage least squares (Söderström and Stoica 1983) sees of every column that follows the commands
only what instruments explain, and these do not follow the gust: how the vehicle moved, slowly, where a loop
of height leaves nothing of a gust; the flight's mean and time profile; velocity, attitude and rates.

A logged command is rounded, and a log of 50 Hz folds a loop's quicker noise down. A mixer has four degrees of
freedom; what N commands differ by beside these moved no rotor, and least squares of the torques on it takes
that for rotors without effect (errors in variables; Fuller 1987): upper rotors too strong and lower ones too
weak by a tenth, whatever the prior. Instruments of the torques are functions of the whole wrench, in which
that noise is little.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coaxlink.evidence.blocks import Block
from coaxlink.frames import Array, FlightFrame
from coaxlink.health.columns import rows_of
from coaxlink.health.evidence import CHANNELS
from coaxlink.signals import low_pass

LIFT = 0  # of the channels of `rows_of`
SLOW_HZ = 0.5  # below a loop of height's bandwidth
TIME_PROFILE = 3  # order in time: a pack empties
ALIKE = 1e-6  # of the largest singular value: instruments that say the same
# columns that follow the commands
ENDOGENOUS = ("weighing", "force_delay", "voltage", "ground")


def endogenous(columns: Sequence[Block]) -> NDArray[np.bool_]:
    """(K,) which columns follow the commands."""
    return np.array([c.name.startswith(ENDOGENOUS) for c in columns], bool)


def instruments(frame: FlightFrame, beside: Array, follows: NDArray[np.bool_]) -> list[Array]:
    """(kept, M) instruments of each channel; `beside` (kept, 4, K) are the nuisances' columns.

    `follows` (K,): which of them follow the commands (`endogenous`), and are none for the lift.

    The torques': the model's own wrench, and that times the lift of the moment.
    """
    slow = low_pass(frame.measured, frame.rate_hz, SLOW_HZ)
    moved = rows_of(frame, slow[..., None])[:, LIFT, 0]
    time_profile = np.polynomial.chebyshev.chebvander(np.linspace(-1.0, 1.0, len(moved)), TIME_PROFILE)
    level = low_pass(frame.predicted, frame.rate_hz, SLOW_HZ)[:, 2:3]
    wrench = np.stack([frame.predicted, frame.predicted * level], axis=-1)  # (rows, 6, 2)
    asked = rows_of(frame, wrench).reshape(len(moved), -1)
    out = []
    for channel in range(len(CHANNELS)):
        if channel == LIFT:
            known = np.column_stack([time_profile, moved - moved.mean(), beside[:, channel, ~follows]])
        else:
            known = np.column_stack([time_profile, asked, beside[:, channel]])
        size = np.abs(known).max(axis=0)
        out.append(np.asarray(known[:, size > 0.0] / size[size > 0.0]))
    return out


def explained(columns: Array, known: Sequence[Array]) -> Array:
    """(kept, 4, K) what each channel's instruments explain of columns."""
    out = np.empty_like(columns)
    for channel, own in enumerate(known):
        out[:, channel] = own @ np.linalg.lstsq(own, columns[:, channel], rcond=ALIKE)[0]
    return out
