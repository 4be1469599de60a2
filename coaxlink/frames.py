"""A log brought to the form in which measured and predicted can be held against each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import Airframe
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.load import Load
from coaxlink.rotor import RotorModel
from coaxlink.signals import lagged

Array = NDArray[np.float64]
GRAVITY_NED = np.array([0.0, 0.0, GRAVITY_M_S2])
IMU_COLUMNS = (*(f"accel_{a}_m_s2" for a in "xyz"), *(f"gyro_{a}_rad_s" for a in "xyz"))

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
    commands: Array  # (rows, N) normalised speeds that they ask for
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
    sampling: Array = field(
        default_factory=lambda: np.zeros(6)
    )  # (6,) error by what commands do between rows
    notes: tuple[str, ...] = ()
    ruled_out: Mapping[str, str] = field(default_factory=dict)  # effect: why it is not asked of this log
    extra: Mapping[str, Array] = field(default_factory=dict)
    # what effects worked out last; a changed frame starts without
    memo: dict[object, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def weight(self) -> float:
        """Weight of the declared mass, N."""
        return self.airframe.mass_kg * GRAVITY_M_S2

    @property
    def reference(self) -> Array:
        """(6,) load that a per cent is a per cent of: weight, weight times arm, sum of the drag torques."""
        arm = float(np.mean([np.hypot(*r.position_m[:2]) for r in self.airframe.rotors]))
        drag = float(np.median(np.sum(self.torque[self.keep], axis=1)))
        w = self.weight
        return np.array([w, w, w, w * arm / np.sqrt(2), w * arm / np.sqrt(2), max(drag, 1e-3 * w)])

    def turning_at(self, speeds: Array) -> FlightFrame:
        """The frame with the rotors at other speeds (rows, N), loads of the base model."""
        slower = replace(self, speeds=np.clip(speeds, 0.0, None))
        return slower.pulling(*self.airframe.loads(self.model, slower.speeds))

    def pulling(self, thrust: Array, torque: Array) -> FlightFrame:
        """The frame with other rotor loads (rows, N), and nothing else acting."""
        predicted = self.airframe.body_loads(thrust, torque)
        return replace(self, thrust=thrust, torque=torque, predicted=predicted)

    def filtered(self, commands: Array, lag_s: float) -> Array:
        """(rows, N) commands through a first-order lag, every stretch for itself."""
        out = np.empty_like(commands)
        cuts = np.flatnonzero(np.diff(self.stretch)) + 1
        for first, end in zip([0, *cuts], [*cuts, len(commands)], strict=True):
            out[first:end] = lagged(commands[first:end], 1.0 / self.rate_hz, lag_s)
        return out


STAND_LOADS = tuple(load.channel for load in Load)
STAND_CHANNELS = (*STAND_LOADS, "upper_speed", "lower_speed")
STAND_UNITS = (*(load.unit for load in Load), "1", "1")


@dataclass(frozen=True)
class StandFrame:
    """A stand run, one row a sample. Channels beyond the loads are the speeds that the throttles gave.

    `speeds` are what the loads are predicted from: measured where the log has rpm, else the throttles.
    """

    model: RotorModel
    time_s: Array  # (rows,)
    speeds: Array  # (rows, 2) upper, lower, normalised
    throttles: Array | None  # (rows, 2) as the speeds that the model's drive gives at them
    driven: bool  # speeds are throttles or set-points: whatever slows a motor shows in the loads
    predicted: Array  # (rows, 6)
    measured: Array  # (rows, 6), NaN-free; absent channels are zero
    present: tuple[int, ...]  # channels that were measured
    slope: Array  # (rows, 4, 2) of the loads over u_u, u_l
    reference: Array  # (6,)
    free_nuisance: bool  # the base terms are fitted to this very log
    columns: Mapping[str, Array]  # everything the log has
    block: NDArray[np.intp]  # (rows,)
    keep: NDArray[np.intp]
    notes: tuple[str, ...] = ()
    # as a flight's
    memo: dict[object, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def context(self, name: str) -> Array | None:
        """A recorded column, or None."""
        return self.columns.get(name)

    def slowed(self, change: Array) -> Array:
        """(rows, 6) what changes of the normalised speeds (rows, 2) against the throttles do.

        Without throttles they show in the loads: then the log's rpm are set-points, not measured.
        """
        out = np.zeros((len(change), 6))
        if self.driven or self.throttles is None:
            out[:, :4] = np.einsum("rcs,rs->rc", self.slope, change)
        else:
            out[:, 4:] = change
        return out

    def loads_at(self, speeds: Array) -> Array:
        """(rows, 4) base loads at other speeds (rows, 2)."""
        pair = self.model.loads(speeds[:, 0], speeds[:, 1])
        return np.stack([pair[load] for load in Load], axis=1)


def rows_of(frame: StandFrame, rows: NDArray[np.intp]) -> StandFrame:
    """A frame of these rows alone, in that order, all of them judged."""
    return replace(
        frame,
        time_s=frame.time_s[rows],
        speeds=frame.speeds[rows],
        throttles=None if frame.throttles is None else frame.throttles[rows],
        predicted=frame.predicted[rows],
        measured=frame.measured[rows],
        slope=frame.slope[rows],
        columns={name: column[rows] for name, column in frame.columns.items()},
        block=frame.block[rows],
        keep=np.arange(len(rows)),
    )
