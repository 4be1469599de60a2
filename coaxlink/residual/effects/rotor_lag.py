"""Rotor lag: the speed follows its command later than the airframe file declares.

Source: first-order motor and rotor dynamics, lag x' = u - x (Hamandi, Tognon and Franchi 2020). Delays of a
few milliseconds are clocks and belong to the base; a lag also rounds off what is fast, in forces and
torques alike. Two lags in a row (current and blades) and one that is slower down than up (a controller that
does not brake) are other forms of the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from coaxlink.residual.effects.base import Array, Effect, Shape, outside
from coaxlink.residual.frames import FlightFrame

ROUNDS = 4
# finer around a small one: the base's delay stands in for most of it, and what share is left turns quickly
SMALL_S = (0.0, 0.01, 0.015, 0.02, 0.025, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08)
LAGS_S = (*SMALL_S, 0.1, 0.12, 0.15, 0.18, 0.22, 0.27, 0.33)


def _missing(frame: FlightFrame) -> str | None:
    return None if float(np.std(np.diff(frame.commands, axis=0))) > 1e-5 else "the commands hardly move"


def _shapes(frame: FlightFrame) -> Sequence[Shape]:
    declared = frame.airframe.motor_lag_s
    return [{"lag_s": lag} for lag in LAGS_S if abs(lag - declared) > 8e-3]


def late_speeds(frame: FlightFrame, shape: Shape) -> Array:
    """(rows, N) normalised speeds that follow the commands as the shape says."""
    lag = shape["lag_s"]
    if "second" in shape:
        return frame.filtered(frame.filtered(frame.commands, 0.5 * lag), 0.5 * lag)
    speeds = frame.filtered(frame.commands, lag)
    bend = shape.get("asymmetry", 0.0)
    if bend != 0.0:
        # lag x' = e + a |e|, e = u - x: quicker up than down; solved by putting |e| on the command
        for _ in range(ROUNDS):
            speeds = frame.filtered(frame.commands + bend * np.abs(frame.commands - speeds), lag)
    return speeds


def _columns(frame: FlightFrame, shape: Shape) -> Array:
    late = frame.turning_at(late_speeds(frame, shape)).predicted
    return (late - frame.predicted)[..., None]


def _apply(frame: FlightFrame, p: Mapping[str, float]) -> FlightFrame:
    shape, c = _inverse(frame, p)
    return frame.turning_at(frame.speeds + c[0] * (late_speeds(frame, shape) - frame.speeds))


def _inverse(_: FlightFrame, p: Mapping[str, float]) -> tuple[Shape, Array]:
    return {k: v for k, v in p.items() if k != "share"}, np.array([p["share"]])


def _free(_: FlightFrame, shape: Shape) -> Mapping[str, tuple[float, float]]:
    limits = {"lag_s": (0.0, 0.5), "asymmetry": (-0.6, 0.6)}
    return {k: limits[k] for k in shape if k in limits}


def _finer(_: FlightFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    one = np.ones(1)
    return [
        ({"lag_s": shape["lag_s"], "second": 1.0}, one),
        ({"lag_s": shape["lag_s"], "asymmetry": 0.1}, one),
    ]


def _refuse(p: Mapping[str, float]) -> str | None:
    return outside("share", p["share"], 0.8, 1.25)


FLIGHT: Effect[FlightFrame] = Effect(
    name="rotor_lag",
    physics="rotor speed follows its command as a first-order lag of another length than declared",
    source="first-order motor dynamics (Hamandi, Tognon and Franchi 2020)",
    needs=("time_s", "motor1"),
    channels=("force_z", "torque_x", "torque_y", "torque_z"),
    units={"lag_s": "s", "share": "1", "second": "1", "asymmetry": "1"},
    missing=_missing,
    shapes=_shapes,
    columns=_columns,
    parameters=lambda _, shape, c: {**shape, "share": float(c[0])},
    inverse=_inverse,
    refuse=_refuse,
    cause=lambda frame, _, channel: (
        "command_rate_1_s",
        np.gradient(frame.commands.mean(axis=1), 1.0 / frame.rate_hz),
    ),
    stage=0,
    apply=_apply,
    free=_free,
    finer=_finer,
)
