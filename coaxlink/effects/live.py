"""What live mixing makes of effects: what they add to the wrench now, from what the vehicle sends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import Airframe
from coaxlink.rotor import RotorModel

Array = NDArray[np.float64]
Part = Callable[[Sequence[float]], Array]  # normalised speeds (N,) -> wrench (4,) that the effect adds
SpeedPart = Callable[[], float | None]  # speed per command now; None: not known
MOST_OF_THRUST = 0.3  # that one effect may be reported to add: beyond, telemetry or a number is wrong


class LiveView(Protocol):
    """The vehicle as live mixing knows it now."""

    airframe: Airframe
    model: RotorModel
    air_temperature_C: float | None  # stated by the user

    @property
    def usual_lift(self) -> float:
        """Thrust over speed squared of the middle one of the rotors in hover, N."""

    @property
    def usual_speed(self) -> float:
        """Normalised speed of the middle one of the rotors at the last answer."""

    def reading(self, name: str) -> Any:
        """The newest value of a kind, None when there is none or it is too old."""

    def ahead(self, name: str) -> float:
        """Seconds from a reading to when the motors have followed what is commanded now."""

    def rates(self) -> Sequence[float] | None:
        """(3,) body rates then, rad/s."""

    def velocity(self) -> Sequence[float] | None:
        """(3,) velocity over ground then, body axes, m/s."""

    def loads(self, speeds: Sequence[float]) -> tuple[Array, Array]:
        """(N,) thrust in N and (N,) torque in N m of the rotor model."""

    def wrench_of(self, thrust: Array, torque: Array | None = None) -> Array:
        """(4,) wrench of rotor loads."""


def nothing() -> Array:
    """(4,) where an input is missing."""
    return np.zeros(4)
