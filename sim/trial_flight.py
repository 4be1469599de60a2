"""Fly a trial under one mixer table and judge it by the plant's truth.

It starts in hover, tuned as its owner would tune the table that flies (`px4/tuning.py`: the same loop
bandwidths at the airframe's own mass; the vertical gains alike), settles, and is judged from then on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.errors import WorldError
from sim.physics.plant import Plant
from sim.physics.rotors import read_pair
from sim.px4.autopilot import RATE_HZ, Autopilot, Mode
from sim.px4.cascade import Four, Goal, euler
from sim.px4.tuning import Mixing, tune
from sim.trials import Draw, Trial
from sim.truth import Truth
from sim.vehicle import LOWER, read_vehicle

SETTLE_S = 8.0
INTEGRALS = ("MPC_XY_VEL_I_ACC", "MPC_Z_VEL_I_ACC", "MC_ROLLRATE_I", "MC_PITCHRATE_I", "MC_YAWRATE_I")
VERTICAL = ("MPC_Z_VEL_P_ACC", "MPC_Z_VEL_I_ACC", "MPC_Z_VEL_D_ACC")
SHAPE_EVERY = 5  # steps of the autopilot a row of what was demanded and what came
PWM_STEP = 1e-3


@dataclass(frozen=True)
class Outcome:
    """One flight, from the end of settling on."""

    height_max_m: float  # largest |wanted - flown|
    height_rms_m: float
    sunk_m: float  # deepest below the lowest height that was asked for
    level_rms_m: float  # horizontal
    tilt_rms_deg: float  # body z from where the loops wanted it
    yaw_rms_deg: float
    yaw_max_deg: float
    saturated: float  # share of time with a motor at 0 or 1
    shaft_W: float  # mean
    pack_W: float  # mean, electrical, by the plant's drive
    shape: NDArray[np.float64] = field(compare=False)  # (4,) see `shape_error`


SCALARS = tuple(f.name for f in fields(Outcome) if f.name != "shape")


def fly_trial(
    trial: Trial,
    airframe: Path,
    mixer: Mapping[str, float] | Mixing,
    seed: int = 0,
    rotor: Path | None = None,
) -> Outcome:
    """Fly a table (PX4's parameters by name, on top of its defaults) or any mixing. Raises WorldError."""
    vehicle = read_vehicle(airframe)
    rotor = rotor or vehicle.rotor_file
    if rotor is None:
        raise WorldError(airframe, "rotor_model", "a rotor file is expected")
    draw, plant = Draw.of(seed, vehicle.rotors), Plant(vehicle, read_pair(rotor))
    a = Autopilot(plant, Truth(trial.effects(draw, SETTLE_S), gust_seed=seed), seed=seed)
    if isinstance(mixer, Mapping):
        a.store.recall(mixer)
    else:
        a.mixer = mixer
    _tune(a, trial)
    _into_the_air(a, trial.goal(-SETTLE_S, draw), trial.charge)
    rows: list[tuple[float, ...]] = []
    demands: list[tuple[float, ...]] = []
    commands: list[NDArray[np.float64]] = []
    for n in range(round((SETTLE_S + trial.seconds) * RATE_HZ)):
        goal = trial.goal(n / RATE_HZ - SETTLE_S, draw)
        a.offboard(goal)
        if n == 0:
            a.set_mode(Mode.OFFBOARD)
        a.step()
        if n >= SETTLE_S * RATE_HZ:
            rows.append(_row(a, goal))
            if n % SHAPE_EVERY == 0:
                d = a.demand
                demands.append((d.thrust, d.roll, d.pitch, d.yaw))
                commands.append(a.command)
    return _judge(np.array(rows), shape_error(np.array(demands), steady(plant, np.array(commands))))


def _tune(a: Autopilot, trial: Trial) -> None:
    """The owner's settings for this table, at the airframe's own mass."""
    settings = tuned_settings(a, lift=trial.lift_tuned)
    a.store.recall(settings | {"MPC_USE_HTE": float(trial.hover_estimate)})
    a.store.recall({name: float(a.store[name]) * trial.integrals for name in INTEGRALS})
    a.cascade.hover = settings["MPC_THR_HOVER"]


def tuned_settings(a: Autopilot, *, lift: bool = True) -> dict[str, float]:
    """Hover thrust and rate gains for the mixer on board; with `lift` vertical gains over its slope, too."""
    tuned = tune(a.mixer, a.plant)
    settings = {"MPC_THR_HOVER": tuned.hover}
    for axis, gains in zip(("ROLL", "PITCH", "YAW"), tuned.gains, strict=True):
        settings |= {f"MC_{axis}RATE_{k}": gain for k, gain in zip("PID", gains, strict=True)}
    if lift:
        slope = lift_exponent(a, tuned.hover)
        settings |= {name: float(a.store[name]) / slope for name in VERTICAL}
    return settings


def lift_exponent(a: Autopilot, hover: float) -> float:
    """d(log thrust) / d(log demand) in hover: what multiplies a vertical gain; the loops count on 1."""
    high, low = (a.mixer.command(0.0, 0.0, 0.0, (1.0 + s) * hover) for s in (0.02, -0.02))
    lifted = steady(a.plant, np.array([high, low]))[:, 0]
    return float(np.log(lifted[0] / lifted[1]) / np.log(1.02 / 0.98))


def _into_the_air(a: Autopilot, goal: Goal, charge: float) -> None:
    """Armed, at the goal, with its rotors at hover speed."""
    k, n = a.plant.index, a.rotors
    a.plant.state[k.POS : k.POS + 3] = goal.position
    speeds = a.mixer.command(0.0, 0.0, 0.0, a.cascade.hover)
    a.plant.state[k.SPEED : k.SPEED + 2 * n] = [*speeds, *speeds]
    a.plant.swap_battery(charge)
    a.armed, a.landed = True, False


def _row(a: Autopilot, goal: Goal) -> tuple[float, ...]:
    p = a.plant
    n, e, down = p.position.tolist()
    w, x, y, z = p.quaternion.tolist()
    aim, body = _down(a.demand.attitude), _down((w, x, y, z))
    tilt = math.acos(min(sum(i * j for i, j in zip(aim, body, strict=True)), 1.0))
    yaw = math.remainder(goal.yaw - euler((w, x, y, z))[2], 2 * math.pi)
    bound = bool((a.command >= 1.0 - 0.5 * PWM_STEP).any() or (a.command <= 0.5 * PWM_STEP).any())
    shaft = float(p.torque @ p.speeds) * p.pair.speed_max_rpm * math.pi / 30.0
    level = math.hypot(goal.position[0] - n, goal.position[1] - e)
    degrees = (math.degrees(tilt), math.degrees(yaw))
    return (down, goal.position[2], level, *degrees, float(bound), shaft, p.current * p.voltage)


def _down(q: Four) -> tuple[float, float, float]:
    """Body z in NED."""
    w, x, y, z = q
    return 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)


def _judge(rows: NDArray[np.float64], shape: NDArray[np.float64]) -> Outcome:
    down, wanted, level, tilt, yaw, bound, shaft, pack = rows.T

    def rms(x: NDArray[np.float64]) -> float:
        return float(np.sqrt(np.mean(x * x)))

    off = down - wanted
    return Outcome(
        height_max_m=float(np.abs(off).max()),
        height_rms_m=rms(off),
        sunk_m=float(max(down.max() - wanted.max(), 0.0)),
        level_rms_m=rms(level),
        tilt_rms_deg=rms(tilt),
        yaw_rms_deg=rms(yaw),
        yaw_max_deg=float(np.abs(yaw).max()),
        saturated=float(bound.mean()),
        shaft_W=float(shaft.mean()),
        pack_W=float(pack.mean()),
        shape=shape,
    )


def shape_error(demands: NDArray[np.float64], delivered: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4,) rms of delivered (rows, 4; thrust N, moments N m) less the best constant gain times the demand.

    What an integrator cannot take off: the best gain of each axis is that of least squares.
    """
    square = (demands * demands).sum(axis=0)
    gain = (demands * delivered).sum(axis=0) / np.where(square > 0.0, square, 1.0)
    return np.asarray(np.sqrt(np.mean((delivered - gain * demands) ** 2, axis=0)))


def steady(plant: Plant, speeds: NDArray[np.float64]) -> NDArray[np.float64]:
    """(rows, 4) thrust up, roll, pitch, yaw of steady normalised speeds (rows, N) on sound rotors."""
    v = plant.vehicle
    thrust, torque = np.zeros(speeds.shape), np.zeros(speeds.shape)
    for i in range(v.rotors):
        other = speeds[:, v.partner[i]] if v.partner[i] >= 0 else np.zeros(len(speeds))
        lower = v.level[i] == LOWER
        loads = plant.pair.loads(other if lower else speeds[:, i], speeds[:, i] if lower else other)
        thrust[:, i], torque[:, i] = loads[2:] if lower else loads[:2]
    moment = thrust @ np.cross(v.position_m, v.axis) - (torque * v.spin) @ v.axis
    return np.column_stack([-(thrust @ v.axis)[:, 2], moment])
