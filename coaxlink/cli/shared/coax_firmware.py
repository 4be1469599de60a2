"""The module of `coaxlink bridge --firmware px4` as the stand-in runs it: Python's law for the C++ one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from coaxlink.vehicle import Vehicle
    from sim.px4.coax_module import CoaxFirmware

Array = NDArray[np.float64]


def coax_firmware(vehicle: Vehicle) -> CoaxFirmware:
    """What a board with the module of this vehicle runs. Raises InputError."""
    from coaxlink.live.onboard.description import board_law
    from coaxlink.mixer.exact import ExactLaw
    from sim.px4.coax_module import CoaxFirmware

    about, law, frame = board_law(vehicle), ExactLaw(vehicle), vehicle.airframe

    def speeds(roll: float, pitch: float, yaw: float, thrust: float) -> Array:
        return law.speeds(about.wrench @ (roll, pitch, yaw, thrust))

    def delivered(u: Array) -> Array:
        return frame.wrench(*frame.loads(vehicle.model, u))[about.units.order] / about.units.scale

    return CoaxFirmware(about.identity, speeds, delivered, about.wrench)
