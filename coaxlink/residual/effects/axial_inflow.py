"""Axial inflow: climbing, the blades meet the air at a smaller angle and pull less; sinking, more.

Source: blade element theory, dT = -c Omega V_axial for small climb (Leishman, Principles of Helicopter
Aerodynamics, 2006, ch. 2-3). V is the rotor hub's own: body rates add to it, which damps roll and pitch.
"""

from __future__ import annotations

import numpy as np

from coaxlink.residual.effects.base import Array, Effect, Shape, one_shape, outside
from coaxlink.residual.frames import FlightFrame


def hub_climb(frame: FlightFrame) -> Array:
    """(rows, N) speed of every hub along its own thrust axis, m/s."""
    axis = np.array([r.axis for r in frame.airframe.rotors])
    position = np.array([r.position_m for r in frame.airframe.rotors])
    turning = np.cross(frame.rates[:, None, :], position[None, :, :])
    return np.einsum("rni,ni->rn", frame.velocity[:, None, :] + turning, axis)


def _missing(frame: FlightFrame) -> str | None:
    climb = float(np.quantile(np.abs(hub_climb(frame)[frame.keep].mean(axis=1)), 0.98))
    return None if climb > 0.15 else f"never climbs or sinks faster than {climb:.2f} m/s"


def _columns(frame: FlightFrame, _: Shape) -> Array:
    thrust = -frame.speeds * hub_climb(frame)
    return frame.airframe.body_loads(thrust, np.zeros_like(thrust))[..., None]


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
    units={"thrust_per_climb_N_s_m": "N s/m"},
    missing=_missing,
    shapes=one_shape,
    columns=_columns,
    parameters=lambda _, __, c: {"thrust_per_climb_N_s_m": float(c[0])},
    inverse=lambda _, p: ({}, np.array([p["thrust_per_climb_N_s_m"]])),
    refuse=lambda p: outside("thrust_per_climb_N_s_m", p["thrust_per_climb_N_s_m"], 0.0, 30.0, "N s/m"),
    cause=_cause,
)
