"""What a rotor turns at a command, and what it draws from the battery: the drive of a coaxial pair.

    command V / V_ref = c_0 + c_1 u + c_2 u^2 (+ c_3 u^3) + (r + s u) Q,    u = rpm / speed_max_rpm, Q in N m

A motor's terminal voltage is its back-EMF, which goes with speed, and what its winding's resistance takes,
which goes with torque (Drela 2007, a motor of first order); a cubic takes what an ESC bends, and `s` that at
low duty the current of a winding comes and goes within a period. So a lower rotor that the upper one's wake
unloads turns faster at the same command. Battery watts of a side at w rad/s:

    P = constant + per_rad_s w + per_rad_s2 w^2 + per_Nm2 Q^2 + shaft Q w

idle, iron (hysteresis, eddy currents), copper, and what goes with the shaft's own power. Without a drive a
command *is* the normalised speed, as of an ESC that governs speed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Torque = Callable[[int, Array, Array], Array]  # of the upper (0) or the lower (1) rotor, N m, at both speeds

# of the tabulated speeds: a full pack has 1.15 of the usual voltage
POINTS, MOST_COMMAND, FASTEST = 81, 1.2, 1.25
SPEED_ROUNDS, HALVINGS = 3, 22  # of both speeds in turn; of a command's interval: to 3e-7 of it
STRAIGHT = (0.0, 1.0)
TURNS = 0.05  # of full throttle, of the fastest rpm: below, an ESC starts or stops its motor


@dataclass(frozen=True)
class SideDrive:
    """Of one rotor. `range` are the commands that were measured; below, speeds go straight to rest."""

    command: tuple[float, ...] = STRAIGHT  # c_0, c_1, ... at the drive's voltage
    torque_per_Nm: float = 0.0  # r
    torque_speed_per_Nm: float = 0.0  # s
    range: tuple[float, float] = (0.0, 1.0)
    error: float = 0.0  # of the command, its standard error

    def command_at(self, u: ArrayLike, torque_Nm: ArrayLike) -> Array:
        """Commands (...) that hold speeds (...) under torques (...), at the drive's voltage."""
        u, least = np.asarray(u, float), self.least_speed
        at = np.polynomial.Polynomial(self.command)(np.maximum(u, least))
        held = at + (self.torque_per_Nm + self.torque_speed_per_Nm * u) * np.asarray(torque_Nm, float)
        return np.asarray(np.where(u < least, held * u / max(least, 1e-9), held))

    @property
    def problem(self) -> str:
        """Why no command turns anything by it; empty where it is sound."""
        u = np.linspace(self.least_speed, 1.0, 101)
        torque = u**2 * self._room  # a rotor's own goes with the square
        rises = np.diff(self.command_at(u, torque)) > 0
        return "" if rises.all() else "the command does not grow with the speed"

    @property
    def _room(self) -> float:
        """A torque at full speed (N m) that brings the command there: what the polynomial leaves of it."""
        left = 1.0 - float(np.polynomial.Polynomial(self.command)(1.0))
        per = self.torque_per_Nm + self.torque_speed_per_Nm
        return max(left, 0.0) / per if per > 0 else 0.0

    @cached_property
    def least_speed(self) -> float:
        """The speed at the least command that was measured, without torque."""
        if self.range[0] <= 0.0:
            return 0.0
        u = np.linspace(0.0, 1.0, 2001)
        above = np.polynomial.Polynomial(self.command)(u) >= self.range[0]
        return float(u[int(np.argmax(above))]) if above.any() else 0.0


@dataclass(frozen=True)
class Drive:
    """Of a pair: speeds over commands and back. A rotor without another turns as the upper one does."""

    upper: SideDrive
    lower: SideDrive
    voltage_V: float | None = None  # of the supply at which it holds; None: not known

    def supply(self, voltage_V: ArrayLike | None) -> Array:
        """(...) what a command counts for at a voltage (...); NaN, 0 or None where that is not known."""
        if voltage_V is None or self.voltage_V is None:
            return np.ones(())
        share = np.asarray(voltage_V, float) / self.voltage_V
        return np.asarray(np.where(np.isfinite(share) & (share > 0.0), share, 1.0))

    def commands(self, u: ArrayLike, v: ArrayLike, torque: Torque) -> tuple[Array, Array]:
        """Commands of upper and lower rotor that hold speeds u and v (...), at the drive's voltage."""
        u, v = np.broadcast_arrays(np.asarray(u, float), np.asarray(v, float))
        return self._upper_at(u, v, torque), self._lower_at(v, u, torque)

    def _upper_at(self, u: Array, v: Array, torque: Torque) -> Array:
        return self.upper.command_at(u, torque(0, u, v))

    def _lower_at(self, v: Array, u: Array, torque: Torque) -> Array:
        return self.lower.command_at(v, torque(1, u, v))

    def table(self, torque: Torque) -> SpeedTable:
        """Speeds over both commands; `torque` is the pair's."""
        grid = np.linspace(0.0, MOST_COMMAND, POINTS)
        upper, lower = np.meshgrid(grid, grid, indexing="ij")
        u, v = upper.copy(), lower.copy()
        for _ in range(SPEED_ROUNDS):  # each rotor's speed bears only a little on the other's torque
            u = _solved(partial(self._upper_at, v=v, torque=torque), upper)
            v = _solved(partial(self._lower_at, u=u, torque=torque), lower)
        return SpeedTable(np.stack([u, v]))


@dataclass(frozen=True)
class SpeedTable:
    """Speeds of both rotors (2, POINTS, POINTS) over both commands, 0 .. MOST_COMMAND."""

    speeds: Array

    def __call__(self, upper: ArrayLike, lower: ArrayLike) -> tuple[Array, Array]:
        """Speeds (...) at commands (...), between the table's points by straight lines."""
        a, b = np.broadcast_arrays(np.asarray(upper, float), np.asarray(lower, float))
        step = MOST_COMMAND / (POINTS - 1)
        x, y = (np.clip(c / step, 0.0, POINTS - 1 - 1e-9) for c in (a, b))
        known = np.isfinite(x) & np.isfinite(y)
        i, j = (np.where(known, c, 0.0).astype(int) for c in (x, y))
        p, q = x - i, y - j
        t = self.speeds
        found = (1 - p) * ((1 - q) * t[:, i, j] + q * t[:, i, j + 1])
        found = found + p * ((1 - q) * t[:, i + 1, j] + q * t[:, i + 1, j + 1])
        found = np.where(known, found, np.nan)
        return found[0], found[1]


@dataclass(frozen=True)
class BatteryPower:
    """Battery watts of one side; see the module."""

    constant: float = 0.0  # W
    per_rad_s: float = 0.0
    per_rad_s2: float = 0.0
    per_Nm2: float = 0.0
    shaft: float = 1.0
    error: float = 0.0  # W, on held-out blocks

    def watts(self, rad_s: ArrayLike, torque_Nm: ArrayLike) -> Array:
        """W (...) at angular rates (...) and torques (...); a rotor that the wake turns gives none back."""
        w, q = np.asarray(rad_s, float), np.asarray(torque_Nm, float)
        lost = self.constant + w * (self.per_rad_s + w * self.per_rad_s2) + self.per_Nm2 * q**2
        return np.asarray(np.maximum(lost + self.shaft * q * w, 0.0))


def _solved(command_at: Callable[[Array], Array], wanted: Array) -> Array:
    """Speeds whose command is the one that is wanted, by halving: a drive's command grows with its speed."""
    low, high = np.zeros(wanted.shape), np.full(wanted.shape, FASTEST)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        short = command_at(middle) < wanted
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return np.where(wanted <= 0.0, 0.0, 0.5 * (low + high))


def of_curves(rpm_over_throttle: Mapping[str, Sequence[float]], speed_max_rpm: float) -> Drive:
    """The drive of an older rotor file, which has rpm = b_0 + b_1 t + b_2 t^2 of throttle t by side."""
    throttle = np.linspace(0.05, 1.0, 200)
    sides = {}
    for side, b in rpm_over_throttle.items():
        u = np.polynomial.Polynomial(b)(throttle) / speed_max_rpm
        command = np.polynomial.Polynomial.fit(u, throttle, 5).convert().coef
        sides[side] = SideDrive(tuple(float(c) for c in command), range=(0.05, 1.0))
    only = next(iter(sides.values()))
    return Drive(sides.get("upper", only), sides.get("lower", only))
