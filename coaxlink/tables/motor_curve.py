"""The one curve that an autopilot bends all motors by, chosen for a table whose columns stay as they are."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.mixer.fitted import ENVELOPE
from coaxlink.vehicle import Vehicle
from firmware_params import px4

LEVEL = np.linspace(*ENVELOPE, 12)  # of the weight: the envelope's thrusts


def own_curve(vehicle: Vehicle, table: px4.Px4Table) -> float:
    """The THR_MDL_FAC that makes a table's level thrust most nearly proportional to the demand, 0..1.

    Over the envelope's thrusts; the table's columns stay as they are.
    """
    from scipy.optimize import minimize_scalar

    share = -px4.realise(table).mix[:, 5]
    weight = vehicle.airframe.mass_kg * GRAVITY_M_S2

    def misfit(curve: float) -> float:
        mix = px4.realise(dataclasses.replace(table, thr_mdl_fac=curve))
        demand = np.linspace(0.02, 1.0 / max(float(share.max()), 1e-6), 80)
        lift = _lift(vehicle, mix.throttle(demand[:, None] * share))
        if lift[-1] < LEVEL[0] * weight:
            return float("inf")
        wanted = np.clip(LEVEL * weight, lift[0], lift[-1])
        at = np.interp(wanted, lift, demand)
        gain = float(wanted @ at) / float(at @ at)
        return float(np.mean((wanted - gain * at) ** 2))

    found = minimize_scalar(misfit, bounds=(0.01, 1.0), method="bounded", options={"xatol": 1e-3})
    return round(float(found.x), 2)


def _lift(vehicle: Vehicle, speeds: NDArray[np.float64]) -> NDArray[np.float64]:
    airframe, model = vehicle.airframe, vehicle.model
    return np.asarray(airframe.wrench(*airframe.loads(model, np.clip(speeds, 0.0, 1.0)))[..., 0])
