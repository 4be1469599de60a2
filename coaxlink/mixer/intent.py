"""What a mixer table believes its motor commands deliver, to hold against what was measured."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_params import px4


def intended_wrench(parameters: Mapping[str, float | int], motor: ArrayLike) -> NDArray[np.float64]:
    """Wrench (..., 4) in N and N m that a PX4 table means by normalised speeds `motor` (..., N).

    PX4 takes rotor thrust as CT times its set-point s = fac u^2 + (1 - fac) u (CA_ROTORn_CT, THR_MDL_FAC),
    so the wrench it means is effectiveness @ s. Raises what `realise` raises on a table that is none.
    """
    mix = px4.realise(parameters)
    u = np.asarray(motor, float)
    factor = float(parameters.get("THR_MDL_FAC", 0.0))
    rows = np.asarray(mix.effectiveness) @ np.moveaxis(factor * u**2 + (1.0 - factor) * u, -1, 0)
    return np.moveaxis(np.stack([-rows[5], rows[0], rows[1], rows[2]]), 0, -1)
