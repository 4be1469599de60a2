"""Our own hidden worlds for `tracing.py`, drawn from a seed; nothing here knows of `coaxlink`.

*Stand*: a pair on a thrust stand by laws that are neither `sim`'s nor the analysis's: battery, motor, air,
blades, cells, and things of no physics. Rotor pair, schedule, rate, noise and logged columns vary. An effect
is as strong as makes it worth the given share of thrust: the 95th percentile of what it changes in its most
touched load over that load's own 95th percentile. *Bench*: the virtual stand of `sim` from a truth file.
*Flight*: the stand-in autopilot of `sim` with a truth file; airframe, plan, sensor noise, rate and columns
vary. Faults and strange things are put into the finished log, for they are of the log.
"""

from __future__ import annotations

import math
import tempfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim import flights
from sim.physics.plant import BatteryPack, Plant
from sim.physics.rotors import Pair, read_pair
from sim.physics.sensors import Sensors
from sim.px4.autopilot import Autopilot
from sim.px4.cascade import Goal
from sim.stand import effects as bench
from sim.stand import laws as bench_laws
from sim.truth import FORMS, read_truth
from sim.vehicle import read_vehicle

Array = NDArray[np.float64]
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@dataclass(frozen=True)
class Made:
    """A world: the columns a guest sees, the files it is given, and what is true."""

    columns: dict[str, Array]
    truth: dict[str, object]
    rotor: str | None = None  # example that the guest is given
    airframe: str = ""  # text of the file that the guest is given


FAULTS = {
    "lying_tachometer", "swapped_labels", "stuck_cell", "repeated_batch",
    "swapped_motors", "stuck_accel", "reversed_gyro", "repeated_stretch",
}  # fmt: skip


def worth_of(seed: int) -> float:
    """Share of thrust of a world's effects: one seed in five below 3 %, the others 3 to 10 %."""
    if seed % 5 == 4:
        return 0.01 + 0.02 * (seed // 5 % 4) / 3.5
    k = 7 * (seed // 5 * 4 + seed % 5) % 16  # out of order, so that a few seeds are a fair sample
    return 0.03 * (10.0 / 3.0) ** (k / 15.0)


# the stand: its rig

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


# the stand: what is drawn

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
STAND_EFFECTS: dict[str, tuple[tuple[str, ...], int, str]] = {
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
STAND_FAULTS: dict[str, tuple[tuple[str, ...], int, str]] = {
    "lying_tachometer": (("grid", "ramps", "sines"), 1, "both"),
    "swapped_labels": (SLOW, 1, "loads"),
    "stuck_cell": (("ramps", "sines", "holds"), 1, "loads"),
    "repeated_batch": (SLOW, 2, "loads"),
}
STAND_STRANGE: dict[str, tuple[tuple[str, ...], int, str]] = {
    "strange_periodic": (SLOW, 2, "loads"),
    "strange_bursts": (("ramps", "sines", "holds"), 2, "loads"),
    "strange_resonance": (("grid", "shuffled", "ramps"), 2, "given"),
    "strange_beat": (SLOW, 2, "given"),
    "strange_band": (("grid", "shuffled", "holds"), 2, "given"),
    "strange_context": (SLOW, 2, "loads"),
    "strange_index": (("grid", "ramps", "holds"), 2, "loads"),
}
STAND_DOUBLES = (
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
STAND = STAND_EFFECTS | STAND_FAULTS | STAND_STRANGE
FIXED = {"swapped_labels", "stuck_cell", "repeated_batch"}


def make_stand(hidden: tuple[str, ...], seed: int, worth: float) -> Made:
    """The log of one world, with its effects each worth `worth` of thrust."""
    random = np.random.default_rng([seed, zlib.crc32("+".join(hidden).encode()), 0x0DD])
    styles = [STAND[name] for name in hidden] or [(SLOW, int(random.integers(1, 4)), "clean")]
    common = [s for s in SLOW if all(s in allowed for allowed, _, _ in styles)]
    style = common[int(random.integers(len(common)))]
    kinds = {kind for _, _, kind in styles}
    t, throttle, sweep = schedule(random, style, max(n for _, n, _ in styles))
    surfaces = kinds & {"law", "given", "start"}
    pair_name = PAIRS[0] if surfaces else str(random.choice(PAIRS, p=[0.6, 0.2, 0.2]))
    pair = read_pair(EXAMPLES / pair_name)
    given = pair_name == PAIRS[0] and (bool(kinds & {"law", "given"}) or random.random() < 0.7)
    rig = Rig(pair, t, throttle, sweep, random)
    for name in ("sensor_drift_channel", "strange_channel", *sorted(STAND)):
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
    return Made(columns, truth, PAIRS[0] if given else None)


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


# the virtual stand of `sim`

# name: size in the stand's own unit at 1 % and at 10 % of thrust, pattern, sweeps, drives
BENCH: dict[str, tuple[float, float, tuple[str, ...], int, tuple[str, ...]]] = {
    "battery_voltage": (0.1, 0.9, ("ramps", "grid"), 4, ("throttle", "rpm")),
    "air_density": (1.0, 1.0, ("grid", "ramps"), 4, ("rpm", "throttle")),
    "sensor_drift": (0.08, 0.8, ("grid",), 2, ("rpm", "throttle")),
    "lower_on_upper_interference": (0.7, 7.0, ("grid", "ramps"), 1, ("rpm",)),
    "blade_speed_law": (0.015, 0.15, ("grid", "ramps"), 1, ("rpm",)),
    "hysteresis": (0.015, 0.15, ("ramps",), 1, ("rpm",)),
    "rotor_lag": (0.05, 0.4, ("ramps",), 1, ("throttle", "rpm")),
    "rotor_spacing": (0.06, 0.6, ("grid", "ramps"), 4, ("rpm",)),
    "motor_heating": (0.015, 0.15, ("ramps",), 4, ("throttle", "rpm")),
    "dead_band": (0.02, 0.1, ("ramps", "grid"), 1, ("throttle", "rpm")),
    "strange": (0.7, 6.0, ("ramps",), 1, ("rpm",)),
    "lying_tachometer": (0.03, 0.12, ("grid", "ramps"), 1, ("rpm",)),
}
BENCH_DOUBLES = (
    ("air_density", "sensor_drift"),
    ("rotor_spacing", "air_density"),
    ("sensor_drift", "lower_on_upper_interference"),
    ("blade_speed_law", "rotor_spacing"),
    ("hysteresis", "lower_on_upper_interference"),
)
TORQUE_SHARE = 0.022


def laws_of(name: str) -> tuple[str, ...]:
    """Laws that the stand knows beside its first one."""
    return tuple(bench_laws.LAWS.get(name, ()))[1:]


def has_other_law(kind: str, hidden: tuple[str, ...]) -> bool:
    """Whether the world knows another law for one of these."""
    if kind == "stand":
        return any(laws_of(n) for n in hidden)
    return any(len(getattr(FORMS[n], "laws", ())) > 1 for n in hidden)


def make_bench(hidden: tuple[str, ...], seed: int, worth: float, family: str) -> Made:
    """One run of the virtual stand."""
    random = np.random.default_rng([seed, zlib.crc32("+".join((family, *hidden)).encode()), 0x57A])
    patterns = [p for p in BENCH[hidden[0]][2] if all(p in BENCH[n][2] for n in hidden)] or [
        BENCH[hidden[0]][2][0]
    ]
    drives = [d for d in BENCH[hidden[0]][4] if all(d in BENCH[n][4] for n in hidden)] or ["rpm"]
    lines = [
        "[stand]", f'pattern = "{random.choice(patterns)}"', f'drive = "{random.choice(drives)}"',
        f"sweeps = {max(BENCH[n][3] for n in hidden)}",
    ]  # fmt: skip
    for name in hidden:
        low, high = BENCH[name][:2]
        size = low + (high - low) * (worth - 0.01) / 0.09
        channel = bench.CHANNELS[int(random.integers(4))]
        if name in ("sensor_drift", "strange") and channel.endswith("torque"):
            size *= TORQUE_SHARE
        lines += ["[[effects]]", f'name = "{name}"', f"size = {size:.6g}", f'channel = "{channel}"']
        laws = laws_of(name)
        if family == "law" and laws:
            lines.append(f'law = "{laws[int(random.integers(len(laws)))]}"')
    text = "\n".join(lines) + "\n"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "truth.toml"
        path.write_text(text)
        bench_file = bench.read_bench(path)
    columns = bench.measure(read_pair(EXAMPLES / "rotor_paper.toml"), bench_file, seed=seed)
    return Made(columns, {"worth": worth, "told": text}, "rotor_paper.toml")


# flights

AIRFRAMES = ("x8_demo.toml", "y6.toml", "coax_quad_plus.toml")
LAG_S = 0.02
FALLEN_RAD, ATTEMPTS, SMALLER = 1.5, 12, 0.9
# size of an effect in the world's own unit when it is worth one of thrust
WORTH = {
    "battery_voltage": 1 / 0.18,
    "ground_effect": 1 / 0.39,
    "rotor_drag": 22.0,
    "axial_inflow": 1 / 0.02,
    "rotor_lag": 0.6,
    "rotor_inertia_torque": 0.03,
    "degraded_rotor": 8.0,
    "cg_offset": 0.18,
    "mass_change": 20.0,
    "wind": 80.0,
}
FLIGHT_DOUBLES = (
    ("rotor_drag", "degraded_rotor"),
    ("cg_offset", "axial_inflow"),
    ("battery_voltage", "ground_effect"),
    ("degraded_rotor", "rotor_lag"),
    ("rotor_drag", "ground_effect"),
    ("battery_voltage", "cg_offset"),
    ("axial_inflow", "rotor_drag"),
    ("mass_change", "cg_offset"),
)
FLIGHT_FAULTS = ("swapped_motors", "stuck_accel", "reversed_gyro", "repeated_stretch")
FLIGHT_STRANGE = ("strange_periodic", "strange_heading", "strange_threshold", "strange_band")


def truth_toml(
    hidden: tuple[str, ...], worth: float, random: np.random.Generator, family: str, rotors: int
) -> str:
    """The truth file of physical effects; `family` same: the world's first law, law: one of its others."""
    blocks = []
    for name in hidden:
        if name not in WORTH:
            continue
        lines = ["[[effects]]", f'name = "{name}"']
        size = WORTH[name] * worth + (0.02 if name == "rotor_lag" else 0.0)
        if name == "degraded_rotor":
            size = min(size, 0.5)
            lines.append(f"rotor = {int(random.integers(1, rotors + 1))}")
            if random.random() < 0.3:
                lines.append(f"onset_s = {random.uniform(20.0, 45.0):.1f}")
        if name in ("cg_offset", "wind"):
            lines.append(f"direction_deg = {random.uniform(0, 360):.1f}")
        if name == "ground_effect":
            lines.append(f"scale_m = {random.uniform(0.6, 1.0):.2f}")
        laws = tuple(getattr(FORMS[name], "laws", ()))[1:]
        if family == "law" and laws:
            lines.append(f'law = "{laws[int(random.integers(len(laws)))]}"')
        blocks.append("\n".join([*lines, f"size = {size:.6g}"]))
    return "\n\n".join(blocks) + "\n"


def wandering(random: np.random.Generator) -> Callable[[float], Goal]:
    """A plan of sines: a few metres to the sides, low passes, climbs, turns of heading."""
    ax, ay = random.uniform(1.8, 3.0, 2)
    wx, wy = random.uniform(0.8, 1.35), random.uniform(0.5, 0.9)
    low_s, bob, wb = random.uniform(24.0, 34.0), random.uniform(0.3, 0.5), random.uniform(1.3, 1.9)
    high, low = random.uniform(3.5, 5.0), random.uniform(0.6, 0.9)
    turn, wt = random.uniform(0.8, 1.6), random.uniform(0.3, 0.5)

    def plan(t: float) -> Goal:
        s = min(t / 4.0, 1.0)
        ease = s * s * (3 - 2 * s)
        half, w = 0.5 * (high - low - bob), 2 * math.pi / low_s
        z = -high + half * (1 - math.cos(w * t)) - bob * math.sin(wb * t)
        vz = half * w * math.sin(w * t) - bob * wb * math.cos(wb * t)
        x, y = ease * ax * math.sin(wx * t), ease * ay * math.sin(wy * t)
        return Goal(
            (x, y, min(z, -0.45)),
            (ease * ax * wx * math.cos(wx * t), ease * ay * wy * math.cos(wy * t), vz),
            yaw=turn * math.sin(wt * t),
        )

    return plan


def make_flight(hidden: tuple[str, ...], seed: int, worth: float, family: str, folder: Path) -> Made:
    """Fly one world; its truth file is left in `folder`.

    A vehicle that falls (too late motors, too weak a rotor) is no flight: the same world is drawn anew, and
    from the fifth time on a tenth smaller each time.
    """
    for attempt in range(ATTEMPTS):
        size = worth * SMALLER ** max(0, attempt - 3)
        made = _fly(hidden, seed, size, family, folder, attempt)
        if _flew(made.columns):
            break
    return made


def _flew(log: dict[str, Array]) -> bool:
    """Whether it never tipped over."""
    return bool(np.max(np.hypot(log["roll_rad"], log["pitch_rad"])) < FALLEN_RAD)


def _fly(hidden: tuple[str, ...], seed: int, worth: float, family: str, folder: Path, attempt: int) -> Made:
    draw = [seed, zlib.crc32("+".join((family, *hidden)).encode()), 0xF17, *([attempt] if attempt else [])]
    random = np.random.default_rng(draw)
    name = str(random.choice(AIRFRAMES, p=[0.6, 0.2, 0.2]))
    text = (EXAMPLES / name).read_text()
    if "motor_lag_s" not in text:
        text = text.replace("\n[[rotors]]", f"motor_lag_s = {LAG_S}\n\n[[rotors]]", 1)
    body = folder / f"{seed}-{zlib.crc32(repr((hidden, family)).encode()):08x}.airframe.toml"
    body.write_text(text)
    vehicle = read_vehicle(body)
    truth_text = truth_toml(hidden, worth, random, family, vehicle.rotors)
    secret = body.with_suffix(".truth")
    secret.write_text(truth_text)
    battery = BatteryPack(
        charge=float(random.uniform(0.8, 0.97)), resistance_ohm=float(random.uniform(0.018, 0.03))
    )
    pilot = Autopilot(
        Plant(vehicle, read_pair(EXAMPLES / "rotor_paper.toml"), battery), read_truth(secret), seed=seed
    )
    noise = float(random.choice([0.6, 1.0, 2.0]))
    usual = pilot.sensors.noise
    scaled = replace(
        usual,
        accel_m_s2=noise * usual.accel_m_s2,
        gyro_rad_s=noise * usual.gyro_rad_s,
        attitude_rad=noise * usual.attitude_rad,
    )
    pilot.sensors = Sensors(pilot.plant, seed, scaled)
    plan = str(random.choice(["vigorous", "wandering"], p=[0.4, 0.6]))
    if not hidden and random.random() < 0.3:
        plan = "paper"
    flights.PLANS["wandering"] = wandering(random), float(random.uniform(60.0, 90.0))
    log = flights.fly(pilot, plan)
    every = int(random.choice([1, 2, 4]))
    log = {k: v[::every].copy() for k, v in log.items()}
    if random.random() < 0.5:
        log = {k: v for k, v in log.items() if not k.startswith("rpm")}
    for fault in hidden:
        if fault not in WORTH:
            _spoil(log, fault, worth, random, vehicle.rotors)
    truth: dict[str, object] = {
        "airframe": name, "plan": plan, "noise": noise, "every": every, "worth": worth, "told": truth_text,
        "rows": len(log["time_s"]), "attempt": attempt,
    }  # fmt: skip
    return Made(log, truth, "rotor_paper.toml", text)


def _spoil(log: dict[str, Array], fault: str, worth: float, random: np.random.Generator, rotors: int) -> None:
    g, t = 9.80665, log["time_s"]
    rows = len(t)
    air = log["height_m"] > 0.5
    if fault == "swapped_motors":
        i, j = (int(k) + 1 for k in random.choice(rotors, 2, replace=False))
        for kind in ("motor", "rpm"):
            if f"{kind}{i}" in log:
                log[f"{kind}{i}"], log[f"{kind}{j}"] = log[f"{kind}{j}"], log[f"{kind}{i}"]
    elif fault == "stuck_accel":
        first = int(random.uniform(0.3, 0.6) * rows)
        axis = "xyz"[int(random.integers(3))]
        log[f"accel_{axis}_m_s2"][first : first + rows // 12] = log[f"accel_{axis}_m_s2"][first]
    elif fault == "reversed_gyro":
        axis = "xyz"[int(random.integers(3))]
        log[f"gyro_{axis}_rad_s"] = -log[f"gyro_{axis}_rad_s"]
    elif fault == "repeated_stretch":
        n, first, to = rows // 12, rows // 3, rows // 2 + rows // 10
        for name in log:
            if name.startswith(("accel", "gyro")):
                log[name][to : to + n] = log[name][first : first + n]
    elif fault == "strange_periodic":
        axis = "xyz"[int(random.integers(3))]
        log[f"accel_{axis}_m_s2"] += air * worth * g * np.sin(2 * np.pi * t / random.uniform(4.0, 9.0))
    elif fault == "strange_heading":
        log["accel_x_m_s2"] += air * worth * g * np.sin(4.0 * log["yaw_rad"] + 0.4)
    elif fault == "strange_threshold":
        motor = log[f"motor{int(random.integers(1, rotors + 1))}"]
        log["accel_y_m_s2"] += air * worth * g * (motor > np.quantile(motor[air], 0.6))
    elif fault == "strange_band":
        h = log["height_m"]
        log["accel_x_m_s2"] += air * worth * g * np.exp(-(((h - 2.2) / 0.35) ** 2))
