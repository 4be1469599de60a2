"""The rig of `blind_stand`: a pair on a thrust stand by laws that are neither `sim`'s nor the analysis's.

Battery, motor, air, blades, cells, and things of no physics. Knows nothing of `coaxlink`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sim.physics.rotors import Pair

Array = NDArray[np.float64]
FULL_V = 33.6


@dataclass
class Rig:
    """One run: the schedule, and everything that may bend its readings (numbers set by the effects)."""

    pair: Pair
    t: Array
    throttle: Array  # (2, rows)
    sweep: Array  # (rows,)
    random: np.random.Generator
    size: dict[str, float] = field(default_factory=dict)
    pick: dict[str, float] = field(default_factory=dict)  # draws that fix an effect's law, in 0..1

    def has(self, name: str) -> float:
        return self.size.get(name, 0.0)


def sagging(rig: Rig, weight: Array) -> Array:
    """(rows,) pack voltage under a load that follows `weight`: discharge, ohmic drop and a slow RC."""
    draw = np.clip(weight / max(float(weight.max()), 1e-9), 0.0, None)
    step = np.diff(rig.t, prepend=rig.t[0])
    used = np.cumsum(draw * step) / max(float(np.sum(draw * step)), 1e-9)
    slow, rc = 0.0, np.zeros_like(draw)
    for k in range(len(draw)):
        slow += (draw[k] - slow) * (1.0 - math.exp(-step[k] / 20.0))
        rc[k] = slow
    return FULL_V * (1.0 - 0.10 * used - 0.05 * draw - 0.04 * rc)


def spin(rig: Rig) -> tuple[Array, Array, Array]:
    """(2, rows) normalised speeds, (rows,) voltage, (rows,) winding temperature."""
    u = rig.throttle.copy()
    work = np.sum(u**3, axis=0)
    step = np.diff(rig.t, prepend=rig.t[0])
    volts = np.full_like(rig.t, FULL_V)
    if rig.has("battery_voltage"):
        volts = sagging(rig, work)
    warm, temperature = 0.0, np.zeros_like(rig.t)
    span = max(0.25 * float(rig.t[-1]), 30.0)
    for k in range(len(rig.t)):
        warm += (work[k] - warm) * (1.0 - math.exp(-step[k] / span))
        temperature[k] = 25.0 + 70.0 * warm
    band = rig.has("dead_band")
    if band:
        if rig.pick["dead_band"] < 0.5:  # a start threshold, then as if it had never been
            u = np.where(u > band, u, 0.0)
        else:  # the idle is subtracted in power
            u = np.where(u > band, np.sqrt(np.maximum(u * u - band * band, 0.0)), 0.0)
    if rig.has("battery_voltage"):
        dip = volts / FULL_V - 1.0
        # a loaded motor feels its supply more than an idling one
        u = u * (1.0 + rig.has("battery_voltage") * dip * (0.8 + 0.4 * u + 0.5 * dip))
    if rig.has("motor_heating"):
        copper = 0.00393 * (temperature - 25.0)
        u = u * (1.0 - rig.has("motor_heating") * copper / (1.0 + 0.5 * copper) * (0.7 + 0.6 * u))
    lag = rig.has("rotor_lag")
    if lag:
        up, down = (lag, 1.4 * lag) if rig.pick["rotor_lag"] < 0.5 else (lag, lag)
        for side in (0, 1):
            now, ramped = u[side, 0], u[side, 0]
            for k in range(len(rig.t)):
                tau = up if u[side, k] > now else down
                # two stages: the controller's, a fifth as slow, then the rotor's
                ramped += (u[side, k] - ramped) * (1.0 - math.exp(-step[k] / max(0.2 * tau, 1e-9)))
                now += (ramped - now) * (1.0 - math.exp(-step[k] / tau))
                u[side, k] = now
    return np.clip(u, 0.0, 1.05), volts, temperature


def air(rig: Rig) -> tuple[Array, Array, Array]:
    """(rows,) temperature C, pressure Pa, density ratio to 15 C and 101325 Pa."""
    x = rig.t / rig.t[-1]
    s = rig.has("air_density")
    if rig.pick.get("air_density", 0.0) < 0.5:  # a hall that warms up
        temperature, pressure = 15.0 + 60.0 * s * (1.0 - np.exp(-3.0 * x)), np.full_like(x, 101325.0)
    else:  # a front goes through
        temperature = 15.0 - 25.0 * s * np.tanh(8.0 * (x - 0.55))
        pressure = 101325.0 * (1.0 + 0.12 * s * np.tanh(6.0 * (x - 0.5)))
    ratio = pressure / 101325.0 * 288.15 / (temperature + 273.15)
    return temperature, pressure, ratio


def bouc_wen(course: Array, reach: float) -> Array:
    """(rows,) -1..1 of a friction that takes a way to turn round; the way back is the stiffer one."""
    state, out = 0.0, np.zeros(len(course))
    for k in range(1, len(course)):
        move = float(course[k] - course[k - 1])
        parts = max(
            1, math.ceil(20.0 * abs(move) / reach)
        )  # between two rows the speed runs, it does not jump
        for _ in range(parts):
            bend = 0.7 * math.copysign(1.0, move * state) + 0.3
            state += move / parts / reach * (1.0 - abs(state) ** 1.5 * bend)
        out[k] = state
    return out


def blades(rig: Rig, u: Array, ratio: Array, spacing: Array) -> Array:
    """(4, rows) loads."""
    a, b = u
    loads = rig.pair.loads(a, b)
    alone = rig.pair.loads(0.0 * a, b)
    s = rig.has("rotor_spacing")
    if s:
        far = spacing / 0.15
        law = np.exp(-1.2 * (far - 1.0)) if rig.pick["rotor_spacing"] < 0.5 else 1.0 / (0.35 + 0.65 * far**2)
        keep = 1.0 + s * (law - 1.0)
        loads[2:] = alone[2:] + (loads[2:] - alone[2:]) * keep
    s = rig.has("blade_speed_law")
    if s:
        for row, own in ((0, a), (1, a), (2, b), (3, b)):
            if rig.pick["blade_speed_law"] < 0.35:  # Reynolds: slow blades carry less
                loads[row] *= 1.0 - s * np.exp(-own / 0.3)
            elif rig.pick["blade_speed_law"] < 0.7:  # Prandtl and Glauert at a fast tip
                loads[row] *= 1.0 + s * (1.0 / np.sqrt(1.0 - 0.45 * own**2) - 1.0)
            else:
                loads[row] *= np.maximum(own, 0.02) ** s
    s = rig.has("air_density")
    if s:
        loads[[0, 2]] *= ratio
        loads[[1, 3]] *= ratio**0.9  # profile drag gains a little by Reynolds number
    s = rig.has("lower_on_upper_interference")
    if s:
        pull = np.maximum(alone[2], 0.0) / max(float(alone[2].max()), 1e-9)  # the lower one's thrust alone
        shape = pull * (a / (a + 0.4)) if rig.pick["lower_on_upper_interference"] < 0.5 else pull**0.8
        loads[0] -= s * float(np.quantile(np.abs(loads[0]), 0.95)) * shape
        loads[1] -= 0.2 * s * float(np.quantile(np.abs(loads[1]), 0.95)) * shape
    s = rig.has("hysteresis")
    if s:
        for first, own in ((0, a), (2, b)):
            reach = 0.04 if rig.pick["hysteresis"] < 0.5 else 0.10
            state = bouc_wen(own, reach)
            loads[first] *= 1.0 - s * state
            loads[first + 1] *= 1.0 - 0.6 * s * state
    return loads


def cells(rig: Rig, loads: Array, u: Array, extra: Array) -> Array:
    """(4, rows) what the load cells add, and what has no physics at all."""
    out = np.zeros_like(loads)
    full = np.quantile(np.abs(loads), 0.95, axis=1)
    x = rig.t / rig.t[-1]
    s = rig.has("sensor_drift")
    if s:
        row, law = int(4 * rig.pick["sensor_drift_channel"]), rig.pick["sensor_drift"]
        creep = np.log1p(9.0 * x) / math.log(10.0)
        courses = (x, np.sqrt(x), creep, np.clip((x - 0.3) / 0.7, 0.0, None))
        out[row] += s * full[row] * courses[int(4 * law)]
    a, b = u
    channel = int(4 * rig.pick.get("strange_channel", 0.0))
    for name, course in (
        ("strange_periodic", np.sin(2 * np.pi * rig.t / max(rig.t[-1] / 11.3, 1.7))),
        ("strange_bursts", (np.sin(2 * np.pi * x * 4.7) > 0.3) * np.sin(2 * np.pi * x * 38.0)),
        ("strange_resonance", np.exp(-(((a + b - 1.05) / 0.07) ** 2))),
        ("strange_beat", np.sin(14.0 * (a - b))),
        ("strange_band", ((a > 0.38) & (a < 0.55)) * ((b > 0.25) & (b < 0.6)) * 1.0),
        ("strange_context", np.sin(extra / 20.0)),
        ("strange_index", np.where(np.arange(len(x)) % 16 < 8, 1.0, -1.0)),
    ):
        if rig.has(name):
            out[channel] += rig.has(name) * full[channel] * course
    return out


def physics(rig: Rig) -> tuple[Array, Array, dict[str, Array]]:
    """(2, rows) speeds, (4, rows) loads without noise, and the context columns."""
    u, volts, temperature = spin(rig)
    warm, pressure, ratio = air(rig)
    levels = np.array([0.8, 1.0, 1.25, 1.6])[np.asarray(rig.sweep, int) % 4]
    spacing = 0.15 * (levels if rig.has("rotor_spacing") else np.ones_like(rig.t))
    angle = 40.0 * np.sin(2 * np.pi * rig.t / rig.t[-1] * 2.3 + 0.5)
    loads = blades(rig, u, ratio, spacing)
    loads = loads + cells(rig, loads, u, angle)
    context = {
        "voltage_V": volts,
        "motor_temperature_C": temperature,
        "air_temperature_C": warm,
        "air_pressure_Pa": pressure,
        "rotor_spacing_m": spacing,
        "table_angle_deg": angle,
    }
    return u, loads, context
