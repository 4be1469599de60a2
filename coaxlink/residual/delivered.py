"""How far a flight delivered what its mixer meant: the paper's Table 4 rows, from a log.

Meant is what the table believes its own motor commands give (or the demand that a companion was handed);
delivered is mass times specific force and I dw/dt + w x I w. Both through the same 4 Hz low-pass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import Airframe
from coaxlink.data import Samples
from coaxlink.residual.flight import flight_frame, reduce_columns
from coaxlink.rotor import RotorModel

Array = NDArray[np.float64]


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
class Delivered:
    """Mean |meant - delivered| of a flight, as the paper's Table 4 gives it, and the split per arm."""

    thrust_error_N: float
    torque_error_Nm: tuple[float, float, float]
    split: tuple[ArmSplit, ...]
    seconds: float


def delivered(
    samples: Samples, airframe: Airframe, model: RotorModel, meant: Callable[[Array, Array], Array]
) -> Delivered:
    """Hold a flight against `meant(time_s (rows,), motor (rows, N)) -> wrench (rows, 4)`.

    Raises InputError when the log has too little flight or misses a column.
    """
    frame = flight_frame([samples], airframe, model)
    wanted = meant(frame.time_s, frame.commands)
    got = np.concatenate([-frame.measured[:, 2:3], frame.measured[:, 3:6]], axis=1)
    error = np.abs(reduce_columns(frame, wanted - got)).mean(axis=0)
    thrust = reduce_columns(frame, frame.thrust).mean(axis=0)
    split = tuple(
        ArmSplit(airframe.rotors[u].number, airframe.rotors[low].number, float(thrust[u]), float(thrust[low]))
        for u, low in airframe.pairs
    )
    seconds = len(frame.keep) * float(np.median(np.diff(frame.time_s[frame.keep])))
    return Delivered(float(error[0]), (float(error[1]), float(error[2]), float(error[3])), split, seconds)
