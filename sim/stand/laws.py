"""The laws a stand's effects may follow: the first of each is its own, `law = "..."` asks for another.

Others are accepted laws of the same physics, as large over the range the stand runs as the first of the same
size. sim/effects.md gives them with their sources.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim.physics.drive import COPPER_1_K

Array = NDArray[np.float64]

LAWS = {
    "battery_voltage": ("power", "motor", "shepherd"),
    "air_density": ("density", "moist"),
    "sensor_drift": ("linear", "creep", "thermal"),
    "lower_on_upper_interference": ("square", "induced"),
    "blade_speed_law": ("power", "mach", "reynolds"),
    "hysteresis": ("share", "friction"),
    "rotor_lag": ("first_order", "second_order", "asymmetric"),
    "rotor_spacing": ("linear", "decay", "contraction"),
    "motor_heating": ("linear", "resistance"),
    "dead_band": ("stretched", "soft", "breakaway"),
    "strange": ("sine", "bumps"),
}
DOWN_OVER_UP = 1.8  # of an asymmetric lag


def loaded_speed(share: Array | float, voltage: float, resistance: float = 1.0) -> Array:
    """Speed over speed at the reference voltage: (1 - r) y + r R y^2 = V, r the resistive share there."""
    r = np.clip(share, 1e-6, 0.9)
    back = 1.0 - r
    root = np.sqrt(back * back + 4.0 * r * resistance * voltage)
    return np.asarray((root - back) / (2.0 * r * resistance))


def supply_gain(law: str, power: float, voltage: float, throttle: Array) -> Array:
    """Speed over throttle at `voltage` over the reference."""
    if law == "motor":
        return 1.0 + power * (loaded_speed(0.25 * throttle, voltage) - 1.0)
    if law == "shepherd":  # a governor that gives up in proportion, on Shepherd's pack
        return np.full_like(throttle, 1.0 + power * (voltage - 1.0))
    return np.full_like(throttle, voltage**power)


def heat_gain(law: str, size: float, rise_K: float, throttle: Array) -> Array:
    """Speed over cold speed, the winding `rise_K` warmer."""
    if law == "resistance":  # copper's resistance grows, and with it the share of the voltage it takes
        share = min(size / max(100.0 * COPPER_1_K - size, 1e-3), 0.9)
        return loaded_speed(share * throttle / 0.7, 1.0, 1.0 + COPPER_1_K * rise_K)
    return np.full_like(throttle, 1.0 - size * rise_K / 100.0)


def band_target(law: str, band: float, throttle: Array, turning: NDArray[np.bool_]) -> Array:
    """Speed a throttle asks for, above a threshold; `turning` says which rotors run already."""
    if band <= 0.0:
        return throttle
    if law == "soft":  # a rounded corner instead of a sharp one

        def curved(x: Array | float) -> Array:
            return np.asarray(0.5 * (x + np.sqrt(np.square(x) + (0.6 * band) ** 2)))

        low, high = curved(-band), curved(1.0 - band)
        return (curved(throttle - band) - low) / (high - low)
    if law == "breakaway":  # friction at rest: it starts late and then keeps turning
        start = np.where(turning, 0.7 * band, 1.3 * band)
        return np.where(throttle > start, (throttle - 0.7 * band) / (1.0 - 0.7 * band), 0.0)
    return np.where(throttle > band, (throttle - band) / (1.0 - band), 0.0)


def drift(law: str, size: float, since: Array) -> Array:
    """What a cell's zero has wandered after `since` seconds, `size` a minute on average."""
    span = max(float(since[-1]), 1e-9)
    part = since / span
    if law == "creep":  # viscoelastic: with the logarithm of time
        part = np.log1p(since / (0.05 * span)) / math.log1p(20.0)
    elif law == "thermal":  # with a room that warms and settles
        part = np.sin(0.5 * np.pi * part) ** 2
    return size * span / 60.0 * part


def interference(law: str, size: float, u: Array, v: Array) -> Array:
    """N of upper thrust taken by the lower rotor."""
    if law == "induced":  # its own induced flow, in the upper one's wake, reaches back as a climb
        flow = np.sqrt(0.25 * u * u + v * v) - 0.5 * u
        return size * u * flow / (math.sqrt(1.25) - 0.5)
    return size * v**2 * (0.3 + 0.7 * (1.0 - u))


def blade_factor(law: str, size: float, own: Array, thrust: bool) -> Array:
    """Load over the model's, at a rotor's own speed; every law gains 3^size from 0.3 to 0.9."""
    u = np.maximum(own, 1e-3)
    gain = 3.0**size
    if law == "mach":  # Prandtl and Glauert
        square = (gain**2 - 1.0) / (0.81 * gain**2 - 0.09)
        return np.sqrt((1.0 - min(square, 0.95)) / (1.0 - np.minimum(square * u * u, 0.95)))
    if law == "reynolds":  # laminar layers: lift falls with Re^-1/2, the torque by half of that
        low, high = 0.3**-0.5 - 1.0, 0.9**-0.5 - 1.0
        slope = (gain - 1.0) / (gain * low - high)
        return 1.0 - (1.0 if thrust else 0.5) * slope * (np.maximum(u, 0.08) ** -0.5 - 1.0)
    return u**size


def friction(width: float, load: Array) -> Array:
    """A load read through a slide that sticks: the reading follows once it is `width` behind (play)."""
    out, held = np.empty_like(load), float(load[0])
    for k, x in enumerate(load.tolist()):
        held = min(max(held, x - width), x + width)
        out[k] = held
    return out


def wake_factor(law: str, size: float, ratio: Array, spacing_m: Array, radius_m: float) -> Array:
    """Wake's loss over its loss at the usual spacing, at `ratio` times that spacing."""
    if law == "decay":
        return np.exp(-size * (ratio - 1.0))
    if law == "contraction":  # the part of the disc that the contracted wake covers
        reach = _reach(spacing_m / radius_m)
        usual = _reach(spacing_m / ratio / radius_m)
        x = spacing_m / ratio / radius_m
        slope = x * (1.0 + x * x) ** -1.5 / (1.0 + usual)
        return np.asarray(((1.0 + usual) / (1.0 + reach)) ** (size / slope))
    return 1.0 - size * (ratio - 1.0)


def _reach(x: Array) -> Array:
    return x / np.sqrt(1.0 + x * x)


def density_ratio(law: str, temperature_C: Array, pressure_Pa: Array, humidity_pct: Array) -> Array:
    """Air density over that of 15 C and 101325 Pa."""
    vapour = np.zeros_like(temperature_C)
    if law == "moist":  # Tetens; water is lighter than air
        vapour = humidity_pct / 100.0 * 610.78 * np.exp(17.27 * temperature_C / (temperature_C + 237.3))
    return (pressure_Pa - 0.378 * vapour) / 101325.0 * 288.15 / (temperature_C + 273.15)


def strange(law: str, size: float, u: Array, v: Array, thrust: Array, t: Array) -> Array:
    """Something of no physics."""
    window = np.sign(np.sin(t / 17.0))
    if law == "bumps":
        bumps = ((0.35, 0.55, 1.0), (0.7, 0.3, -1.0), (0.6, 0.8, 1.0))
        hills = sum(s * np.exp(-((u - a) ** 2 + (v - b) ** 2) / 0.02) for a, b, s in bumps)
        return size * np.asarray(hills) * np.where(window > 0, 1.4, 0.6)
    return size * np.sin(0.7 * thrust) * window


class StandPack:
    """The stand's battery: `single` resistance, two RC pairs (`motor`), or Shepherd's curve."""

    CELLS, CAPACITY_C, RESISTANCE = 8, 40000.0, 0.012

    def __init__(self, law: str) -> None:
        self._law, self.charge = law, 0.95
        self._slow = [0.0, 0.0]

    def swap(self, charge: float) -> None:
        """Another pack."""
        self.charge, self._slow = charge, [0.0, 0.0]

    def volts(self, current: float, h: float) -> float:
        """At the terminals after h seconds of a current."""
        self.charge = max(self.charge - current * h / self.CAPACITY_C, 0.0)
        drop, charge = self.RESISTANCE * current, self.charge
        if self._law == "shepherd":
            self._slow[0] += (current - self._slow[0]) * (1.0 - math.exp(-h / 10.0))
            spent, drawn = 1.0 - charge, self._slow[0] * 360.0 / self.CAPACITY_C
            curve = 3.80 - 0.012 * (spent + 0.1 * drawn) / max(charge, 0.02) + 0.36 * math.exp(-4.0 * spent)
            return self.CELLS * curve - drop
        rest = self.CELLS * (3.55 + 0.60 * charge - 0.35 * math.exp(-charge / 0.06))
        if self._law == "motor":
            for j, lag in enumerate((3.0, 40.0)):
                self._slow[j] += (0.5 * drop - self._slow[j]) * (1.0 - math.exp(-h / lag))
            return rest - 0.5 * drop - self._slow[0] - self._slow[1]
        return rest - drop
