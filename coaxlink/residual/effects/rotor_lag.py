"""Rotor lag: the speed follows its command later than the airframe file declares.

Source: first-order motor and rotor dynamics, lag x' = u - x (Hamandi, Tognon and Franchi 2020). Delays of a
few milliseconds are clocks and belong to the base; a lag also rounds off what is fast, in forces and
torques alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from coaxlink.residual.effects.base import Array, Effect, Shape, outside
from coaxlink.residual.frames import FlightFrame
from coaxlink.residual.signals import lagged

LAGS_S = (0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.1, 0.12, 0.15, 0.18, 0.22, 0.27, 0.33)


def _missing(frame: FlightFrame) -> str | None:
    return None if float(np.std(np.diff(frame.commands, axis=0))) > 1e-5 else "the commands hardly move"


def _shapes(frame: FlightFrame) -> Sequence[Shape]:
    declared = frame.airframe.motor_lag_s
    return [{"lag_s": lag} for lag in LAGS_S if abs(lag - declared) > 8e-3]


def _columns(frame: FlightFrame, shape: Shape) -> Array:
    speeds = np.empty_like(frame.commands)
    for number in np.unique(frame.stretch):
        rows = frame.stretch == number
        speeds[rows] = lagged(frame.commands[rows], 1.0 / frame.rate_hz, shape["lag_s"])
    late = frame.airframe.body_loads(*frame.airframe.loads(frame.model, np.clip(speeds, 0.0, None)))
    return (late - frame.predicted)[..., None]


def _refuse(p: Mapping[str, float]) -> str | None:
    return outside("share", p["share"], 0.8, 1.25)


FLIGHT: Effect[FlightFrame] = Effect(
    name="rotor_lag",
    physics="rotor speed follows its command as a first-order lag of another length than declared",
    source="first-order motor dynamics (Hamandi, Tognon and Franchi 2020)",
    needs=("time_s", "motor1"),
    channels=("force_z", "torque_x", "torque_y", "torque_z"),
    units={"lag_s": "s", "share": "1"},
    missing=_missing,
    shapes=_shapes,
    columns=_columns,
    parameters=lambda _, shape, c: {"lag_s": shape["lag_s"], "share": float(c[0])},
    inverse=lambda _, p: ({"lag_s": p["lag_s"]}, np.array([p["share"]])),
    refuse=_refuse,
    cause=lambda frame, _, channel: (
        "command_rate_1_s",
        np.gradient(frame.commands.mean(axis=1), 1.0 / frame.rate_hz),
    ),
)
