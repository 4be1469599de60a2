"""Rotor drag: a rotor moving in its own plane is dragged back, nearly in proportion to the air speed.

Source: blade flapping and induced drag (Mahony, Kumar and Corke 2012; Faessler, Franchi and Scaramuzza
2018): F_i = -k w_i V_i in the rotor's plane, V_i the hub's own velocity (turning adds to it, which damps
yaw). What the drag grows with, w_i, is its form: the rotor's speed, its thrust, or its thrust times the air
speed; and it may level off with speed, V / sqrt(1 + (V / V_s)^2), as measured drag does (Kai, Allibert, Hua
and Hamel 2017).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.parameter import per
from coaxlink.effects.tracing import Array, NotShown, Tracing
from coaxlink.frames import FlightFrame

BY_SPEED, BY_THRUST = "drag_per_speed_N_s_m", "drag_per_thrust_s_m"
BY_SQUARE, BY_ROOT = "drag_per_thrust_s2_m2", "drag_per_root_thrust"
BY_FLAPPING = "drag_per_thrust_and_speed_s_m"
UNITS = {BY_SPEED: "N s/m", BY_THRUST: "s/m", BY_SQUARE: "s2/m2", BY_ROOT: "N^0.5 s/m", BY_FLAPPING: "s/m"}
SATURATIONS_M_S = (2.0, 3.0, 4.5, 7.0, 12.0)


def _missing(frame: FlightFrame) -> str | None:
    fast = float(np.quantile(np.hypot(*frame.velocity[frame.keep, :2].T), 0.95))
    return None if fast > 0.3 else f"never faster than {fast:.2f} m/s in the rotors' plane"


def hub_drag(frame: FlightFrame, velocity: Array, form: Numbers, turning: bool = True) -> Array:
    """(rows, 6) drag of unit coefficient for the body's velocity (rows, 3) through the air.

    `form` has the name of what it grows with, and may have the speed at which it levels off.
    """
    out = np.zeros((len(velocity), 6))
    for i, rotor in enumerate(frame.airframe.rotors):
        position, axis = np.array(rotor.position_m), np.array(rotor.axis)
        hub = velocity
        if turning:
            hub = hub + frame.rates @ _cross(position)  # w x r = -C w
        hub = hub - np.outer(hub @ axis, axis)
        force = -_weight(frame, i, hub, form)[:, None] * hub
        out[:, :3] += force
        out[:, 3:] += force @ _cross(position).T
    return out


def _cross(position: Array) -> Array:
    """(3, 3) matrix C of a place with C f = place x f."""
    x, y, z = position
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _weight(frame: FlightFrame, rotor: int, hub: Array, form: Numbers) -> Array:
    """(rows,) what one rotor's drag grows with, its hub moving in its plane at (rows, 3)."""
    speed, thrust = frame.speeds[:, rotor], np.clip(frame.thrust[:, rotor], 0.0, None)
    weight = speed if BY_SPEED in form else thrust
    if BY_ROOT in form:  # the air that the disc throws down carries the momentum (Mahony et al. 2012)
        weight = np.sqrt(thrust)
    elif BY_FLAPPING in form:  # the disc tilts back by V / (Omega R), and its thrust with it
        weight = thrust / np.maximum(speed, 0.1)
    if BY_SQUARE in form or "saturation_m_s" in form:
        square = np.einsum("ri,ri->r", hub, hub)
        if BY_SQUARE in form:
            return np.asarray(weight * np.sqrt(square))
        weight = weight / np.sqrt(1.0 + square / form["saturation_m_s"] ** 2)
    return np.asarray(weight)


def drag_cause(frame: FlightFrame, _: Numbers, channel: str) -> tuple[str, Array]:
    """The velocity, or for yaw the rate, that the drag of a channel follows."""
    if channel == "torque_z":
        return "yaw_rate_rad_s", frame.rates[:, 2]
    axis = "y" if channel in ("force_y", "torque_x") else "x"
    return f"vel_{axis}_body_m_s", frame.velocity[:, "xy".index(axis)]


def _starts(frame: FlightFrame) -> Sequence[Numbers]:
    if why := _missing(frame):
        raise NotShown(why)
    level = [{form: 1.0, "saturation_m_s": v} for form in (BY_SPEED, BY_THRUST) for v in SATURATIONS_M_S]
    forms: list[Numbers] = [*({form: 1.0} for form in UNITS), *level]
    return [{**form, "moment_share": 1.0} for form in forms]


def _adds(frame: FlightFrame, p: Numbers) -> Array:
    # the moment comes apart from the force: drag may act away from the hubs' planes
    drag = p[_form(p)] * hub_drag(frame, frame.velocity, p)
    drag[:, 3:] *= p["moment_share"]
    return drag


def _form(p: Numbers) -> str:
    return next(form for form in UNITS if form in p)


def _further(frame: FlightFrame, p: Numbers) -> Sequence[Numbers]:
    """Other forms of the same size that level off alike, or from one that does not, one that may."""
    usual = {form: _usual(frame, {form: 1.0}) for form in UNITS if form != BY_SQUARE}
    mine = _form(p)
    if mine not in usual:
        return []
    size, rest = p[mine] * usual[mine], {name: value for name, value in p.items() if name != mine}
    others = [{form: size / each, **rest} for form, each in usual.items() if form != mine]
    return others if "saturation_m_s" in p else [*others, {**p, "saturation_m_s": 12.0}]


def _usual(frame: FlightFrame, form: Numbers) -> float:
    """What the drag of the middle one of the rotors grows with."""
    still = np.zeros((len(frame.time_s), 3))
    rotors = range(len(frame.airframe.rotors))
    weights = np.stack([_weight(frame, i, still, form) for i in rotors], axis=1)[frame.keep]
    return max(float(np.median(weights)), 1e-9)


FLIGHT: Tracing[FlightFrame] = Tracing(
    needs=("vel_n_m_s", "vel_e_m_s", "vel_d_m_s"),
    channels=("force_x", "force_y", "torque_x", "torque_y", "torque_z"),
    starts=_starts,
    further=_further,
    adds=_adds,
    cause=drag_cause,
)


_IN_PLANE = "a force in the rotors' plane, which no rotor speed can take back; feed-forward can"
EFFECT = PhysicalEffect(
    name="rotor_drag",
    stage=Stage.AIR,
    place=2,
    physics="drag of the rotors in their plane, growing with the hub's velocity",
    source="Mahony, Kumar and Corke 2012; Faessler, Franchi and Scaramuzza 2018",
    parameters=(
        *(
            Parameter(name, unit, 0.0, 50.0, amount=True, nil=0.0,
                source="wide: any value between the bounds; drag of a rotor goes with its size; no sign "
                       "but this one is physical (Mahony, Kumar and Corke 2012)")
            for name, unit in UNITS.items()
        ),
        Parameter("saturation_m_s", "m/s", 0.5, 60.0, moves=True,
            source="wide: any value between the bounds; drag levels off with speed (Kai, Allibert, Hua "
                   "and Hamel 2017), where goes with the rotor"),
        Parameter("moment_share", "1", -100.0, 100.0, (1.0, 0.5), amount=per(*UNITS),
            source="1 where the drag acts at the hubs; 0.5 is assumed for the body's own"),
    ),
    flight=FLIGHT,
    no_static=_IN_PLANE,
    no_live=_IN_PLANE,
)  # fmt: skip
