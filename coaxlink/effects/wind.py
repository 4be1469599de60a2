"""Wind: the air moves, and with it the velocity that drags the rotors: F_xy = -k sum(u_i) (v - w)_xy.

Source: rotor drag (see `rotor_drag`) on the air speed; constant wind in the world frame, seen by the body
through its attitude; the body's own drag, (d |v - w| + e) (v - w), acts besides. Needs turns of heading or
speed to separate it from a sensor bias. Where `rotor_drag` stands beside it, that is the rotors' drag in
still air, and here is what the wind adds. It is found linear in the wind, then fitted as written; near
the ground it may blow less: w = w_m (h / h_m)^p, h_m the flight's middle height (the wind's power law).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from coaxlink.effects.base import Parameter, PhysicalEffect, Stage
from coaxlink.effects.rotor_drag import drag_cause, hub_drag
from coaxlink.effects.tracing import Array, Shape, Tracing, outside
from coaxlink.frames import FlightFrame

_BY_SPEED: Shape = {"by_speed": 1.0}
LOWEST_M = 0.2
LIMITS = {"north": (-30.0, 30.0), "east": (-30.0, 30.0), "shear": (0.0, 0.6)}


def _missing(frame: FlightFrame) -> str | None:
    turned = float(np.ptp(frame.attitude[frame.keep, 2]))
    return (
        None
        if turned > 0.5
        else f"heading turns by only {np.degrees(turned):.0f} deg: wind looks like a bias"
    )


def _columns(frame: FlightFrame, shape: Shape) -> Array:
    if "north" in shape:
        return _exact(frame, shape)
    own = hub_drag(frame, frame.velocity, _BY_SPEED)
    force, moment = own.copy(), own.copy()
    force[:, 3:], moment[:, :3] = 0.0, 0.0
    north, east = (hub_drag(frame, -way, _BY_SPEED, turning=False) for way in (frame.north, frame.east))
    north[:, 3:], east[:, 3:] = 0.0, 0.0
    return np.stack([force, north, east, moment], axis=-1)


def _exact(frame: FlightFrame, shape: Shape) -> Array:
    """Drag of rotors, of their moments, and of the body, at one wind."""
    blows = _profile(frame, shape)[:, None]
    air = frame.velocity - blows * (shape["north"] * frame.north + shape["east"] * frame.east)
    force, moment = (hub_drag(frame, v, _BY_SPEED) for v in (air, frame.velocity))
    force[:, 3:], moment[:, :3] = 0.0, 0.0
    body = np.zeros_like(force)
    body[:, :3] = -np.linalg.norm(air, axis=1, keepdims=True) * air
    columns = [force, moment, body]
    if "beside_drag" in shape:  # what the rotors' drag is more than in still air
        still = hub_drag(frame, frame.velocity, _BY_SPEED)
        still[:, 3:] = 0.0
        columns = [force - still, body]
    if "linear" in shape:
        linear = np.zeros_like(force)
        linear[:, :3] = -air
        columns.append(linear)
    return np.stack(columns, axis=-1)


def _profile(frame: FlightFrame, shape: Shape) -> Array:
    """(rows,) share of the wind that blows at every height."""
    if "shear" not in shape or frame.height is None:
        return np.ones(len(frame.time_s))
    height = np.maximum(frame.height, LOWEST_M)
    return np.asarray((height / float(np.median(height[frame.keep]))) ** shape["shear"])


def _names(shape: Shape) -> tuple[str, ...]:
    """Of the coefficients at one wind."""
    moment = () if "beside_drag" in shape else ("moment_N_s_m",)
    linear = ("body_drag_kg_s",) if "linear" in shape else ()
    return ("drag_per_speed_N_s_m", *moment, "body_drag_kg_m", *linear)


def _parameters(_: FlightFrame, shape: Shape, c: Array) -> dict[str, float]:
    if "north" in shape:
        named = dict(zip(_names(shape), map(float, c), strict=True))
        return {
            "drag_per_speed_N_s_m": named.pop("drag_per_speed_N_s_m"),
            "wind_north_m_s": shape["north"],
            "wind_east_m_s": shape["east"],
            **named,
            **({"shear_power": shape["shear"]} if "shear" in shape else {}),
            **({"beside_drag": 1.0} if "beside_drag" in shape else {}),
        }
    k = c[0] if abs(c[0]) > 1e-9 else 1e-9
    return {
        "drag_per_speed_N_s_m": float(c[0]),
        "wind_north_m_s": float(c[1] / k),
        "wind_east_m_s": float(c[2] / k),
        "moment_share": float(c[3] / k),
    }


def _inverse(_: FlightFrame, p: Mapping[str, float]) -> tuple[Shape, Array]:
    k = p["drag_per_speed_N_s_m"]
    if "body_drag_kg_m" in p:
        shape = {"north": p["wind_north_m_s"], "east": p["wind_east_m_s"]}
        if "shear_power" in p:
            shape["shear"] = p["shear_power"]
        shape |= {"linear": 1.0} if "body_drag_kg_s" in p else {}
        shape |= {"beside_drag": 1.0} if "beside_drag" in p else {}
        return shape, np.array([p[name] for name in _names(shape)])
    return {}, np.array([k, k * p["wind_north_m_s"], k * p["wind_east_m_s"], k * p["moment_share"]])


def apart(p: Mapping[str, float]) -> tuple[dict[str, float], dict[str, float]]:
    """The wind's parameters with the rotors' drag in still air as an effect of its own, and those of that."""
    k = p["drag_per_speed_N_s_m"]
    wind = {n: v for n, v in p.items() if n != "moment_N_s_m"} | {"beside_drag": 1.0}
    return wind, {"drag_per_speed_N_s_m": k, "moment_share": p["moment_N_s_m"] / k}


def _refuse(p: Mapping[str, float]) -> str | None:
    least = -0.3 if "body_drag_kg_m" in p else 0.0  # beside the body's drag the rotors' may be nothing
    return outside("drag_per_speed_N_s_m", p["drag_per_speed_N_s_m"], least, 50.0, "N s/m") or outside(
        "wind", float(np.hypot(p["wind_north_m_s"], p["wind_east_m_s"])), 0.2, 30.0, "m/s"
    )


def _variants(frame: FlightFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    if "north" in shape:  # what else may be: drag of the body in proportion, less wind near the ground
        richer: list[tuple[Shape, Array]] = []
        if "linear" not in shape:
            richer.append(({**shape, "linear": 1.0}, np.append(c, 0.0)))
        if "shear" not in shape and frame.height is not None:
            richer.append(({**shape, "shear": 0.1}, c))
        return richer
    k = c[0] if abs(c[0]) > 1e-9 else 1e-9
    wind = np.array([c[1], c[2]]) / k
    speed = float(np.hypot(*wind))
    wind = wind * min(1.0, 12.0 / max(speed, 1e-9))
    # all the push from the rotors, or all from the body
    return [
        ({"north": float(s * wind[0]), "east": float(s * wind[1])}, np.array([a * k, c[3], b]))
        for s, a, b in ((1.0, 1.0, 0.0), (1.0, 0.0, 0.1), (0.5, 0.5, 0.1))
    ]


FLIGHT: Tracing[FlightFrame] = Tracing(
    name="wind",
    physics="drag of the rotors on the air speed, the air itself moving",
    source="rotor drag on v - w (Mahony, Kumar and Corke 2012)",
    needs=("vel_n_m_s", "vel_e_m_s", "vel_d_m_s", "yaw_rad"),
    channels=("force_x", "force_y", "torque_x", "torque_y", "torque_z"),
    units={
        "drag_per_speed_N_s_m": "N s/m",
        "wind_north_m_s": "m/s",
        "wind_east_m_s": "m/s",
        "moment_share": "1",
        "moment_N_s_m": "N s/m",
        "body_drag_kg_m": "kg/m",
        "body_drag_kg_s": "kg/s",
        "shear_power": "1",
        "beside_drag": "1",
    },
    missing=_missing,
    shapes=lambda _: [{}],
    columns=_columns,
    parameters=_parameters,
    inverse=_inverse,
    refuse=_refuse,
    cause=drag_cause,
    nil=lambda _: {"wind_north_m_s": 0.0, "wind_east_m_s": 0.0},
    stage=5,
    free=lambda _, shape: {k: LIMITS[k] for k in shape if k in LIMITS},
    variants=_variants,
)


_NO_PROPERTY = "a force of the air on the body, no property of the vehicle; the position loop carries it"
EFFECT = PhysicalEffect(
    name="wind",
    stage=Stage.AIR,
    parameters=(
        Parameter("drag_per_speed_N_s_m", "N s/m", -0.3, 50.0,
            source="wide: any value between the bounds; see rotor_drag: it goes with the vehicle's size"),
        Parameter("wind_north_m_s", "m/s", *LIMITS["north"], (0.0, 4.0),
            source="assumed: test flights up to Beaufort 3 (3.4 to 5.4 m/s), from any side"),
        Parameter("wind_east_m_s", "m/s", *LIMITS["east"], (0.0, 4.0),
            source="assumed: test flights up to Beaufort 3 (3.4 to 5.4 m/s), from any side"),
        Parameter("moment_share", "1", -100.0, 100.0, (1.0, 0.5),
            source="1 where the drag acts at the hubs; 0.5 is assumed for the body's own"),
        Parameter("moment_N_s_m", "N s/m", -100.0, 100.0,
            source="wide: any value between the bounds; it goes with the vehicle's size and where its "
                   "body's drag acts"),
        Parameter("body_drag_kg_m", "kg/m", -10.0, 10.0,
            source="wide: any value between the bounds; half of density times drag area; negative where "
                   "rotor drag took some of it"),
        Parameter("body_drag_kg_s", "kg/s", -50.0, 50.0,
            source="wide: any value between the bounds; viscous and shadowing shares of a body's drag "
                   "differ"),
        Parameter("shear_power", "1", *LIMITS["shear"], (0.15, 0.1),
            source="power law of the wind: 1/7 over open ground, 0.1 to 0.25 by roughness"),
        Parameter("beside_drag", "1", 0.0, 1.0,
            source="a switch, 0 or 1: the rotors' drag in still air is another effect's"),
    ),
    flight=FLIGHT,
    no_static=_NO_PROPERTY,
    no_live=_NO_PROPERTY,
)  # fmt: skip
