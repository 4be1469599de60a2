"""Hovers with a stepped split in worlds of momentum theory, read by a bad power module; nothing of coaxlink.

Two rotors in the wake of one another (Leishman, Principles of Helicopter Aerodynamics, 2.13: the lower one
takes the upper's contracted wake in over part of its disk), blades with profile drag, motors that differ in
efficiency; gusts, a pack and windings that warm; a sensor with scale, offset, delay, steps and noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

STEP_S = 0.1


@dataclass(frozen=True)
class Simulation:
    """Electrical watts of a hover of 20 kg on four pairs, by the upper rotors' share of the thrust."""

    lower_efficiency: float = 0.75  # of the lower rotors' drives
    upper_efficiency: float = 0.80
    wake: float = 0.5  # area of the upper's wake over the lower's disk
    pair_N: float = 49.0
    disk_m2: float = 0.16
    profile_W: float = 25.0  # of a rotor at half of the pair's thrust

    def watts(self, share):
        """Four pairs, per share of thrust."""
        upper, lower = self.pair_N * share, self.pair_N * (1.0 - share)
        v = np.sqrt(upper / (2 * 1.2 * self.disk_m2))
        inflow = self.wake * 2.0 * v  # mean over the lower disk
        w = 0.5 * (-inflow + np.sqrt(inflow**2 + 2 * lower / (1.2 * self.disk_m2)))
        blade = self.profile_W * (2 * share) ** 1.5
        other = self.profile_W * (2 - 2 * share) ** 1.5
        up = (upper * v * 1.15 + blade) / self.upper_efficiency
        low = (lower * (w + inflow) * 1.15 + other) / self.lower_efficiency
        return 4.0 * (up + low)

    def least(self, low, high):
        """Share of least watts between these."""
        return float(minimize_scalar(self.watts, bounds=(low, high), method="bounded").x)


def hover(world, shares, dwell_s, rng, *, gust_m_s=1.0, sensor_scale=1.06):
    """time, watts, share, vertical acceleration (m/s2), tilt (rad), each (rows,), of shares held in turn."""
    n = round(dwell_s / STEP_S)
    share = np.repeat(shares, n)
    t = STEP_S * np.arange(len(share))
    gust = gust_m_s * _coloured(len(t), 2.5, rng)
    along = gust_m_s * _coloured(len(t), 6.0, rng) + 2.0
    up = 0.35 * gust
    tilt = 0.02 * along
    load = 1.0 + up / 9.81
    warm = 1.0 + 0.02 * (1.0 - np.exp(-t / 180.0)) + 0.008 * np.sin(t / 400.0)
    wind = 1.0 - 0.004 * along**2 / 4.0
    true = world.watts(share) * load**1.5 * warm * wind
    charge = t / t[-1]
    volts = 50.0 - 4.0 * charge - 1.5 * charge**4 - 0.012 * true / 48.0
    amps = true / volts
    late = np.interp(t - 0.4, t, amps)
    read = sensor_scale * late + 0.7 + rng.normal(0.0, 0.4, len(t))
    seen = np.round(read, 1) * (np.round(volts, 2) + rng.normal(0.0, 0.02, len(t)))
    accel = up + rng.normal(0.0, 0.15, len(t))
    return t, seen, share, accel, tilt + rng.normal(0.0, 0.005, len(t))


def _coloured(n, tau_s, rng):
    """Unit variance, first order."""
    keep = np.exp(-STEP_S / tau_s)
    x = np.empty(n)
    x[0] = rng.normal()
    for k, fresh in enumerate(rng.normal(0.0, np.sqrt(1 - keep**2), n - 1)):
        x[k + 1] = keep * x[k] + fresh
    return x
