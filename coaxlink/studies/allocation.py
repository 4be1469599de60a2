"""The allocation error of a simulated flight: the wrench delivered against the wrench that was meant."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from coaxlink.report.demo import FlightErrors
from coaxlink.residual.allocation_error import allocation_errors
from coaxlink.studies.flight import Flight

if TYPE_CHECKING:
    from coaxlink.studies.flights import Demands
    from coaxlink.vehicle import Vehicle

Meant = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


JUDGED = ("hover", "circle")  # segments of the paper's own flight


def errors_of_table(
    flight: Flight, vehicle: Vehicle, parameters: Mapping[str, float | int], *, as_paper: bool = False
) -> FlightErrors:
    """A flight against what the table on board believes its motor commands deliver, after the motor lag.

    `as_paper`: of the paper's hover and circle alone, and without a lag.
    """
    from firmware_params import px4

    mix = px4.realise(parameters)
    return _errors(flight, vehicle, lambda _, motor: mix.wrench(motor), as_paper)


def errors_of_live(
    flight: Flight, vehicle: Vehicle, demands: Demands, *, as_paper: bool = False
) -> FlightErrors:
    """A flight against the demands that the companion was sent, after the declared motor lag.

    `as_paper` as above.
    """
    from coaxlink.live.mixer_core import DemandScale
    from coaxlink.mixer import standard_coefficients

    scale = DemandScale(vehicle.airframe, standard_coefficients(vehicle.model)).matrix
    lag_s = 0.0 if as_paper else vehicle.airframe.motor_lag_s

    def meant(time_s: NDArray[np.float64], _: NDArray[np.float64]) -> NDArray[np.float64]:
        return demands.at(time_s, lag_s) @ scale.T

    return _errors(flight, vehicle, meant, as_paper)


def _errors(flight: Flight, vehicle: Vehicle, meant: Meant, as_paper: bool) -> FlightErrors:
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
        flight.pack.mean(),
    )
