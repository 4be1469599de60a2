"""Hidden flights: the stand-in autopilot of `sim` in a world with a truth file, drawn from the seed.

Airframe, plan, sensor noise, rate and columns of the log vary. Laws are taken from those that `sim` knows
beside its first one, where it knows any. Faults and strange things are put into the finished log, for they
are of the log. Knows nothing of `coaxlink`.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim import flights
from sim.physics.plant import BatteryPack, Plant
from sim.physics.rotors import read_pair
from sim.physics.sensors import Sensors
from sim.px4.autopilot import Autopilot
from sim.px4.cascade import Goal
from sim.truth import FORMS, read_truth
from sim.vehicle import read_vehicle

Array = NDArray[np.float64]
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
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
DOUBLES = (
    ("rotor_drag", "degraded_rotor"),
    ("cg_offset", "axial_inflow"),
    ("battery_voltage", "ground_effect"),
    ("degraded_rotor", "rotor_lag"),
    ("rotor_drag", "ground_effect"),
    ("battery_voltage", "cg_offset"),
    ("axial_inflow", "rotor_drag"),
    ("mass_change", "cg_offset"),
)
FAULTS = ("swapped_motors", "stuck_accel", "reversed_gyro", "repeated_stretch")
STRANGE = ("strange_periodic", "strange_heading", "strange_threshold", "strange_band")


@dataclass(frozen=True)
class Made:
    """A flown world: the log's columns, the airframe text a guest gets, and what is true."""

    columns: dict[str, Array]
    airframe: str
    truth: dict[str, object]


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


def make(hidden: tuple[str, ...], seed: int, worth: float, family: str, folder: Path) -> Made:
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
    return Made(log, body.name, truth)


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
