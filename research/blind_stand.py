"""A thrust stand that is neither `sim`'s nor the analysis's: other laws of the same physics, other rigs.

Everything is drawn from the seed: rotor pair, schedule (grids in and out of order, ramps, stairs, sines,
random holds), rate, noise, which columns are logged. Every effect's strength is then set so that it is worth
the asked share of thrust: the 95th percentile of what it changes in its most touched load over that load's
own 95th percentile. The laws are in `blind_rig`. Knows nothing of `coaxlink`.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from blind_rig import Array, Rig, physics

from sim.physics.rotors import read_pair

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
PAIRS = ("rotor_paper.toml", "mn4014_bemt", "kde5215_bemt")
LOADS = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")


def schedule(random: np.random.Generator, style: str, sweeps: int) -> tuple[Array, Array, Array]:
    """(rows,) times, (2, rows) throttles, (rows,) sweep number."""
    top = random.uniform(0.85, 0.95)
    if style in ("grid", "shuffled"):
        n, m, dwell = random.integers(8, 13), random.integers(8, 13), random.integers(1, 4)
        a, b = (g.ravel() for g in np.meshgrid(np.linspace(0, top, n), np.linspace(0, top, m), indexing="ij"))
        if random.random() < 0.3:
            a, b = b, a
        if style == "shuffled":
            order = random.permutation(len(a))
            a, b = a[order], b[order]
        a, b, step = np.repeat(a, dwell), np.repeat(b, dwell), float(random.choice([1.0, 2.0, 3.0]))
    elif style == "ramps":
        half, step = int(random.integers(60, 130)), 0.1
        ramp = np.concatenate([np.linspace(0, top, half), np.linspace(top, 0, half)])
        holds = [random.uniform(0.2, 0.9) for _ in range(3)]
        a = np.concatenate([ramp, ramp, *(0 * ramp + h for h in holds), 0 * ramp])
        b = np.concatenate([ramp, 0 * ramp + holds[0], *(ramp for _ in holds), ramp])
    elif style == "sines":
        step, rows = 0.1, int(random.integers(900, 1500))
        x = step * np.arange(rows)
        f, g = random.uniform(0.02, 0.05), random.uniform(0.006, 0.015)
        a = 0.5 * top * (1 - np.cos(2 * np.pi * f * x))
        b = 0.5 * top * (1 - np.cos(2 * np.pi * g * x + 0.3))
    else:  # holds: random levels, a second or two each, at 10 Hz
        step, rows = 0.1, int(random.integers(80, 140))
        each = random.integers(8, 25, size=rows)
        a, b = (np.repeat(random.uniform(0.0, top, rows), each) for _ in range(2))
    upper, lower = np.tile(a, sweeps), np.tile(b, sweeps)
    number = np.repeat(np.arange(sweeps), len(a)).astype(float)
    return step * np.arange(1, len(upper) + 1), np.stack([upper, lower]), number


# which schedules show an effect, whether the log may hold rpm and throttle both, how many sweeps, and whether
# the drive (throttle to speed) is what is bent
SLOW = ("grid", "shuffled", "ramps", "sines", "holds")
MOVING = ("ramps", "sines")
EFFECTS: dict[str, tuple[tuple[str, ...], int, str]] = {
    "battery_voltage": (SLOW, 3, "drive"),
    "air_density": (SLOW, 2, "loads"),
    "sensor_drift": (SLOW, 2, "loads"),
    "lower_on_upper_interference": (SLOW, 1, "loads"),
    "blade_speed_law": (SLOW, 1, "law"),
    "hysteresis": (MOVING, 1, "loads"),
    "rotor_lag": (("holds", "ramps"), 1, "drive"),
    "rotor_spacing": (("grid", "ramps", "holds"), 4, "loads"),
    "motor_heating": (SLOW, 3, "drive"),
    "dead_band": (("grid", "ramps", "sines"), 1, "start"),
}
FAULTS: dict[str, tuple[tuple[str, ...], int, str]] = {
    "lying_tachometer": (("grid", "ramps", "sines"), 1, "both"),
    "swapped_labels": (SLOW, 1, "loads"),
    "stuck_cell": (("ramps", "sines", "holds"), 1, "loads"),
    "repeated_batch": (SLOW, 2, "loads"),
}
STRANGE: dict[str, tuple[tuple[str, ...], int, str]] = {
    "strange_periodic": (SLOW, 2, "loads"),
    "strange_bursts": (("ramps", "sines", "holds"), 2, "loads"),
    "strange_resonance": (("grid", "shuffled", "ramps"), 2, "given"),
    "strange_beat": (SLOW, 2, "given"),
    "strange_band": (("grid", "shuffled", "holds"), 2, "given"),
    "strange_context": (SLOW, 2, "loads"),
    "strange_index": (("grid", "ramps", "holds"), 2, "loads"),
}
DOUBLES = (
    ("air_density", "sensor_drift"),
    ("air_density", "rotor_spacing"),
    ("lower_on_upper_interference", "sensor_drift"),
    ("blade_speed_law", "rotor_spacing"),
    ("battery_voltage", "dead_band"),
    ("battery_voltage", "sensor_drift"),
    ("hysteresis", "lower_on_upper_interference"),
    ("motor_heating", "rotor_spacing"),
    ("air_density", "hysteresis"),
    ("rotor_lag", "sensor_drift"),
)
ALL = EFFECTS | FAULTS | STRANGE
FIXED = {"swapped_labels", "stuck_cell", "repeated_batch"}


@dataclass(frozen=True)
class Made:
    """A world: the columns a guest sees, the model file it is given, and what is true."""

    columns: dict[str, Array]
    rotor: str | None
    truth: dict[str, object]


def make(hidden: tuple[str, ...], seed: int, worth: float) -> Made:
    """The log of one world, with its effects each worth `worth` of thrust."""
    random = np.random.default_rng([seed, zlib.crc32("+".join(hidden).encode()), 0x0DD])
    styles = [ALL[name] for name in hidden] or [(SLOW, int(random.integers(1, 4)), "clean")]
    common = [s for s in SLOW if all(s in allowed for allowed, _, _ in styles)]
    style = common[int(random.integers(len(common)))]
    kinds = {kind for _, _, kind in styles}
    t, throttle, sweep = schedule(random, style, max(n for _, n, _ in styles))
    surfaces = kinds & {"law", "given", "start"}
    pair_name = PAIRS[0] if surfaces else str(random.choice(PAIRS, p=[0.6, 0.2, 0.2]))
    pair = read_pair(EXAMPLES / pair_name)
    given = pair_name == PAIRS[0] and (bool(kinds & {"law", "given"}) or random.random() < 0.7)
    rig = Rig(pair, t, throttle, sweep, random)
    for name in ("sensor_drift_channel", "strange_channel", *sorted(ALL)):
        rig.pick[name] = float(random.random())
    drive = "both" if kinds & {"both", "drive", "start"} else str(random.choice(["rpm", "both", "throttle"]))
    if "law" in kinds and drive == "throttle":  # who has no rpm cannot tell blades from the drive
        drive = "rpm"
    if kinds <= {"drive", "start"} and hidden and given and random.random() < 0.4:
        drive = "throttle"
    sizes = {name: _strength(rig, name, worth) for name in hidden if name not in FIXED}
    rig.size = {k: v for k, v in sizes.items() if k != "lying_tachometer"}
    u, loads, context = physics(rig)
    noise = float(random.choice([0.002, 0.004, 0.007]))
    full = np.quantile(np.abs(loads), 0.95, axis=1)
    sigma = noise * full * np.array([1.0, 0.8, 1.0, 0.8])
    measured = loads + sigma[:, None] * random.standard_normal(loads.shape)
    columns = _log(rig, hidden, sizes, (u, measured, context), drive)
    truth: dict[str, object] = {
        "style": style, "pair": pair_name, "given": given, "drive": drive, "worth": worth,
        "noise": noise, "sigma": dict(zip(LOADS, sigma.tolist(), strict=True)), "sizes": sizes,
        "pick": {n: rig.pick[n] for n in hidden}, "rows": len(t),
    }  # fmt: skip
    return Made(columns, PAIRS[0] if given else None, truth)


def _strength(rig: Rig, name: str, worth: float) -> float:
    """The size at which an effect alone is worth this share of thrust."""
    if name == "lying_tachometer":
        return max(worth, 0.03)
    share = _share_of(rig, name)
    low, high = (1e-4, 1e-4)
    top = {"dead_band": 0.5, "rotor_lag": 5.0}.get(name, 3.0)
    while share(high) < worth and high < top:
        high *= 1.6
    for _ in range(25):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if share(middle) < worth else (low, middle)
    return high


def _share_of(rig: Rig, name: str) -> Callable[[float], float]:
    rig.size = {}
    plain = physics(rig)[1]
    full = np.quantile(np.abs(plain), 0.95, axis=1)

    def share(size: float) -> float:
        rig.size = {name: size}
        moved = np.abs(physics(rig)[1] - plain)
        # a dead band touches few rows: what counts is where it acts
        level = {"dead_band": 0.98, "rotor_lag": 0.97}.get(name, 0.95)
        return float(np.max(np.quantile(moved, level, axis=1) / full))

    return share


def _log(
    rig: Rig,
    hidden: tuple[str, ...],
    sizes: dict[str, float],
    run: tuple[Array, Array, dict[str, Array]],
    drive: str,
) -> dict[str, Array]:
    u, loads, context = run
    random, rows = rig.random, len(rig.t)
    shown = u.copy()
    if "lying_tachometer" in hidden:
        side, law = int(random.integers(2)), rig.pick["lying_tachometer"]
        above = 0.45 if law < 0.5 else 0.6  # pulses counted twice now and then, above a speed
        shown[side] *= 1.0 + sizes["lying_tachometer"] * (shown[side] > above)
    if "stuck_cell" in hidden:
        row, first = int(random.integers(4)), int(random.integers(rows // 5, rows // 2))
        loads[row, first : first + rows // 10] = loads[row, first]
    if "repeated_batch" in hidden:
        n, first, to = (
            rows // 12,
            int(random.integers(0, rows // 4)),
            int(random.integers(rows // 2, rows * 3 // 4)),
        )
        loads[:, to : to + n] = loads[:, first : first + n]
    order = (1, 0) if "swapped_labels" in hidden else (0, 1)
    rpm = rig.pair.speed_max_rpm
    columns = {"time_s": rig.t}
    for name, side in zip(("upper", "lower"), order, strict=True):
        if drive != "throttle":
            noisy = rpm * shown[side] + 0.0005 * rpm * random.standard_normal(rows) * (shown[side] > 0)
            columns[f"{name}_rpm"] = np.maximum(noisy, 0.0)
        if drive != "rpm":
            columns[f"{name}_throttle"] = rig.throttle[side]
    columns.update(zip(LOADS, loads, strict=True))
    noise = {"voltage_V": 0.02, "motor_temperature_C": 0.3, "air_temperature_C": 0.1, "air_pressure_Pa": 15.0}
    for name, values in context.items():
        columns[name] = values + noise.get(name, 0.0) * random.standard_normal(rows)
    columns["humidity_pct"] = 45.0 + np.cumsum(0.2 * random.standard_normal(rows))
    return columns
