"""The channels of a flight: body force and torque, and what a vehicle's premises leave open as priors."""

from __future__ import annotations

import numpy as np

from coaxlink.frames import FLIGHT_CHANNELS, FLIGHT_UNITS, Array, FlightFrame
from coaxlink.residual.channels.flight import reduce_columns
from coaxlink.residual.channels.flight_problem import flight_blocks, flight_variables, known_parts
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.parts import Block
from coaxlink.residual.nuisance.flight_corrections import flight_corrections
from coaxlink.residual.regression.joint_model import composed

RESOLUTION = 2e-4  # of the reference load: 0.002 m/s^2 of an accelerometer, below any of these in the air
LEAST_SIZE = 0.0025  # of the reference load: less is within what a sound model and its mounting are off by


def flight_channels(bare: FlightFrame) -> Channels:
    """Channels of aligned flights, `bare` without what the model knows of already.

    A correction's prior deviation is half its bound: the bound is two of them.
    """
    known, notes = known_parts(bare)
    frame = composed(bare, known)

    def reduce(columns: Array) -> Array:
        return reduce_columns(frame, columns)

    target, reference = reduce(frame.measured - frame.predicted), frame.reference
    corrections = [(c.name, c.bound, reduce(c.columns)) for c in flight_corrections(frame)]
    return Channels(
        frame=frame,
        bare=bare,
        known=tuple(known),
        names=FLIGHT_CHANNELS,
        units=FLIGHT_UNITS,
        reference=reference,
        target=target,
        block=flight_blocks(frame),
        least_noise=np.maximum(RESOLUTION * reference, frame.rounding),
        variables={n: v for n, v in flight_variables(frame).items() if np.ptp(v) > 0.0},
        speeds={c: (frame.speeds[frame.keep].mean(axis=1),) for c in range(len(FLIGHT_CHANNELS))},
        weights=np.broadcast_to(reference, target.shape),
        nuisance=tuple(Block(n, x[..., None], np.array([0.5 * bound])) for n, bound, x in corrections),
        surface=(),
        forms={},
        effects=(),
        reduce=reduce,
        notes=(*frame.notes, *notes),
        least_size=LEAST_SIZE,
    )
