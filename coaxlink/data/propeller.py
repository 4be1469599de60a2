"""Whether readings can be those of one propeller: each relation between them allows a range of diameters.

With n in revolutions a second and D the diameter, static:
T = C_T rho n^2 D^4; figure of merit T^1.5 / (Q omega sqrt(2 rho A)), or over the electrical power; tip speed
pi n D. Ranges: what small propellers do at rest (Brandt and Selig, AIAA 2011-1255, UIUC propeller data; a
rotor in another's wake keeps half of both or more). Where the ranges of diameters have nothing in common no
propeller gives these readings: one of the units is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import STANDARD_DENSITY_KG_M3

Array = NDArray[np.float64]
AIR = STANDARD_DENSITY_KG_M3  # altitude changes a diameter by little
THRUST_COEFFICIENT = (0.03, 0.2)
FIGURE_OF_MERIT = (0.3, 0.85)
IN_WAKE = 0.5  # least share of both that is left in the other rotor's wake
MOTOR_EFFICIENCY = (0.3, 1.15)  # shaft over electrical power, motor and ESC; four sensors of a few per cent
AT_POWER = (0.45, 1.0)  # the same at high throttle, where no speed was measured to hold it against
SHAFT_SENSOR = (0.93, 1.07)  # a logged mechanical power over torque times speed
# m/s at the fastest rows: slower lifts nothing; APC's limit for electric propellers, 190000 rpm over inches
TIP_SPEED = (8.0, 253.0)
DIAMETER = (0.04, 3.5)  # m
GIVEN = (0.93, 1.07)  # about a diameter that somebody measured
ALIKE = 4.0  # times: the coefficients of the two rotors of a pair differ by less
# torque over thrust and diameter, from the ranges above (C_P = sqrt(2/pi) C_T^1.5 / FM)
TORQUE_ARM = tuple(
    math.sqrt(2 / math.pi) * math.sqrt(c) / f / (2 * math.pi)
    for c, f in zip(THRUST_COEFFICIENT, reversed(FIGURE_OF_MERIT), strict=True)
)
HIGH, SLOW = 0.7, 0.1  # of a rotor's fastest row; of the other rotor's range


@dataclass(frozen=True)
class Reading:
    """A rotor at a high speed of its own, the other as slow as the log has it; None where not measured."""

    thrust_N: float | None
    torque_Nm: float | None
    rpm: float | None
    power_W: float | None = None  # electrical, or reported of neither kind
    shaft_W: float | None = None
    in_wake: bool = False  # the other rotor turns as well

    def scaled(self, thrust: float = 1.0, torque: float = 1.0, speed: float = 1.0) -> Reading:
        """The same reading with thrust, torque or speed in other units."""
        return replace(
            self,
            thrust_N=_times(self.thrust_N, thrust),
            torque_Nm=_times(self.torque_Nm, torque),
            rpm=_times(self.rpm, speed),
        )

    def shaft_fault(self) -> tuple[float, str] | None:
        """Torque times speed over a measured power that it cannot be, and which power that is."""
        if not self.rpm or not self.torque_Nm:
            return None
        shaft = abs(self.torque_Nm) * 2 * math.pi * (self.rpm / 60)
        for power, (least, most), name in (
            (self.shaft_W, SHAFT_SENSOR, "mechanical"),
            (self.power_W, MOTOR_EFFICIENCY, "electrical"),
        ):
            if power and not least <= shaft / abs(power) <= most:
                return shaft / abs(power), name
        return None


def readings_of(rotors: Mapping[str, Mapping[str, Array]], shafts: Mapping[str, Array]) -> dict[str, Reading]:
    """Each rotor at high speed, the other one as slow as the rows have it.

    `rotors`: by a rotor's name its columns by quantity, each (rows,); `shafts`: mechanical powers, W.
    """
    names = list(rotors)
    other = {a: b for a in names for b in names if a != b} if len(names) == 2 else {}
    return {n: _reading(rotors[n], rotors.get(other.get(n, ""), {}), shafts.get(n)) for n in names}


def _reading(own: Mapping[str, Array], other: Mapping[str, Array], shaft: Array | None) -> Reading:
    drive = own.get("speed", own.get("throttle"))
    if drive is None or not np.any(drive > 0):
        return Reading(None, None, None)
    rows = drive >= HIGH * drive.max()
    beside = other.get("speed", other.get("throttle"))
    in_wake = False
    if beside is not None and np.any(beside > 0):
        slowest = float(beside[rows].min())
        rows &= beside <= slowest + SLOW * float(beside.max())
        in_wake = slowest > SLOW * float(beside.max())
    n = float(np.median(drive[rows]))

    def at(values: Array | None, power: int) -> float | None:
        found = None if values is None else float(np.median(values[rows] / (drive[rows] / n) ** power))
        return found or None

    power = own.get("power")
    if power is None and "current" in own and "voltage" in own:
        power = own["current"] * own["voltage"]
    return Reading(
        at(own.get("thrust"), 2),
        at(own.get("torque"), 2),
        n if "speed" in own else None,
        at(power, 3),
        at(shaft, 3),
        in_wake,
    )


def diameters(reading: Reading, diameter_m: float | None = None) -> tuple[float, float] | None:
    """(least, greatest) diameter in m that gives this reading, or None when no propeller does."""
    if not reading.rpm and reading.torque_Nm and reading.power_W:
        return _without_speed(reading, diameter_m)
    if reading.shaft_fault():
        return None
    worst = IN_WAKE if reading.in_wake else 1.0
    T, Q, P = (None if x is None else abs(x) for x in (reading.thrust_N, reading.torque_Nm, reading.power_W))
    low, high = DIAMETER if diameter_m is None else tuple(diameter_m * g for g in GIVEN)
    ranges = [(low, high)]
    merit = (FIGURE_OF_MERIT[0] * worst, FIGURE_OF_MERIT[1])
    coefficient = (THRUST_COEFFICIENT[0] * worst, THRUST_COEFFICIENT[1])
    disc = math.sqrt(AIR * math.pi / 2)  # sqrt(2 rho A) = disc D
    if reading.rpm:
        n = reading.rpm / 60
        ranges.append((TIP_SPEED[0] / (math.pi * n), TIP_SPEED[1] / (math.pi * n)))
        if T:
            ranges.append(_range((T / (AIR * n**2 * c)) ** 0.25 for c in coefficient))
        if T and Q:
            ranges.append(_range(T**1.5 / (Q * 2 * math.pi * n * disc * f) for f in merit))
    elif T and Q:
        arm = (TORQUE_ARM[0], TORQUE_ARM[1] / worst**1.5)
        ranges.append(_range(Q / (T * a) for a in arm))
    if T and P:
        overall = (merit[0] * MOTOR_EFFICIENCY[0], merit[1] * MOTOR_EFFICIENCY[1])
        ranges.append(_range(T**1.5 / (P * disc * f) for f in overall))
    low, high = max(r[0] for r in ranges), min(r[1] for r in ranges)
    return (low, high) if low <= high else None


def _without_speed(reading: Reading, diameter_m: float | None) -> tuple[float, float] | None:
    """The diameters over all speeds that torque and electrical power leave possible."""
    full = abs((reading.power_W or 0.0) / (reading.torque_Nm or 1.0)) * 30 / math.pi  # rpm without losses
    shares = [AT_POWER[0] * (AT_POWER[1] / AT_POWER[0]) ** (i / 12) for i in range(13)]
    found = [diameters(replace(reading, rpm=full * share), diameter_m) for share in shares]
    known = [f for f in found if f is not None]
    return (min(f[0] for f in known), max(f[1] for f in known)) if known else None


def _range(values: Iterable[float]) -> tuple[float, float]:
    found = list(values)
    return min(found), max(found)


def possible(readings: Mapping[str, Reading], diameter_m: float | None = None) -> bool:
    """Whether every rotor can be a propeller, and two rotors a pair of about one size."""
    if any(diameters(r, diameter_m) is None for r in readings.values()):
        return False
    if len(readings) < 2:
        return True
    a, b = readings.values()
    if not a.rpm or not b.rpm:
        return _near(a.thrust_N, b.thrust_N, 2 * ALIKE) and _near(a.torque_Nm, b.torque_Nm, 2 * ALIKE)
    ratio = (b.rpm / a.rpm) ** 2
    return (
        _near(_times(a.thrust_N, ratio), b.thrust_N, ALIKE)
        and _near(_times(a.torque_Nm, ratio), b.torque_Nm, ALIKE)
        and _near(_times(a.power_W, ratio**1.5), b.power_W, ALIKE)
    )


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def _near(a: float | None, b: float | None, times: float) -> bool:
    return not a or not b or 1 / times <= abs(a / b) <= times
