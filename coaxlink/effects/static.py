"""What a static mixer makes of effects: a vehicle changed at stated conditions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import Airframe
from coaxlink.errors import InputError
from coaxlink.load import Load
from coaxlink.rotor import RotorModel

Array = NDArray[np.float64]
SPEED_FACTOR = (0.5, 1.5)  # of a speed over its command; beyond, the stated condition is a slip


class LeftOut(Exception):
    """Why a static mixer does nothing about an effect."""


@dataclass(frozen=True)
class Conditions:
    """Where a static mixer shall be right. None: not stated, and what depends on it is left out."""

    voltage_V: float | None = None
    height_m: float | None = None  # above ground
    climb_m_s: float | None = None
    motor_temperature_C: float | None = None
    air_density_kg_m3: float | None = None


@dataclass(frozen=True)
class Loads:
    """Loads at (points,) pairs of normalised speeds, N and N m."""

    upper: Array
    lower: Array
    upper_thrust: Array
    upper_torque: Array
    lower_thrust: Array
    lower_torque: Array

    def __getitem__(self, load: Load) -> Array:
        """One of them (points,)."""
        return np.asarray(getattr(self, load.channel))

    def plus(self, changes: Mapping[Load, Array]) -> Loads:
        """The loads with these changes (points,) added."""
        return replace(self, **{load.channel: self[load] + change for load, change in changes.items()})


Change = Callable[[RotorModel, Loads], Loads]


def refuse_speed(factor: float, condition: str, value: float) -> None:
    """Raise InputError where rotors would turn at a share of their commands that no drive gives."""
    if not SPEED_FACTOR[0] <= factor <= SPEED_FACTOR[1]:
        problem = f"rotors would turn at {factor:.2f} of their commands: no such drive"
        raise InputError(f"`{condition}`", f"{value:g}", problem)


@dataclass
class StaticVehicle:
    """A vehicle being put together: effects change it one after the other."""

    airframe: Airframe
    model: RotorModel
    at: Conditions
    thrust: Array  # (N,) gains of every rotor's thrust
    torque: Array  # (N,) of its torque
    usual_lift: Callable[[Airframe, RotorModel], float]  # N, thrust over speed squared of a rotor in hover
    speed: float = 1.0  # of every rotor over what it is commanded
    changes: list[Change] = field(default_factory=list)  # of the pair's surfaces
    turning: list[Callable[[Array], Array]] = field(default_factory=list)  # speeds that nominal ones become

    def turn(self, factor: float, condition: str, value: float) -> None:
        """Let every rotor turn at `factor` of what it is commanded; InputError where no drive does that."""
        refuse_speed(factor, condition, value)
        self.speed *= factor

    def turn_at(self, speed_of: Callable[[Array], Array]) -> None:
        """Let rotors that are commanded a speed (...) turn at `speed_of` it."""
        self.turning.append(speed_of)
