"""The zero of an accelerometer's vertical axis, from the velocity that an estimator has beside it.

Over a minute what an accelerometer's zero is off by grows to metres a second, and an estimator's velocity is
off by a tenth (GNSS, barometer, optical flow): the slope between both is the zero (Savage, Strapdown
Analytics, 2000). A rotor model that is identified in flight needs it: 0.05 m/s^2 are half a per cent of every
rotor's thrust, and as much as a good scale weighs wrongly.
"""

from __future__ import annotations

import numpy as np

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.frames import FlightFrame

USUAL_M_S2 = 0.05  # of a calibrated accelerometer on another day, one standard deviation
VELOCITY_M_S = 0.1  # an estimator's velocity, slowly, one standard deviation
LEAST_S = 5.0  # of a stretch
APART_M_S2 = 3.0 * USUAL_M_S2  # more is no zero: velocity and accelerometer do not belong together


def vertical_zero(frame: FlightFrame) -> tuple[float, float]:
    """What the downward specific force reads too much, m/s^2, and its standard deviation.

    By every stretch the slope of `integral of (f_down + g) - v_down` over time, together with the usual zero
    of none; (0, USUAL_M_S2) where that is all there is.
    """
    pull, weight = 0.0, USUAL_M_S2**-2
    for number in np.unique(frame.stretch):
        rows = frame.stretch == number
        time = np.arange(np.count_nonzero(rows)) / frame.rate_hz
        if time[-1] < LEAST_S:
            continue
        down = np.cross(frame.north[rows], frame.east[rows])
        read = np.cumsum(np.sum(frame.specific_force[rows] * down, axis=1) + GRAVITY_M_S2) / frame.rate_hz
        sinking = np.sum(frame.velocity[rows] * down, axis=1)
        slope = float(np.polyfit(time, read - sinking, 1)[0])
        if abs(slope) < APART_M_S2:
            own = (time[-1] / (np.sqrt(12.0) * VELOCITY_M_S)) ** 2  # of a slope over an even stretch
            pull, weight = pull + own * slope, weight + own
    return pull / weight, float(weight**-0.5)
