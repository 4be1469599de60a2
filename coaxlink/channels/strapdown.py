"""Attitude and velocity smoothed by the inertial sensors: what an estimator wanders by, they tell apart.

A logged attitude wanders by a milliradian, a logged velocity by a centimetre a second, over tenths of a
second to seconds. The gyro's integral and the turned accelerometer's know these motions far better than that,
but drift over minutes (Savage, Strapdown Analytics, 2000). Hence: below a corner the logged values, above it
the integrals, both ways in time, so that nothing is late. The accelerometer's biases are fitted to the
velocity first. Where the two do not belong together (a sensor that is stuck or reversed) nothing is smoothed.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfiltfilt

from coaxlink.frames import GRAVITY_NED, Array

ATTITUDE_HZ, CORNER_HZ = 0.04, 0.1
LEAST_S = 15.0  # of a stretch: shorter ones do not show what drifts
STRAYS_RAD, STRAYS_M_S, STRAYS_M = 0.03, 0.4, 0.15  # beyond, sensors and estimator do not belong together


def slow_part(values: Array, rate_hz: float, corner_hz: float = CORNER_HZ) -> Array:
    """(rows, K) below the corner, without delay; straight lines pass whole."""
    sos = butter(1, corner_hz, fs=rate_hz, output="sos")
    line = np.linspace(-1.0, 1.0, len(values))[:, None] ** np.arange(2)
    trend = line @ np.linalg.lstsq(line, values, rcond=None)[0]
    pad = min(len(values) - 1, round(1.5 * rate_hz / corner_hz))
    return np.asarray(trend + sosfiltfilt(sos, values - trend, axis=0, padlen=pad))


def integral(values: Array, rate_hz: float) -> Array:
    """(rows, K) running integral by trapezoids, from zero."""
    out = np.zeros_like(values)
    np.cumsum(0.5 * (values[1:] + values[:-1]) / rate_hz, axis=0, out=out[1:])
    return out


def turning_of(attitude: Array, rates: Array) -> Array:
    """(rows, 3) rates of roll, pitch and yaw of body rates (rows, 3) at an attitude (rows, 3)."""
    sr, cr, tp = np.sin(attitude[:, 0]), np.cos(attitude[:, 0]), np.tan(attitude[:, 1])
    p, q, r = rates.T
    across = q * sr + r * cr
    return np.stack([p + across * tp, q * cr - r * sr, across / np.cos(attitude[:, 1])], axis=1)


def smoothed_attitude(attitude: Array, rates: Array, rate_hz: float) -> Array:
    """(rows, 3) attitude, above the corner from the gyro; or as it came."""
    out = attitude
    if len(out) < LEAST_S * rate_hz or np.max(np.abs(attitude[:, 1])) > 1.2:
        return attitude
    for _ in range(2):  # the rates of the angles are taken at the better attitude
        gone = integral(turning_of(out, rates), rate_hz)
        differs = attitude - gone
        quick = differs - slow_part(differs, rate_hz, ATTITUDE_HZ)
        if np.max(np.abs(quick)) > STRAYS_RAD:
            return attitude
        out = attitude - quick
    return out


def smoothed_velocity(velocity: Array, force: Array, to_world: Array, rate_hz: float) -> Array:
    """(rows, 3) velocity, above the corner from the accelerometer; or as it came.

    `force` (rows, 3) is specific, in the body; `to_world` (rows, 3, 3) turns it.
    """
    if len(velocity) < LEAST_S * rate_hz:
        return velocity
    pull = np.einsum("rwb,rb->rw", to_world, force) + GRAVITY_NED
    differs = velocity - integral(pull, rate_hz)
    # a bias of the accelerometer turns with the body
    carried = integral(to_world.reshape(len(to_world), 9), rate_hz).reshape(-1, 3, 3)
    quick = differs - slow_part(differs, rate_hz)
    flat = carried.reshape(len(carried), 9)
    turned = (flat - slow_part(flat, rate_hz)).reshape(-1, 3, 3)
    bias = np.linalg.lstsq(turned.reshape(-1, 3), quick.ravel(), rcond=1e-6)[0]
    quick = quick - turned @ bias
    if np.max(np.abs(quick)) > STRAYS_M_S:
        return velocity
    return velocity - quick


def smoothed_height(height: Array, sinking: Array, rate_hz: float) -> Array:
    """(rows,) height, above the corner from the velocity downwards; as it came where the ground is uneven."""
    if len(height) < LEAST_S * rate_hz:
        return height
    differs = (height + integral(sinking[:, None], rate_hz)[:, 0])[:, None]
    quick = differs - slow_part(differs, rate_hz, 2.0 * CORNER_HZ)
    if np.max(np.abs(quick)) > STRAYS_M:
        return height
    return np.asarray(height - quick[:, 0])
