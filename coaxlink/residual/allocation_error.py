"""The allocation error of a flight, wrench meant less wrench delivered: the paper's Table 4 rows, from a log.

Most of that error is a constant gain, which an autopilot's integrators learn: what is left after the best one
is given beside it.

Meant is what the table believes its own motor commands give (or the demand that a companion was handed);
delivered is mass times specific force and I dw/dt + w x I w. Both through the same 4 Hz low-pass.
Everything is the guest's own measurement.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.channels.flight import JUDGED_RATE_HZ, flight_frame, reduce_columns
from coaxlink.data import Samples
from coaxlink.evidence.held_out import contiguous_blocks
from coaxlink.frames import FlightFrame
from coaxlink.signals import difference_gain, noise_floor
from coaxlink.vehicle import Vehicle

Array = NDArray[np.float64]
Interval = tuple[float, float]
DRAWS = 1000


@dataclass(frozen=True)
class ArmSplit:
    """Mean thrust of one coaxial pair in flight, by the rotor model at the commanded speeds."""

    upper: int  # rotor number
    lower: int  # rotor number
    upper_N: float
    lower_N: float

    @property
    def lower_share(self) -> float:
        """Lower thrust over the pair's."""
        return self.lower_N / (self.upper_N + self.lower_N)


@dataclass(frozen=True)
class AllocationErrors:
    """Mean |meant - delivered| of a flight, as the paper's Table 4 gives it, and the split per arm."""

    thrust_error_N: float
    torque_error_Nm: tuple[float, float, float]
    split: tuple[ArmSplit, ...]
    seconds: float
    # thrust, roll, pitch, yaw, N and N m
    intervals: tuple[Interval, ...] = ()  # 95 % of the mean |error|, over blocks of flight
    floor: tuple[float, ...] = ()  # mean |error| that the sensors' noise alone makes
    gain: tuple[float, ...] = ()  # delivered for one of what was meant, by least squares
    after_gain: tuple[float, ...] = ()  # mean |gain x meant - delivered|


def allocation_errors(
    samples: Samples,
    vehicle: Vehicle,
    meant: Callable[[Array, Array], Array],
    *,
    lagged: bool = False,
) -> AllocationErrors:
    """Hold a flight of `vehicle` against `meant(time_s (rows,), motor (rows, N)) -> wrench (rows, 4)`.

    `lagged` hands `meant` the commands after the declared motor lag, which is no matter of allocation.
    Raises InputError when the log has too little flight or misses a column.
    """
    airframe = vehicle.airframe
    frame = flight_frame([samples], airframe, vehicle.model)
    wanted = meant(frame.time_s, frame.speeds if lagged else frame.commands)
    delivered = np.concatenate([-frame.measured[:, 2:3], frame.measured[:, 3:6]], axis=1)
    wanted_at, given = reduce_columns(frame, wanted), reduce_columns(frame, delivered)
    signed = wanted_at - given
    gain = (wanted_at * given).sum(axis=0) / np.maximum((wanted_at**2).sum(axis=0), np.finfo(float).tiny)
    left = np.abs(gain * wanted_at - given).mean(axis=0)
    error = np.abs(signed).mean(axis=0)
    intervals, floor = _doubt(frame, signed)
    thrust = reduce_columns(frame, frame.thrust).mean(axis=0)
    split = tuple(
        ArmSplit(airframe.rotors[u].number, airframe.rotors[low].number, float(thrust[u]), float(thrust[low]))
        for u, low in airframe.pairs
    )
    seconds = len(frame.keep) * float(np.median(np.diff(frame.time_s[frame.keep])))
    torque = (float(error[1]), float(error[2]), float(error[3]))
    return AllocationErrors(
        float(error[0]), torque, split, seconds, intervals, floor, tuple(gain.tolist()), tuple(left.tolist())
    )


def _doubt(frame: FlightFrame, error: Array) -> tuple[tuple[Interval, ...], tuple[float, ...]]:
    """Intervals of the mean |error| of (kept, 4) rows over blocks of 2 s or more, and the noise's own."""
    every = max(1, round(frame.rate_hz / JUDGED_RATE_HZ))
    broken = np.concatenate([[0], np.cumsum(np.diff(frame.keep) != every)])
    _, block = np.unique(
        contiguous_blocks(frame.time_s[frame.keep], broken, least_s=2.0, count=40), return_inverse=True
    )
    count = int(block.max()) + 1
    rows = np.bincount(block, minlength=count)
    sums = np.stack([np.bincount(block, np.abs(e), count) for e in error.T], axis=1)  # (blocks, 4)
    drawn = np.random.default_rng(1).integers(count, size=(DRAWS, count))
    means = sums[drawn].sum(axis=1) / rows[drawn].sum(axis=1)[:, None]
    low, high = np.quantile(means, [0.025, 0.975], axis=0)
    rates = (frame.rate_hz, frame.cutoff_hz, every)
    gain = np.array([difference_gain(*rates), *[difference_gain(*rates, differentiated=True)] * 3])
    # the mean |x| of a normal x is sqrt(2 / pi) of its deviation
    floor = np.sqrt(2.0 / np.pi) * noise_floor(error, broken, gain)
    pairs = tuple((float(a), float(b)) for a, b in zip(low, high, strict=True))
    return pairs, tuple(float(f) for f in floor)
