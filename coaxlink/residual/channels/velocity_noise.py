"""Noise of the logged velocity, and what an effect of the velocity carries of it into the residual.

The estimator's velocity is held against the integral of the logged specific force, turned by the logged
attitude: over a few seconds the integral is by far the better of the two. What differs between 0.15 Hz and
the judged band's end is noise of the velocity; a drag of 10 N s/m makes 0.15 N of 0.015 m/s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import butter, sosfiltfilt

from coaxlink.frames import GRAVITY_NED, Array, FlightFrame
from coaxlink.residual.members import Part, composed

SLOWEST_HZ = 0.15
STEP_M_S = 0.05
STEP_RAD = 0.002
STEP_M = 0.01


def felt_noise(bare: FlightFrame, parts: Sequence[Part]) -> Array:
    """(6,) rms that the noise of velocity, height and attitude adds to the residual through these effects.

    The attitude tells what is downwards: how high every disc is, and what of a climb is along the axes.
    """
    here = composed(bare, parts).predicted
    power = np.zeros(6)
    noise: Array | None = None
    for k in range(3):
        moved = replace(bare, velocity=bare.velocity + STEP_M_S * np.eye(3)[k])
        slope = (composed(moved, parts).predicted - here)[bare.keep] / STEP_M_S
        if not np.any(slope):
            continue
        noise = _body_noise(bare) if noise is None else noise
        power += noise[k] ** 2 * np.mean(slope**2, axis=0)
    high = bare.extra.get("height_noise")
    if bare.height is not None and high is not None and np.isfinite(high[bare.keep]).any():
        raised = replace(bare, height=bare.height + STEP_M)
        slope = (composed(raised, parts).predicted - here)[bare.keep] / STEP_M
        power += float(np.nanmean(high[bare.keep] ** 2)) * np.mean(slope**2, axis=0)
    attitude_noise = bare.extra.get("attitude_noise")
    if attitude_noise is None or not np.isfinite(attitude_noise[bare.keep]).any():
        return np.sqrt(power)
    sigma = np.sqrt(np.nanmean(attitude_noise[bare.keep] ** 2, axis=0))
    for k in range(2):
        leaning = replace(bare, attitude=bare.attitude + STEP_RAD * np.eye(3)[k])
        slope = (composed(leaning, parts).predicted - here)[bare.keep] / STEP_RAD
        power += sigma[k] ** 2 * np.mean(slope**2, axis=0)
    return np.sqrt(power)


def _body_noise(frame: FlightFrame) -> Array:
    """(3,) rms of the velocity's noise along the body's axes: what smoothing left of it, or as logged."""
    left = frame.extra.get("velocity_noise")
    if left is None or not np.isfinite(left[frame.keep]).all():
        return velocity_noise(frame)
    down = np.cross(frame.north, frame.east)
    to_body = np.stack([frame.north, frame.east, down], axis=2)[frame.keep]
    return np.asarray(np.sqrt(np.mean(np.einsum("rbw,rw->rb", to_body**2, left[frame.keep] ** 2), axis=0)))


def velocity_noise(frame: FlightFrame) -> Array:
    """(3,) rms along the body's axes of the logged velocity's noise, in the judged band."""
    down = np.cross(frame.north, frame.east)
    to_body = np.stack([frame.north, frame.east, down], axis=2)  # (rows, 3 body, 3 world)
    world = np.einsum("rbw,rb->rw", to_body, frame.velocity)
    pull = np.einsum("rbw,rb->rw", to_body, frame.specific_force) + GRAVITY_NED
    band = butter(2, [SLOWEST_HZ, frame.cutoff_hz], "bandpass", fs=frame.rate_hz, output="sos")
    differs = np.zeros_like(world)
    flown = np.zeros(len(world), bool)
    flown[frame.keep] = True
    for number in np.unique(frame.stretch):
        rows = np.flatnonzero(frame.stretch == number)
        inside = rows[np.searchsorted(rows, frame.keep[(frame.keep >= rows[0]) & (frame.keep <= rows[-1])])]
        if len(inside) < 20 or inside[-1] - inside[0] < 4.0 * frame.rate_hz:
            flown[rows] = False
            continue
        air = slice(inside[0], inside[-1] + 1)
        half = 0.5 * (pull[air][1:] + pull[air][:-1]) / frame.rate_hz
        gone = np.concatenate([np.zeros((1, 3)), np.cumsum(half, axis=0)])
        line = np.linspace(-1.0, 1.0, len(gone))[:, None] ** np.arange(3)
        left = world[air] - gone
        left = left - line @ np.linalg.lstsq(line, left, rcond=None)[0]
        differs[air] = sosfiltfilt(band, left, axis=0)
    body = np.einsum("rbw,rw->rb", to_body, differs)[flown]
    # robust: a landing or a shock is no noise
    return np.asarray(1.4826 * np.median(np.abs(body), axis=0)) if len(body) else np.zeros(3)
