"""A log brought to the form in which measured and predicted can be held against each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import Airframe
from coaxlink.rotor import RotorModel

Array = NDArray[np.float64]

FLIGHT_CHANNELS = ("force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z")
FLIGHT_UNITS = ("N", "N", "N", "N m", "N m", "N m")


@dataclass(frozen=True)
class FlightFrame:
    """A flight on uniform time bases: one row a sample, stretches (gaps, logs) one after the other.

    Everything is in SI, body FRD; `speeds` are the rotors' normalised speeds after the declared lag.
    """

    airframe: Airframe
    model: RotorModel
    rate_hz: float
    time_s: Array  # (rows,)
    stretch: Array  # (rows,) number of the contiguous stretch
    log: Array  # (rows,) number of the log it came from
    commands: Array  # (rows, N)
    speeds: Array  # (rows, N)
    thrust: Array  # (rows, N) N, base model
    torque: Array  # (rows, N) N m, base model
    rates: Array  # (rows, 3) rad/s
    angular_acceleration: Array  # (rows, 3) rad/s^2
    specific_force: Array  # (rows, 3) m/s^2
    attitude: Array  # (rows, 3) roll, pitch, yaw, rad
    velocity: Array  # (rows, 3) body frame, m/s
    north: Array  # (rows, 3) unit vector north in the body frame
    east: Array  # (rows, 3) unit vector east in the body frame
    height: Array | None  # (rows,) m above ground
    voltage: Array | None  # (rows,) V
    predicted: Array  # (rows, 6)
    measured: Array  # (rows, 6)
    keep: NDArray[np.intp]  # rows that are judged: in the air, away from edges, thinned
    cutoff_hz: float
    step_s: float  # between the log's own rows, before any thinning
    notes: tuple[str, ...] = ()
    extra: Mapping[str, Array] = field(default_factory=dict)

    @property
    def weight(self) -> float:
        """Weight of the declared mass, N."""
        return self.airframe.mass_kg * 9.80665

    @property
    def reference(self) -> Array:
        """(6,) load that a per cent is a per cent of: weight, weight times arm, sum of the drag torques."""
        arm = float(np.mean([np.hypot(*r.position_m[:2]) for r in self.airframe.rotors]))
        drag = float(np.median(np.sum(self.torque[self.keep], axis=1)))
        w = self.weight
        return np.array([w, w, w, w * arm / np.sqrt(2), w * arm / np.sqrt(2), max(drag, 1e-3 * w)])
