"""From speeds to what motors are told, as plain numbers: for the live loop, compiled flights, PX4's module.

The same as `Vehicle.commanded`, one point at a time: the nominal speed of a true one (effects of the drive),
then the command that holds it (`rotor.drive`). Everything before this edge knows speeds alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.errors import InputError
from coaxlink.mixer.plain import PlainLoad
from coaxlink.vehicle import Vehicle

POWERS = 6  # of the polynomials of a drive, and of nominal over true speeds
LOWEST, BENT = 0.1, 0.005  # of full speed: below, rotors only idle; what a polynomial may miss of an effect


@dataclass(frozen=True)
class PlainDrive:
    """Of one level's rotors."""

    torque: PlainLoad  # N m
    command: tuple[float, ...]  # (POWERS,) c_0, c_1, ... at the vehicle's conditions
    per_torque: tuple[float, float]
    least: float  # the least speed that was measured

    def at(self, upper: float, lower: float, is_lower: bool) -> float:
        """The command for nominal speeds of both rotors of a pair."""
        u = lower if is_lower else upper
        held, c = max(u, self.least), 0.0
        for k in reversed(self.command):
            c = c * held + k
        c += (self.per_torque[0] + self.per_torque[1] * u) * self.torque.value(upper, lower)
        return c * u / self.least if u < self.least else c


STRAIGHT = PlainDrive(PlainLoad(((0.0,),)), (0.0, 1.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0), 0.0)


@dataclass(frozen=True)
class Edge:
    """Of a vehicle."""

    pairs: tuple[tuple[int, int], ...]
    singles: tuple[int, ...]
    drives: tuple[PlainDrive, PlainDrive] | None  # of upper (and single) and of lower rotors; None: none
    nominal: tuple[float, ...] | None  # (POWERS,) of the nominal speed over the true one; None: they are one

    @classmethod
    def of(cls, vehicle: Vehicle) -> Edge:
        """Raises InputError where effects bend commands by more than a polynomial of fifth order holds."""
        frame = vehicle.airframe
        return cls(frame.pairs, frame.singles, _drives(vehicle), _nominal(vehicle))

    @property
    def straight(self) -> bool:
        """Whether a command is the speed."""
        return self.drives is None and self.nominal is None

    def nominals(self, speeds: Sequence[float]) -> list[float]:
        """(N,) nominal speeds of true ones."""
        if self.nominal is None:
            return list(speeds)
        found = []
        for u in speeds:
            n = 0.0
            for k in reversed(self.nominal):
                n = n * u + k
            found.append(max(n, 0.0))
        return found

    def commands(self, nominal: Sequence[float]) -> list[float]:
        """(N,) for nominal speeds; not held to 0 .. 1."""
        if self.drives is None:
            return list(nominal)
        out = list(nominal)
        upper, lower = self.drives
        for a, b in self.pairs:
            u, v = nominal[a], nominal[b]
            out[a], out[b] = upper.at(u, v, False), lower.at(u, v, True)
        for i in self.singles:
            out[i] = upper.at(nominal[i], 0.0, False)
        return out


def _drives(vehicle: Vehicle) -> tuple[PlainDrive, PlainDrive] | None:
    """The rotor file's, at the vehicle's supply."""
    rotors = vehicle.rotors
    if rotors.drive is None:
        return None
    supply = float(rotors.drive.supply(vehicle.conditions.voltage_V))
    made = []
    for side, load in ((rotors.drive.upper, rotors.upper_torque), (rotors.drive.lower, rotors.lower_torque)):
        command = [c / supply for c in side.command] + [0.0] * (POWERS - len(side.command))
        per = side.torque_per_Nm / supply, side.torque_speed_per_Nm / supply
        made.append(PlainDrive(PlainLoad.of(load), tuple(command), per, side.least_speed))
    return made[0], made[1]


def _nominal(vehicle: Vehicle) -> tuple[float, ...] | None:
    turning = vehicle.turning
    if not turning.bends:
        return None if turning.share == 1.0 else (0.0, 1.0 / turning.share, 0.0, 0.0, 0.0, 0.0)
    speeds: NDArray[np.float64] = np.linspace(LOWEST, 1.0, 91)
    wanted = turning.nominal(speeds)
    found = np.polynomial.Polynomial.fit(speeds, wanted, POWERS - 1).convert().coef
    missed = float(np.abs(np.polynomial.polynomial.polyval(speeds, found) - wanted).max())
    if missed > BENT:
        names = ", ".join(vehicle.compensated)
        raise InputError("vehicle", "effects", f"{names}: bend commands by more than live mixing can hold")
    return tuple(float(c) for c in np.pad(found, (0, POWERS - len(found))))
