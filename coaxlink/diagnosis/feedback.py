"""What a controller puts into the regressors: a disturbance of the body comes back as commands against it.

A gust, or noise of the gyro that is flown after, is in what was measured and, a moment later, in what the
rotors were told: the residual then goes with the predicted load itself, late or early, with nothing wrong in
the model (Ljung 1999, System Identification, 13.4: closed-loop identification by the direct method is biased
where noise is not modelled through the loop). How much of it can be is known: a disturbance of size d that a
load of size P answers leaves d^2 / P in step with P and e^2 = d^2 (1 - d^2 / P^2) beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from coaxlink.diagnosis.evidence import fitted, sums_of
from coaxlink.diagnosis.parts import Block, joined
from coaxlink.frames import Array, FlightFrame
from coaxlink.signals import derivative, low_pass

ANSWERED = (2, 3, 4, 5)  # channels that rotors act in: lift and torques
LATE_S = (0.1, 0.3)  # by which a loop's answer may lag
SLOW_HZ = (0.3, 1.0)  # about where loops of position and of attitude end


def feedback(
    frame: FlightFrame, reduce: Callable[[Array], Array], base: Sequence[Block], target: Array, least: Array
) -> list[Block]:
    """Blocks of what may come back through the loop, by channel; `target` (rows, C) is the residual."""
    shapes, reacting = _shapes(frame, reduce)
    size = np.sqrt(np.mean(reduce(frame.predicted - _mean(frame)) ** 2, axis=0))
    wide = _blocks(shapes, {c: np.maximum(0.5 * size[c], reacting[c]) for c in shapes}, target.shape[1])
    columns, deviation = joined([*base, *wide])
    fit = fitted(sums_of(columns, target), deviation, np.maximum(target.std(axis=0), least), least)
    beside = np.std(target - columns @ fit.values, axis=0)
    usual = in_step(beside, size)
    return _blocks(shapes, {c: np.maximum(usual[c], reacting[c]) for c in shapes}, target.shape[1])


def in_step(beside: Array, load: Array) -> Array:
    """Part of a disturbance in step with the load that answers it, from the part that is not."""
    ratio = np.minimum(4.0 * (beside / np.maximum(load, 1e-12)) ** 2, 1.0)
    return np.asarray(0.5 * load * (1.0 - np.sqrt(1.0 - ratio)))


def _mean(frame: FlightFrame) -> Array:
    return np.asarray(np.mean(frame.predicted[frame.keep], axis=0))


def _shapes(
    frame: FlightFrame, reduce: Callable[[Array], Array]
) -> tuple[dict[int, Array], dict[int, Array]]:
    """By channel, (rows, K) of unit rms, and (K,) of the load that surely answers a disturbance.

    The load, its rate and bend, slow parts of load and rate, the load behind a lag, and the angle and rate
    that a torque leaves behind. What of a slow load does not move the body answers a disturbance.
    """
    moving = frame.predicted - _mean(frame)
    moved = frame.measured - np.mean(frame.measured[frame.keep], axis=0)
    rate = derivative(moving, frame.rate_hz)
    ways = [moving, rate, derivative(rate, frame.rate_hz)]
    answer = [np.zeros(moving.shape[1])] * 3
    # of the lift not: less of it for as little motion is another mass, another air, another supply
    torques = np.arange(moving.shape[1]) > 2
    for corner in SLOW_HZ:
        slow = _slow(frame, moving, corner)
        left = np.mean(slow[frame.keep] ** 2 - _slow(frame, moved, corner)[frame.keep] ** 2, axis=0)
        ways += [slow, _slow(frame, rate, corner)]
        answer += [np.sqrt(np.maximum(left, 0.0)) * torques] * 2
    for lag in LATE_S:
        ways.append(frame.filtered(moving, lag) - moving)
        answer.append(np.zeros(moving.shape[1]))
    turned = np.zeros((len(moving), moving.shape[1], 2))
    turned[:, 3:, 0], turned[:, 3:, 1] = frame.attitude, frame.rates
    turned -= turned[frame.keep].mean(axis=0)
    answer += [np.zeros(moving.shape[1])] * 2
    reduced = reduce(np.concatenate([np.stack(ways, axis=-1), turned], axis=-1))  # (rows, C, K)
    size = np.sqrt(np.mean(reduced**2, axis=0))
    use, answers = size > 1e-12, np.stack(answer, axis=-1)
    return (
        {c: reduced[:, c, use[c]] / size[c, use[c]] for c in ANSWERED},
        {c: answers[c, use[c]] for c in ANSWERED},
    )


def _slow(frame: FlightFrame, values: Array, corner_hz: float) -> Array:
    out = np.empty_like(values)
    cuts = np.flatnonzero(np.diff(frame.stretch)) + 1
    for first, end in zip([0, *cuts], [*cuts, len(values)], strict=True):
        out[first:end] = low_pass(values[first:end], frame.rate_hz, corner_hz)
    return out


def _blocks(shapes: dict[int, Array], deviation: dict[int, Array], count: int) -> list[Block]:
    out = []
    for c, columns in shapes.items():
        full = np.zeros((len(columns), count, columns.shape[1]))
        full[:, c] = columns
        out.append(Block(f"feedback {c}", full, np.maximum(deviation[c] * np.ones(columns.shape[1]), 1e-12)))
    return out
