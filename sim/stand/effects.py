"""The thrust stand when something is true of it: effects and faults, read as time passes.

A run is a schedule of throttles (the paper's grid, or ramps) on one coaxial pair. The chain is physical:
throttle -> dead band -> supply and heat -> lag -> speed -> blades and air -> load cells -> the log. Each
link is a plain number unless an effect bends it. Truth files may add a [stand] table:
  pattern = "grid" | "ramps"   steady points (2 s each), or slow ramps up and down at 10 Hz
  drive = "rpm" | "throttle"   which of the two the log shows
  sweeps = 1                   how often the pattern is run (spacing and air change between sweeps)
An effect follows the first of its laws (`bench_laws.LAWS`) unless it says `law = "..."`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.documents import read_document, read_number, refuse_unknown
from sim.errors import SimulationError
from sim.physics.pair import Pair
from sim.stand import laws
from sim.stand.grid import GRID, SUPPLY_V, THRUST_NOISE_N, TORQUE_NOISE_NM
from sim.stand.schedule import Schedule

AIR_T, AIR_P, SPACING_M = 15.0, 101325.0, 0.15
RADIUS_M = 0.235
FRICTION_N = 15.0  # of the slide, over `size` of hysteresis by friction


@dataclass(frozen=True)
class StandEffect:
    """One thing that is true of the stand."""

    name: str
    size: float
    onset_s: float
    channel: int  # 0 upper thrust, 1 upper torque, 2 lower thrust, 3 lower torque
    law: str = ""  # the first of the effect's own


# name: what `size` means
SIZES = {
    "battery_voltage": "power p of speed = throttle (V / 33.6)^p, on a sagging pack",
    "air_density": "1: thrust and torque go with density while the weather changes",
    "sensor_drift": "N (or N m) a minute on one channel",
    "lower_on_upper_interference": "N of upper thrust taken by the lower rotor at full speed",
    "blade_speed_law": "loads go as u^size times the model's: Reynolds and tip speed",
    "hysteresis": "share of thrust, up sweeps against down sweeps",
    "rotor_lag": "s between throttle and speed",
    "rotor_spacing": "share of the wake's loss lost a rotor spacing of 0.15 m further apart",
    "motor_heating": "share of speed lost at 100 K of winding temperature",
    "dead_band": "throttle below which nothing turns",
    "lying_tachometer": "share by which the upper tachometer reads high above half speed",
    "swapped_labels": "1: upper and lower motor labels are swapped in the log",
    "stuck_cell": "1: one load cell repeats its last reading for a tenth of the run",
    "battery_swap": "charge (0..1) of the pack that is put in at onset_s",
    "strange": "N of thrust that comes and goes with no physics, on one channel",
}
CHANNELS = ("upper_thrust", "upper_torque", "lower_thrust", "lower_torque")


@dataclass(frozen=True)
class StandSetup:
    """How the stand is run, and what is true of it."""

    effects: tuple[StandEffect, ...] = ()
    pattern: str = "grid"
    drive: str = "rpm"
    sweeps: int = 1

    def size(self, name: str, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """(rows,) size of an effect over time; 0 where it is not true."""
        total = np.zeros_like(t)
        for e in self.effects:
            if e.name == name:
                total += np.where(t >= e.onset_s, e.size, 0.0)
        return total

    def law(self, name: str) -> str:
        """Which law an effect follows; empty for its own."""
        return next((e.law for e in self.effects if e.name == name), "")


def read_bench(path: Path) -> StandSetup:
    """Read a truth file for the stand. Raises WorldError naming the key."""
    document = read_document(path)
    refuse_unknown(path, "", document, ("stand", "effects"))
    stand, tables, effects = document.get("stand", {}), document.get("effects", []), []
    if not isinstance(stand, dict) or not isinstance(tables, list):
        raise SimulationError(path, "stand, effects", "a table [stand] and tables [[effects]] are expected")
    for number, table in enumerate(tables, 1):
        where = f"effects[{number}]"
        name = table.get("name") if isinstance(table, dict) else None
        if not isinstance(name, str) or name not in SIZES:
            raise SimulationError(path, f"{where}.name", f"on a stand, one of {', '.join(SIZES)} is expected")
        refuse_unknown(path, where, table, ("name", "size", "onset_s", "channel", "law"))
        channel = table.get("channel", "lower_thrust")
        if channel not in CHANNELS:
            raise SimulationError(path, f"{where}.channel", f"one of {', '.join(CHANNELS)} is expected")
        law = table.get("law", "")
        if law and law not in laws.LAWS.get(name, ()):
            known = ", ".join(laws.LAWS.get(name, ("no law of its own",)))
            raise SimulationError(path, f"{where}.law", f"one of {known} is expected")
        effects.append(
            StandEffect(
                name,
                read_number(path, f"{where}.size", table.get("size")),
                read_number(path, f"{where}.onset_s", table.get("onset_s", 0.0)),
                CHANNELS.index(channel),
                law,
            )
        )
    refuse_unknown(path, "stand", stand, ("pattern", "drive", "sweeps"))
    pattern, drive = stand.get("pattern", "grid"), stand.get("drive", "rpm")
    sweeps = stand.get("sweeps", 1)
    if pattern not in ("grid", "ramps") or drive not in ("rpm", "throttle"):
        raise SimulationError(path, "stand", "pattern is grid or ramps, drive is rpm or throttle")
    if not isinstance(sweeps, int) or not 1 <= sweeps <= 50:
        raise SimulationError(path, "stand.sweeps", "1 to 50 sweeps are expected")
    return StandSetup(tuple(effects), pattern, drive, sweeps)


def measure(
    pair: Pair, bench: StandSetup, *, seed: int = 0, schedule: Schedule | None = None
) -> dict[str, NDArray[np.float64]]:
    """Columns (rows,) of one run, named as in a stand log; a schedule replaces the truth file's pattern."""
    random = np.random.default_rng([seed, 0xBE7C])
    if schedule is None:
        t, upper, lower, sweep = _schedule(bench)
    else:
        t, upper, lower, sweep = schedule.time_s, schedule.upper, schedule.lower, schedule.piece
    spin = _Spin(bench, t)
    if schedule is not None:
        spin.supply = schedule.supply_V
    speed = spin.run(pair, upper, lower)
    air_t = AIR_T + 12.0 * np.sin(t / t[-1] * 3.0 + 0.4) * (bench.size("air_density", t) != 0)
    air_p = AIR_P - 2500.0 * (t / t[-1]) * (bench.size("air_density", t) != 0)
    spacing = SPACING_M * (1.0 + 0.4 * ((sweep % 4) - 1.5) * (bench.size("rotor_spacing", t) != 0))
    if schedule is not None:
        set_to = schedule.spacing_m
        spacing = np.where(np.isfinite(set_to), set_to, SPACING_M)
    humidity = np.random.default_rng([seed, 0x40D]).standard_normal(len(t)).cumsum() * 0.2 + 45.0
    wet = np.clip(humidity + 40.0 * t / t[-1], 5.0, 98.0)
    ratio = laws.density_ratio(bench.law("air_density"), air_t, air_p, wet)
    loads = _loads(pair, bench, t, speed, ratio, spacing)
    loads += _cells(bench, t, speed, loads)
    if bench.law("hysteresis") == "friction":
        for channel in (0, 2):
            width = FRICTION_N * float(bench.size("hysteresis", t)[-1])
            loads[channel] = laws.friction(width, loads[channel])
    sigma = np.array([THRUST_NOISE_N, TORQUE_NOISE_NM, THRUST_NOISE_N, TORQUE_NOISE_NM])
    loads += sigma[:, None] * random.standard_normal(loads.shape)
    for e in bench.effects:
        if e.name == "stuck_cell":
            first = len(t) // 2
            loads[e.channel, first : first + max(len(t) // 10, 2)] = loads[e.channel, first]
    shown = speed.copy()
    shown[0] *= 1.0 + bench.size("lying_tachometer", t) * (speed[0] > 0.5)
    pair_of = [(upper, shown[0]), (lower, shown[1])]
    if bench.size("swapped_labels", t).any():
        pair_of.reverse()
    columns = {"time_s": t}
    for name, (throttle, u) in zip(("upper", "lower"), pair_of, strict=True):
        if bench.drive == "rpm":
            columns[f"{name}_rpm"] = np.maximum(
                pair.speed_max_rpm * u + 3.0 * random.standard_normal(len(t)), 0
            )
        columns[f"{name}_throttle"] = throttle
    names = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")
    columns.update(zip(names, loads, strict=True))
    columns["voltage_V"] = spin.voltage + 0.01 * random.standard_normal(len(t))
    columns["motor_temperature_C"] = spin.heat + 25.0 + 0.2 * random.standard_normal(len(t))
    columns["air_temperature_C"] = air_t + 0.1 * random.standard_normal(len(t))
    columns["air_pressure_Pa"] = air_p + 10.0 * random.standard_normal(len(t))
    columns["rotor_spacing_m"] = spacing
    # context that matters to nothing (but to moist air), for a guest that looks too hard
    dry = 45.0 + np.cumsum(0.2 * random.standard_normal(len(t)))
    columns["humidity_pct"] = wet if bench.law("air_density") == "moist" else dry
    return columns


def _schedule(bench: StandSetup) -> tuple[Any, Any, Any, Any]:
    """Times, upper and lower throttle, number of the sweep; each (rows,)."""
    if bench.pattern == "grid":
        a, b = (axis.ravel() for axis in np.meshgrid(GRID, GRID, indexing="ij"))
        step = 2.0
    else:
        ramp = np.concatenate([np.linspace(0.0, 0.9, 90), np.linspace(0.9, 0.0, 90)])
        rest = np.full_like(ramp, 0.0)
        still = [0.3, 0.5, 0.7, 0.9]
        a = np.concatenate([ramp, ramp, *[rest + s for s in still], rest])
        b = np.concatenate([ramp, rest + 0.6, *[ramp for _ in still], ramp])
        step = 0.1
    upper, lower = np.tile(a, bench.sweeps), np.tile(b, bench.sweeps)
    sweep = np.repeat(np.arange(bench.sweeps), len(a)).astype(float)
    return step * np.arange(1, len(upper) + 1), upper, lower, sweep


class _Spin:
    """Throttle to speed as time passes: dead band, supply, heat, lag."""

    def __init__(self, bench: StandSetup, t: NDArray[np.float64]) -> None:
        self.bench, self.t = bench, t
        self.voltage = np.full_like(t, SUPPLY_V)
        self.heat = np.zeros_like(t)
        self.supply: NDArray[np.float64] | None = None  # V that a bench supply is set to, NaN where it is not

    def run(self, pair: Pair, upper: NDArray[np.float64], lower: NDArray[np.float64]) -> NDArray[np.float64]:
        """(2, rows) normalised speeds."""
        b, t = self.bench, self.t
        power, heating = b.size("battery_voltage", t), b.size("motor_heating", t)
        band, lag, swap = b.size("dead_band", t), b.size("rotor_lag", t), b.size("battery_swap", t)
        pack = laws.StandPack(b.law("battery_voltage"))
        volts, heat, u, led = SUPPLY_V, 0.0, np.zeros(2), np.zeros(2)
        speed, before = np.zeros((2, len(t))), 0.0
        for k in range(len(t)):
            h, before = t[k] - before, t[k]
            if swap[k] and not swap[max(k - 1, 0)]:
                pack.swap(swap[k])
            throttle = np.array([upper[k], lower[k]])
            fixed = self.supply is not None and math.isfinite(self.supply[k])
            if fixed and self.supply is not None:
                volts = float(self.supply[k])
            target = laws.band_target(b.law("dead_band"), band[k], throttle, u > 0.01)
            if power[k]:
                target = target * laws.supply_gain(
                    b.law("battery_voltage"), power[k], volts / SUPPLY_V, throttle
                )
            target = target * laws.heat_gain(b.law("motor_heating"), heating[k], heat, throttle)
            u, led = _late(b.law("rotor_lag"), lag[k], u, led, target, h)
            speed[:, k] = u
            torque = pair.loads(u[0], u[1])[[1, 3]]
            current = (
                float((np.maximum(torque, 0.0) * u).sum()) * pair.speed_max_rpm * math.pi / 30 / 0.8 / volts
            )
            heat += h * (0.02 * current - heat / 90.0)
            if (power[k] or swap.any()) and not fixed:
                volts = pack.volts(current, h)
            self.voltage[k], self.heat[k] = volts, heat
        return speed


def _late(
    law: str,
    lag: float,
    u: NDArray[np.float64],
    led: NDArray[np.float64],
    target: NDArray[np.float64],
    h: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(2,) speeds h seconds on, and what they follow."""
    if lag <= 0.0:
        return target, target
    if law == "second_order":  # two of half the time, one after the other
        keep = math.exp(-2.0 * h / lag)
        return target + (u - target + (led - target) * 2.0 * h / lag) * keep, target + (led - target) * keep
    pole = np.full(2, lag)
    if law == "asymmetric":
        ratio = laws.DOWN_OVER_UP
        pole = lag * np.where(target > u, 2.0, 2.0 * ratio) / (1.0 + ratio)
    return target + (u - target) * np.exp(-h / pole), target


def _loads(
    pair: Pair,
    bench: StandSetup,
    t: NDArray[np.float64],
    speed: NDArray[np.float64],
    density: NDArray[np.float64],
    spacing: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(4, rows) what the blades do."""
    u, v = speed
    loads = pair.loads(u, v)
    alone = pair.loads(0.0 * u, v)[2:]
    for e in bench.effects:
        on = t >= e.onset_s
        if e.name == "rotor_spacing":
            far = laws.wake_factor(e.law, e.size, spacing / SPACING_M, spacing, RADIUS_M)
            loads[2:] = alone + (loads[2:] - alone) * np.where(on, far, 1.0)
    for e in bench.effects:
        on = t >= e.onset_s
        if e.name == "blade_speed_law":
            for s, own in ((0, u), (1, u), (2, v), (3, v)):
                loads[s] *= np.where(on, laws.blade_factor(e.law, e.size, own, s % 2 == 0), 1.0)
    loads *= density ** bench.size("air_density", t)
    for e in bench.effects:
        if e.name == "lower_on_upper_interference":
            loads[0] -= (t >= e.onset_s) * laws.interference(e.law, e.size, u, v)
    if bench.law("hysteresis") != "friction":
        rising = np.sign(np.gradient(u) + np.gradient(v))
        loads[[0, 2]] *= 1.0 + bench.size("hysteresis", t) * 0.5 * rising
    return loads


def _cells(
    bench: StandSetup, t: NDArray[np.float64], speed: NDArray[np.float64], loads: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(4, rows) what the load cells add of their own."""
    added = np.zeros_like(loads)
    for e in bench.effects:
        since = np.maximum(t - e.onset_s, 0.0)
        if e.name == "sensor_drift":
            added[e.channel] += laws.drift(e.law, e.size, since)
        elif e.name == "strange":
            added[e.channel] += laws.strange(e.law, e.size, speed[0], speed[1], loads[0], t) * (since > 0)
    return added
