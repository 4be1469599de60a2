"""What a controller puts into the regressors: a disturbance of the body comes back as commands against it.

A gust, or noise of the gyro that is flown after, is in what was measured and, a moment later, in what the
rotors were told: the residual then goes with the predicted load itself, late or early, with nothing wrong in
the model (Ljung 1999, System Identification, 13.4: closed-loop identification by the direct method is biased
where noise is not modelled through the loop). How much of it can be is known, frequency by frequency, for a
loop answers slow gusts in full and fast ones hardly: a disturbance of size d that a load of size P answers
leaves d^2 / P in step with P and e^2 = d^2 (1 - d^2 / P^2) beside it. Where more than P / 2 is beside it, the
load is less than an answer, and says nothing of how much of the disturbance goes with it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from coaxlink.diagnosis.parts import Block
from coaxlink.frames import Array, FlightFrame
from coaxlink.signals import derivative, low_pass

ANSWERED = (2, 3, 4, 5)  # channels that rotors act in: lift and torques
# octaves between them; loops of position end at the lower ones, loops of attitude at the upper ones
EDGES_HZ = (0.3, 0.6, 1.2, 2.4)
SLOW_BANDS = 2  # in which no lag of a motor keeps a load from moving the body
LEAST_LOAD = 1e-9  # of the reference load


def feedback(frame: FlightFrame, reduce: Callable[[Array], Array]) -> list[Block]:
    """A block a channel of what may come back through the loop, octave by octave.

    In step with the load and with its rate; beside it go the angle and the rate that a torque leaves behind.
    """
    load = _bands(frame, frame.predicted)
    body = _bands(frame, frame.measured)
    rate = derivative(load.reshape(len(load), -1), frame.rate_hz).reshape(load.shape)
    turned = np.concatenate(
        [np.zeros((len(load), 3, 2)), np.stack([frame.attitude, frame.rates], -1)], axis=1
    )
    out = []
    for c in ANSWERED:
        ways, deviation = [], []
        for b in range(load.shape[-1]):
            step, change, moved = (reduce(x[:, c, b]) for x in (load, rate, body))
            size, motion = float(np.std(step)), float(np.std(moved))
            if size < LEAST_LOAD * frame.reference[c]:
                continue
            pair = np.stack([step, change], axis=1) - [step.mean(), change.mean()]
            pair /= pair.std(axis=0)
            left = moved - step - np.mean(moved - step)
            beside = float(np.std(left - pair @ np.linalg.lstsq(pair, left, rcond=None)[0]))
            share = in_step(beside, size)
            if c > 2 and b < SLOW_BANDS:
                # what of a slow torque does not move the body answers a disturbance; of the lift not: less of
                # it for as little motion is another mass, another air, another supply
                share = max(share, float(np.sqrt(max(size**2 - motion**2, 0.0))))
            ways.append(pair)
            deviation += [share, share]
        if not ways:
            continue
        angles = reduce(turned[:, c]) - reduce(turned[:, c]).mean(axis=0)
        angles = angles[:, angles.std(axis=0) > 1e-9]
        columns = np.concatenate([*ways, angles / angles.std(axis=0)], axis=1)
        deviation += [float(np.sqrt(0.5 * np.sum(np.square(deviation))))] * angles.shape[1]
        full = np.zeros((len(columns), load.shape[1], columns.shape[1]))
        full[:, c] = columns
        out.append(Block(f"feedback {c}", full, np.maximum(deviation, 1e-12)))
    return out


def in_step(beside: float, load: float) -> float:
    """Part of a disturbance in step with the load that answers it, from the part that is not."""
    if beside > 0.5 * load:
        return max(load, beside)
    return 0.5 * load * (1.0 - np.sqrt(1.0 - 4.0 * (beside / load) ** 2))


def _bands(frame: FlightFrame, values: Array) -> Array:
    """(rows, C, bands) of (rows, C): between the edges, the lowest first; they sum to the values."""
    below = [np.zeros_like(values)]
    for edge in EDGES_HZ:
        slow = np.empty_like(values)
        cuts = np.flatnonzero(np.diff(frame.stretch)) + 1
        for first, end in zip([0, *cuts], [*cuts, len(values)], strict=True):
            slow[first:end] = low_pass(values[first:end], frame.rate_hz, edge)
        below.append(slow)
    return np.diff(np.stack([*below, values], axis=-1), axis=-1)
