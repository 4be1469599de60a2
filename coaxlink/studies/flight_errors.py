"""The allocation error of a simulated flight: the wrench delivered against the wrench that was meant."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.residual.allocation_error import AllocationErrors, allocation_errors
from coaxlink.studies.flight import RecordedFlight

if TYPE_CHECKING:
    from coaxlink.studies.flights import Demands
    from coaxlink.vehicle import Vehicle

Meant = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]
JUDGED = ("hover", "circle")  # segments of the paper's own flight


@dataclass(frozen=True)
class FlightErrors:
    """One flight against what was meant: the paper's Table 4, who carried the weight, and what it cost."""

    allocation: AllocationErrors
    position_error_m: tuple[float, float, float]  # mean |wanted - flown| north, east, down
    power_W: float | None = None  # mean from the battery, None where the vehicle did not tell

    def to_json(self) -> dict[str, Any]:
        """As `demo --json` writes it."""
        d = self.allocation
        return {
            "thrust_error_N": d.thrust_error_N,
            "torque_error_Nm": list(d.torque_error_Nm),
            "position_error_m": list(self.position_error_m),
            "height_error_m": self.position_error_m[2],
            "split": [
                {"upper": s.upper, "lower": s.lower, "upper_N": s.upper_N, "lower_N": s.lower_N,
                 "lower_share": s.lower_share}
                for s in d.split
            ],
            "seconds": d.seconds,
            "thrust_ci_N": list(d.intervals[0]),
            "torque_ci_Nm": [list(i) for i in d.intervals[1:]],
            "floor": {"thrust_N": d.floor[0], "torque_Nm": list(d.floor[1:])},
            "gain": {"thrust": d.gain[0], "torque": list(d.gain[1:])} if d.gain else None,
            "after_gain": {"thrust_N": d.after_gain[0], "torque_Nm": list(d.after_gain[1:])}
            if d.after_gain else None,
            "power_W": self.power_W,
        }  # fmt: skip


def errors_of_table(
    flight: RecordedFlight,
    vehicle: Vehicle,
    parameters: Mapping[str, float | int],
    *,
    as_paper: bool = False,
) -> FlightErrors:
    """A flight against what the table on board believes its motor commands deliver, after the motor lag.

    `as_paper`: of the paper's hover and circle alone, and without a lag.
    """
    from firmware_params import px4

    mix = px4.realise(parameters)
    return _errors(flight, vehicle, lambda _, motor: mix.wrench(motor), as_paper)


def errors_of_live(
    flight: RecordedFlight, vehicle: Vehicle, demands: Demands, *, as_paper: bool = False
) -> FlightErrors:
    """A flight against the demands that the companion was sent, after the declared motor lag.

    `as_paper` as above.
    """
    from coaxlink.live.mixer_core import DemandScale
    from coaxlink.mixer import standard_coefficients

    scale = DemandScale(vehicle.airframe, standard_coefficients(vehicle.model, of_commands=True)).matrix
    lag_s = 0.0 if as_paper else vehicle.airframe.motor_lag_s
    return _errors(flight, vehicle, lambda time_s, _: demands.at(time_s, lag_s) @ scale.T, as_paper)


def _errors(flight: RecordedFlight, vehicle: Vehicle, meant: Meant, as_paper: bool) -> FlightErrors:
    from coaxlink.data import read_flight_log

    segments = np.array(flight.track.segment)
    judged = np.isin(segments, JUDGED) if as_paper else np.ones(len(segments), bool)
    miss = np.abs(np.array(flight.track.wanted_m) - np.array(flight.track.flown_m))[judged].mean(axis=0)
    samples = read_flight_log(flight.log)
    stamps, time_s = np.array(flight.track.time_s)[judged], samples["time_s"]
    inside = (time_s >= stamps.min()) & (time_s <= stamps.max())
    return FlightErrors(
        allocation_errors(samples.take(inside), vehicle, meant, lagged=not as_paper),
        (float(miss[0]), float(miss[1]), float(miss[2])),
        flight.power_W,
    )
