"""Rotor drag: a rotor moving in its own plane is dragged back, nearly in proportion to the air speed.

Source: blade flapping and induced drag (Mahony, Kumar and Corke 2012; Faessler, Franchi and Scaramuzza
2018): F_i = -k w_i V_i in the rotor's plane, V_i the hub's own velocity (turning adds to it, which damps
yaw). What the drag grows with, w_i, is its form: the rotor's speed, its thrust, or its thrust times the air
speed; and it may level off with speed, V / sqrt(1 + (V / V_s)^2), as measured drag does (Kai, Allibert, Hua
and Hamel 2017).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from coaxlink.effects.base import Parameter, PhysicalEffect, Stage
from coaxlink.effects.tracing import Array, Shape, Tracing, outside
from coaxlink.frames import FlightFrame

_FORMS = {
    "by_speed": "drag_per_speed_N_s_m",
    "by_thrust": "drag_per_thrust_s_m",
    "by_square": "drag_per_thrust_s2_m2",
    "by_root": "drag_per_root_thrust",
    "by_flapping": "drag_per_thrust_and_speed_s_m",
}

SATURATIONS_M_S = (2.0, 3.0, 4.5, 7.0, 12.0)


def _missing(frame: FlightFrame) -> str | None:
    fast = float(np.quantile(np.hypot(*frame.velocity[frame.keep, :2].T), 0.95))
    return None if fast > 0.3 else f"never faster than {fast:.2f} m/s in the rotors' plane"


def hub_drag(frame: FlightFrame, velocity: Array, shape: Shape, turning: bool = True) -> Array:
    """(rows, 6) drag of unit coefficient for the body's velocity (rows, 3) through the air."""
    out = np.zeros((len(velocity), 6))
    for i, rotor in enumerate(frame.airframe.rotors):
        position, axis = np.array(rotor.position_m), np.array(rotor.axis)
        hub = velocity
        if turning:
            hub = hub + frame.rates @ _cross(position)  # w x r = -C w
        hub = hub - np.outer(hub @ axis, axis)
        force = -_weight(frame, i, hub, shape)[:, None] * hub
        out[:, :3] += force
        out[:, 3:] += force @ _cross(position).T
    return out


def _cross(position: Array) -> Array:
    """(3, 3) matrix C of a place with C f = place x f."""
    x, y, z = position
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _weight(frame: FlightFrame, rotor: int, hub: Array, shape: Shape) -> Array:
    """(rows,) what one rotor's drag grows with, its hub moving in its plane at (rows, 3)."""
    speed, thrust = frame.speeds[:, rotor], np.clip(frame.thrust[:, rotor], 0.0, None)
    weight = speed if "by_speed" in shape else thrust
    if "by_root" in shape:  # the air that the disc throws down carries the momentum (Mahony et al. 2012)
        weight = np.sqrt(thrust)
    elif "by_flapping" in shape:  # the disc tilts back by V / (Omega R), and its thrust with it
        weight = thrust / np.maximum(speed, 0.1)
    if "by_square" in shape or "saturation_m_s" in shape:
        square = np.einsum("ri,ri->r", hub, hub)
        if "by_square" in shape:
            return np.asarray(weight * np.sqrt(square))
        weight = weight / np.sqrt(1.0 + square / shape["saturation_m_s"] ** 2)
    return np.asarray(weight)


def drag_cause(frame: FlightFrame, _: Shape, channel: str) -> tuple[str, Array]:
    """The velocity, or for yaw the rate, that the drag of a channel follows."""
    if channel == "torque_z":
        return "yaw_rate_rad_s", frame.rates[:, 2]
    axis = "y" if channel in ("force_y", "torque_x") else "x"
    return f"vel_{axis}_body_m_s", frame.velocity[:, "xy".index(axis)]


def _columns(frame: FlightFrame, shape: Shape) -> Array:
    # the moment comes apart from the force: drag may act away from the hubs' planes
    drag = hub_drag(frame, frame.velocity, shape)
    force, moment = drag.copy(), drag.copy()
    force[:, 3:], moment[:, :3] = 0.0, 0.0
    return np.stack([force, moment], axis=-1)


def _shapes(_: FlightFrame) -> Sequence[Shape]:
    level = [{form: 1.0, "saturation_m_s": v} for form in ("by_speed", "by_thrust") for v in SATURATIONS_M_S]
    return [*({form: 1.0} for form in _FORMS), *level]


def _variants(frame: FlightFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    """Other forms of the same size, and from a drag that does not level off to one that may, at any speed."""
    usual = {form: _usual(frame, {form: 1.0}) for form in _FORMS if form != "by_square"}
    mine = next(iter(shape))
    out: list[tuple[Shape, Array]] = []
    if mine in usual and "saturation_m_s" not in shape:
        out = [({form: 1.0}, c * usual[mine] / size) for form, size in usual.items() if form != mine]
        out.append(({**shape, "saturation_m_s": 12.0}, c))
    return out


def _usual(frame: FlightFrame, shape: Shape) -> float:
    """What the drag of the middle one of the rotors grows with."""
    still = np.zeros((len(frame.time_s), 3))
    rotors = range(len(frame.airframe.rotors))
    weights = np.stack([_weight(frame, i, still, shape) for i in rotors], axis=1)[frame.keep]
    return max(float(np.median(weights)), 1e-9)


def _parameters(_: FlightFrame, shape: Shape, c: Array) -> dict[str, float]:
    extra = {k: v for k, v in shape.items() if k == "saturation_m_s"}
    share = float(c[1] / c[0]) if abs(c[0]) > 1e-12 else 0.0
    return {_FORMS[next(iter(shape))]: float(c[0]), "moment_share": share, **extra}


def _inverse(_: FlightFrame, p: Mapping[str, float]) -> tuple[Shape, Array]:
    for form, name in _FORMS.items():
        if name in p:
            extra = {k: v for k, v in p.items() if k == "saturation_m_s"}
            return {form: 1.0, **extra}, np.array([p[name], p[name] * p["moment_share"]])
    raise KeyError(f"rotor_drag knows {', '.join(_FORMS.values())}")


def _refuse(p: Mapping[str, float]) -> str | None:
    name, value = next(iter(p.items()))
    return outside(name, value, 0.0, 50.0)


FLIGHT: Tracing[FlightFrame] = Tracing(
    name="rotor_drag",
    physics="drag of the rotors in their plane, growing with the hub's velocity",
    source="Mahony, Kumar and Corke 2012; Faessler, Franchi and Scaramuzza 2018",
    needs=("vel_n_m_s", "vel_e_m_s", "vel_d_m_s"),
    channels=("force_x", "force_y", "torque_x", "torque_y", "torque_z"),
    units={
        "drag_per_speed_N_s_m": "N s/m",
        "drag_per_thrust_s_m": "s/m",
        "drag_per_thrust_s2_m2": "s2/m2",
        "drag_per_root_thrust": "N^0.5 s/m",
        "drag_per_thrust_and_speed_s_m": "s/m",
        "saturation_m_s": "m/s",
        "moment_share": "1",
    },
    missing=_missing,
    shapes=_shapes,
    columns=_columns,
    parameters=_parameters,
    inverse=_inverse,
    refuse=_refuse,
    cause=drag_cause,
    nil=lambda _: dict.fromkeys(_FORMS.values(), 0.0),
    stage=5,
    free=lambda _, shape: {"saturation_m_s": (0.5, 60.0)} if "saturation_m_s" in shape else {},
    variants=_variants,
)


_IN_PLANE = "a force in the rotors' plane, which no rotor speed can take back; feed-forward can"
EFFECT = PhysicalEffect(
    name="rotor_drag",
    stage=Stage.AIR,
    parameters=(
        *(
            Parameter(name, FLIGHT.units[name], 0.0, 50.0,
                source="wide: any value between the bounds; drag of a rotor goes with its size; no sign "
                       "but this one is physical (Mahony, Kumar and Corke 2012)")
            for name in _FORMS.values()
        ),
        Parameter("saturation_m_s", "m/s", 0.5, 60.0,
            source="wide: any value between the bounds; drag levels off with speed (Kai, Allibert, Hua "
                   "and Hamel 2017), where goes with the rotor"),
        Parameter("moment_share", "1", -100.0, 100.0, (1.0, 0.5),
            source="1 where the drag acts at the hubs; 0.5 is assumed for the body's own"),
    ),
    flight=FLIGHT,
    no_static=_IN_PLANE,
    no_live=_IN_PLANE,
)  # fmt: skip
