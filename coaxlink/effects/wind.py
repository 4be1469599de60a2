"""Wind: the air moves, and with it the velocity that drags the rotors: F_xy = -k sum(u_i) (v - w)_xy.

Source: rotor drag (see `rotor_drag`) on the air speed; constant wind in the world frame, seen by the body
through its attitude; the body's own drag, (d |v - w| + e) (v - w), acts besides. Needs turns of heading or
speed to separate it from a sensor bias. Where `rotor_drag` stands beside it, that is the rotors' drag in
still air, and here is what the wind adds. It is found linear in the wind, then fitted as written; near
the ground it may blow less: w = w_m (h / h_m)^p, h_m the flight's middle height (the wind's power law).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.parameter import Range, per
from coaxlink.effects.rotor_drag import BY_SPEED, drag_cause, hub_drag
from coaxlink.effects.tracing import Array, NotShown, Tracing
from coaxlink.frames import FlightFrame

LOWEST_M = 0.2  # above the ground: nearer, a power law of height means nothing
MOST_M_S = 12.0  # a start of the fit: Beaufort 6
DRAG, BODY = BY_SPEED, "body_drag_kg_m"


def _missing(frame: FlightFrame) -> str | None:
    turned = float(np.ptp(frame.attitude[frame.keep, 2]))
    return (
        None
        if turned > 0.5
        else f"heading turns by only {np.degrees(turned):.0f} deg: wind looks like a bias"
    )


def _starts(frame: FlightFrame) -> Sequence[Numbers]:
    if why := _missing(frame):
        raise NotShown(why)
    return [{DRAG: 1.0, "wind_north_m_s": 0.0, "wind_east_m_s": 0.0, "moment_share": 1.0}]


def _adds(frame: FlightFrame, p: Numbers) -> Array:
    """Drag of rotors, of their moments, and of the body; beside `rotor_drag`, what the wind adds to that."""
    wind = p["wind_north_m_s"] * frame.north + p["wind_east_m_s"] * frame.east
    air = frame.velocity - _profile(frame, p)[:, None] * wind
    out, still = (hub_drag(frame, v, {DRAG: 1.0}) for v in (air, frame.velocity))
    out[:, :3] *= p[DRAG]
    out[:, 3:] = _moment(p) * still[:, 3:]
    if not {"moment_share", "moment_N_s_m"} & set(p):
        out[:, :3] -= p[DRAG] * still[:, :3]
    body = p.get(BODY, 0.0) * np.linalg.norm(air, axis=1, keepdims=True) + p.get("body_drag_kg_s", 0.0)
    out[:, :3] -= body * air
    return out


def _moment(p: Numbers) -> float:
    return p.get("moment_N_s_m", p[DRAG] * p.get("moment_share", 0.0))


def _profile(frame: FlightFrame, p: Numbers) -> Array:
    """(rows,) share of the wind that blows at every height."""
    if "shear_power" not in p or frame.height is None:
        return np.ones(len(frame.time_s))
    height = np.maximum(frame.height, LOWEST_M)
    return np.asarray((height / float(np.median(height[frame.keep]))) ** p["shear_power"])


def _speed(_: FlightFrame, p: Numbers) -> float:
    return float(np.hypot(p["wind_north_m_s"], p["wind_east_m_s"]))


def _drag(_: FlightFrame | None, p: Numbers) -> Range:
    """Beside the body's drag the rotors' may be nothing."""
    return (-0.3 if BODY in p else 0.0), 50.0


def apart(p: Numbers) -> tuple[dict[str, float], dict[str, float]]:
    """The wind's parameters with the rotors' drag in still air as an effect of its own, and those of that."""
    wind = {n: v for n, v in p.items() if n != "moment_N_s_m"}
    return wind, {DRAG: p[DRAG], "moment_share": p["moment_N_s_m"] / p[DRAG]}


def _further(frame: FlightFrame, p: Numbers) -> Sequence[Numbers]:
    """All the push from the rotors, or from the body; then drag in proportion, less wind near the ground."""
    if BODY in p:
        richer: list[Numbers] = []
        if "body_drag_kg_s" not in p:
            richer.append({**p, "body_drag_kg_s": 0.0})
        if "shear_power" not in p and frame.height is not None:
            richer.append({**p, "shear_power": 0.1})
        return richer
    less = min(1.0, MOST_M_S / max(_speed(frame, p), 1e-9))
    return [
        {DRAG: of_rotors * p[DRAG], "moment_N_s_m": _moment(p), BODY: of_body}
        | {n: share * less * p[n] for n in ("wind_north_m_s", "wind_east_m_s")}
        for share, of_rotors, of_body in ((1.0, 1.0, 0.0), (1.0, 0.0, 0.1), (0.5, 0.5, 0.1))
    ]


FLIGHT: Tracing[FlightFrame] = Tracing(
    needs=("vel_n_m_s", "vel_e_m_s", "vel_d_m_s", "yaw_rad"),
    channels=("force_x", "force_y", "torque_x", "torque_y", "torque_z"),
    starts=_starts,
    further=_further,
    adds=_adds,
    cause=drag_cause,
)


_NO_PROPERTY = "a force of the air on the body, no property of the vehicle; the position loop carries it"
EFFECT = PhysicalEffect(
    name="wind",
    stage=Stage.AIR,
    place=2,
    physics="drag of the rotors on the air speed, the air itself moving",
    source="rotor drag on v - w (Mahony, Kumar and Corke 2012)",
    parameters=(
        Parameter(DRAG, "N s/m", -0.3, 50.0, amount=True, within=_drag,
            source="wide: any value between the bounds; see rotor_drag: it goes with the vehicle's size"),
        *(Parameter(name, "m/s", -30.0, 30.0, (0.0, 4.0), moves=(BODY,), amount=per(DRAG), nil=0.0,
            source="assumed: test flights up to Beaufort 3 (3.4 to 5.4 m/s), from any side")
          for name in ("wind_north_m_s", "wind_east_m_s")),
        Parameter("moment_share", "1", -100.0, 100.0, (1.0, 0.5), amount=per(DRAG),
            source="1 where the drag acts at the hubs; 0.5 is assumed for the body's own"),
        Parameter("moment_N_s_m", "N s/m", -100.0, 100.0, amount=True,
            source="wide: any value between the bounds; it goes with the vehicle's size and where its "
                   "body's drag acts"),
        Parameter(BODY, "kg/m", -10.0, 10.0, amount=True,
            source="wide: any value between the bounds; half of density times drag area; negative where "
                   "rotor drag took some of it"),
        Parameter("body_drag_kg_s", "kg/s", -50.0, 50.0, amount=True,
            source="wide: any value between the bounds; viscous and shadowing shares of a body's drag "
                   "differ"),
        Parameter("shear_power", "1", 0.0, 0.6, (0.15, 0.1), moves=True,
            source="power law of the wind: 1/7 over open ground, 0.1 to 0.25 by roughness"),
        Parameter("wind_m_s", "m/s", 0.2, 30.0, follows=_speed,
            source="wide: any value between the bounds; less is calm (Beaufort 0)"),
    ),
    flight=FLIGHT,
    no_static=_NO_PROPERTY,
    no_live=_NO_PROPERTY,
)  # fmt: skip
