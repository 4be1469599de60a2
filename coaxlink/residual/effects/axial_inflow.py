"""Axial inflow: climbing, the blades meet the air at a smaller angle and pull less; sinking, more.

Source: blade element theory, dT = -c Omega V_axial for small climb (Leishman, Principles of Helicopter
Aerodynamics, 2006, ch. 2-3). V is the rotor hub's own: body rates add to it, which damps roll and pitch. With
the climb's share of the inflow the slope changes (momentum theory, the same book): with r = V / Omega,
r / (1 + a |r|) + b r^2 is that, to second order, for climb and descent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from coaxlink.residual.effects.base import Array, Effect, Shape, outside
from coaxlink.residual.frames import FlightFrame

LEVELLING_S_M = (0.0, 0.3)  # at full speed
LEAST_SPEED = 0.1


def hub_climb(frame: FlightFrame) -> Array:
    """(rows, N) speed of every hub along its own thrust axis, m/s."""
    axis = np.array([r.axis for r in frame.airframe.rotors])
    position = np.array([r.position_m for r in frame.airframe.rotors])
    turning = np.cross(frame.rates[:, None, :], position[None, :, :])
    return np.einsum("rni,ni->rn", frame.velocity[:, None, :] + turning, axis)


def _missing(frame: FlightFrame) -> str | None:
    climb = float(np.quantile(np.abs(hub_climb(frame)[frame.keep].mean(axis=1)), 0.98))
    return None if climb > 0.15 else f"never climbs or sinks faster than {climb:.2f} m/s"


def _loss(frame: FlightFrame, shape: Shape) -> Array:
    """(rows, N, K) thrust lost by unit coefficients, N."""
    climb, u = hub_climb(frame), np.maximum(frame.speeds, LEAST_SPEED)
    share = np.ones_like(u)
    if "by_thrust" in shape:  # a rotor in another's wake has less thrust to lose
        share = frame.thrust / u**2
        share = share / max(float(np.median(share[frame.keep])), 1e-9)
    # T = u^2 f(V / u): what bends does so with the inflow's ratio
    first = share * u * climb / (1.0 + shape.get("levelling_s_m", 0.0) * np.abs(climb) / u)
    if "bent" not in shape:
        return np.asarray(first[..., None])
    return np.stack([first, share * climb**2], axis=-1)


def _columns(frame: FlightFrame, shape: Shape) -> Array:
    loss = -_loss(frame, shape)
    none = np.zeros_like(frame.thrust)
    pieces = [frame.airframe.body_loads(loss[..., k], none) for k in range(loss.shape[-1])]
    return np.stack(pieces, axis=-1)


def _parameters(_: FlightFrame, shape: Shape, c: Array) -> dict[str, float]:
    bend = {"thrust_per_climb_squared_N_s2_m2": float(c[1])} if "bent" in shape else {}
    rest = {k: v for k, v in shape.items() if k != "bent"}
    return {"thrust_per_climb_N_s_m": float(c[0]), **bend, **rest}


def _inverse(_: FlightFrame, p: Mapping[str, float]) -> tuple[Shape, Array]:
    shape = {k: v for k, v in p.items() if k in ("by_thrust", "levelling_s_m")}
    c = [p["thrust_per_climb_N_s_m"]]
    if "thrust_per_climb_squared_N_s2_m2" in p:
        shape["bent"] = 1.0
        c.append(p["thrust_per_climb_squared_N_s2_m2"])
    return shape, np.array(c)


def _apply(frame: FlightFrame, p: Mapping[str, float]) -> FlightFrame:
    shape, c = _inverse(frame, p)
    return frame.pulling(frame.thrust - _loss(frame, shape) @ c, frame.torque)


def _finer(_: FlightFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    bent = np.array([c[0], 0.0])
    mine: Shape = {k: v for k, v in shape.items() if k == "by_thrust"}
    other: Shape = {} if mine else {"by_thrust": 1.0}
    forms = [mine, other]
    return [
        (other, c[:1]),
        *(({**form, "bent": 1.0}, bent) for form in forms),
        *(({**form, "levelling_s_m": 0.03}, c[:1]) for form in forms),
    ]


def _cause(frame: FlightFrame, _: Shape, channel: str) -> tuple[str, Array]:
    if channel in ("torque_x", "torque_y"):
        axis = channel[-1]
        return f"rate_{axis}_rad_s", frame.rates[:, "xy".index(axis)]
    return "climb_m_s", hub_climb(frame).mean(axis=1)


FLIGHT: Effect[FlightFrame] = Effect(
    name="axial_inflow",
    physics="thrust falls with the hub's speed along its axis: dT = -c u V",
    source="blade element theory in axial flight (Leishman 2006)",
    needs=("vel_d_m_s", "roll_rad", "pitch_rad", "yaw_rad"),
    channels=("force_z", "torque_x", "torque_y"),
    units={
        "thrust_per_climb_N_s_m": "N s/m",
        "thrust_per_climb_squared_N_s2_m2": "N s2/m2",
        "levelling_s_m": "s/m",
        "by_thrust": "1",
    },
    missing=_missing,
    shapes=lambda _: [{}, {"by_thrust": 1.0}],
    columns=_columns,
    parameters=_parameters,
    inverse=_inverse,
    refuse=lambda p: outside("thrust_per_climb_N_s_m", p["thrust_per_climb_N_s_m"], 0.0, 30.0, "N s/m"),
    cause=_cause,
    nil=lambda _: {"thrust_per_climb_N_s_m": 0.0},
    stage=3,
    apply=_apply,
    free=lambda _, shape: {"levelling_s_m": LEVELLING_S_M} if "levelling_s_m" in shape else {},
    finer=_finer,
)
