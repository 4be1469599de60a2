"""The `curved` table as a law that takes wrenches: standard columns under a THR_MDL_FAC of their own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coaxlink.mixer import make_law
from coaxlink.mixer.law import checked_wrench
from coaxlink.mixer.linear import SquareLaw
from coaxlink.tables.px4 import px4_table
from coaxlink.vehicle import Vehicle
from firmware_params import px4


@dataclass(frozen=True)
class CurvedLaw:
    """Setpoints of the standard matrix, bent by PX4's curve instead of a plain square root.

    The curve's overall gain is the table's, not 1: what hover thrust and integrators take off is left in.
    """

    columns: SquareLaw
    mix: px4.Px4Mix
    vehicle: Vehicle
    name: str = "curved"
    dropped: tuple[str, ...] = ()

    def speeds(self, wrench: ArrayLike) -> NDArray[np.float64]:
        """Normalised speeds (N,) for a wrench (4,): thrust up N, roll, pitch, yaw N m."""
        setpoints = np.clip(self.columns.inverse @ checked_wrench(wrench), 0.0, 1.0)
        return self.vehicle.turned(self.mix.throttle(setpoints))


def curved_law(vehicle: Vehicle) -> CurvedLaw:
    """The law of the vehicle's curved table. Raises InputError."""
    columns = make_law("standard", vehicle)
    assert isinstance(columns, SquareLaw)
    return CurvedLaw(columns, px4.realise(px4_table(vehicle, "curved")), vehicle)
