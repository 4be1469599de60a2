"""ESCs count turns of the field: a rotor's speed is theirs over its pairs of magnets. With a wrong number
it is off by a ratio of whole pairs; a parameter of the autopilot says which number was taken. It is held
against commands and weight before any speed is believed.

    x1 = ln(rpm / (command * full speed) / f) / DRIVE
    x2 = ln(thrust(rpm / f) / (mass * specific force)) / THRUST,    f = magnets / magnets counted

Both are standard normal where f is right. f = 1 is refused where another even number of magnets lies within
the 95 % level of two degrees of freedom and is the likelier one, prior odds and all.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.data import Samples
from coaxlink.frames import Array
from coaxlink.premises.answer import OtherVehicle
from coaxlink.rotor.model import RotorModel

POLES = ("SERVO_BLH_POLES", "SERVO_FTW_POLES", "MOT_POLE_COUNT")  # ArduPilot's two, PX4's
USUAL = 14  # what every firmware begins with
MAGNETS = range(4, 58, 2)  # of motors that carry propellers
DRIVE, THRUST = 0.10, 0.15  # sd of full speed and of a model's thrust, as `rotor_update` has them
CHI2_95 = 5.99  # two degrees of freedom
MISCOUNTED = 0.1  # prior odds that the number was left at its default; judgement
FLIES = 0.4  # of the weight: less is on the ground
LEAST_ROWS = 10  # with a speed: ten seconds of ESCs that report once a second


def counted(parameters: Mapping[str, float]) -> tuple[str, float]:
    """The parameter ("" where none is known), and how many magnets it says."""
    return next(((n, parameters[n]) for n in POLES if parameters.get(n, 0) > 0), ("", float(USUAL)))


def to_set(parameters: Mapping[str, float], magnets: int) -> str:
    """What to change so that `magnets` are counted."""
    name, _ = counted(parameters)
    if not name and parameters:
        name = POLES[0] if "SERVO1_FUNCTION" in parameters else POLES[2]
    return f"set {name or ' or '.join(POLES)} (or the ESC's own) to {magnets}"


def miscounted(log: Samples, airframe: Airframe, model: RotorModel) -> OtherVehicle | None:
    """Another number of magnets that explains the rpm of all rotors, with the parameter to set."""
    given = np.stack([log[f"motor{r.number}"] for r in airframe.rotors], axis=1)
    commands = airframe.turned(model, given, supply_of(log))
    speeds = np.stack([log[f"rpm{r.number}"] for r in airframe.rotors], axis=1) / model.speed_max_rpm
    force = -airframe.mass_kg * log["accel_z_m_s2"]
    with np.errstate(invalid="ignore"):
        rows = ((commands > 0.1) & (commands <= 1.0) & (speeds > 0.1)).all(axis=1) & (force > 0)
        rows[rows] &= _lift(airframe, model, commands[rows]) > FLIES * force[rows]
    if rows.sum() < LEAST_ROWS:
        return None
    commands, speeds, weight = commands[rows], speeds[rows], float(np.median(force[rows]))
    driven = float(np.median(speeds / commands))

    def misfit(factor: float) -> float:
        lift = float(np.median(_lift(airframe, model, speeds / factor)))
        return (np.log(driven / factor) / DRIVE) ** 2 + (np.log(max(lift, 1e-9) / weight) / THRUST) ** 2

    _, taken = counted(log.parameters)
    right = min(MAGNETS, key=lambda magnets: misfit(magnets / taken))
    least = misfit(right / taken)
    if least > CHI2_95 or misfit(1.0) - least < -2.0 * np.log(MISCOUNTED):
        return None
    lift = 100 * float(np.median(_lift(airframe, model, speeds))) / weight
    why = (
        f"rpm are {driven:.2f} times what the commands allow, and would carry {lift:.0f} % of the weight: "
        f"{right} magnets counted as {taken:g}? {to_set(log.parameters, right)}; where {taken:g} is right, "
        "the airframe's mass or the rotor file's speed_max_rpm is not"
    )
    near = float(np.exp(np.sqrt(CHI2_95) * DRIVE))
    return OtherVehicle("speeds", driven, (1.0 / near, near), why)


def supply_of(log: Samples) -> Array | None:
    """(rows,) V that the ESCs had, None where no log says."""
    return log["voltage_V"] if log.has("voltage_V") else None


def _lift(airframe: Airframe, model: RotorModel, speeds: Array) -> Array:
    """(rows,) N."""
    return np.asarray(-airframe.body_loads(*airframe.loads(model, speeds))[:, 2])
