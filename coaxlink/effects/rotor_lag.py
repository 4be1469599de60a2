"""Rotor lag: the speed follows its command later than the airframe file declares.

Source: first-order motor and rotor dynamics, lag x' = u - x (Hamandi, Tognon and Franchi 2020). Delays of a
few milliseconds are clocks and belong to the nuisance; a lag also rounds off what is fast, in forces and
torques alike. Two lags in a row (current and blades) and one that is slower down than up (a controller that
does not brake) are other forms of the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from coaxlink.effects.base import Parameter, PhysicalEffect, Stage
from coaxlink.effects.drive import changed_by, drive
from coaxlink.effects.tracing import Array, Shape, Tracing, outside
from coaxlink.frames import STAND_CHANNELS, FlightFrame, StandFrame
from coaxlink.signals import lagged

ROUNDS = 4
# finer around a small one: the nuisance's delay is confounded with most of it, and what share is left turns
# quickly
SMALL_S = (0.0, 0.01, 0.015, 0.02, 0.025, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08)
FLIGHT_LAGS_S = (*SMALL_S, 0.1, 0.12, 0.15, 0.18, 0.22, 0.27, 0.33)


FORGOTTEN, SETTLED = 2.0, 5.0  # lags: 86 % of what was before is gone, 99.3 %
DAMPINGS = (0.35, 0.6)  # starts of the fit: a step overshoots by exp(-pi d / sqrt(1 - d^2)), 30 and 10 %
STAND_LAGS_S = tuple(round(0.02 * 1.2**k, 4) for k in range(25))


def _missing(frame: FlightFrame) -> str | None:
    return None if float(np.std(np.diff(frame.commands, axis=0))) > 1e-5 else "the commands hardly move"


def _shapes(frame: FlightFrame) -> Sequence[Shape]:
    declared = frame.airframe.motor_lag_s
    return [{"lag_s": lag} for lag in FLIGHT_LAGS_S if abs(lag - declared) > 8e-3]


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


def _variants(_: FlightFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    one = np.ones(1)
    return [
        ({"lag_s": shape["lag_s"], "second": 1.0}, one),
        ({"lag_s": shape["lag_s"], "asymmetry": 0.1}, one),
    ]


def _refuse(p: Mapping[str, float]) -> str | None:
    return outside("share", p["share"], 0.8, 1.25)


FLIGHT: Tracing[FlightFrame] = Tracing(
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
    variants=_variants,
)


def _no_time(frame: StandFrame) -> str | None:
    step = float(np.median(np.diff(frame.time_s))) if len(frame.time_s) > 2 else np.inf
    if not step > 0.0:
        return "most rows repeat the time of the row before"
    if not step < 0.6:
        return f"rows are {step:.1f} s apart: a lag has settled between them"
    return None  # without throttles it is what the log calls speed that runs ahead of the rotors


def _stepped(u: Array, step_s: float, lag_s: float) -> Array:
    """(rows, 2) behind a throttle that jumps right after a row and stands until the next one."""
    from scipy.signal import lfilter

    keep = float(np.exp(-step_s / lag_s))
    out, _ = lfilter([1.0 - keep], [1.0, -keep], u, axis=0, zi=u[:1] * keep)
    return np.asarray(out)


def _both_ways(target: Array, step_s: float, up_s: float, down_s: float) -> Array:
    """(rows, rotors) behind targets that stand from row to row: one lag up, another down."""
    rise, fall = float(np.exp(-step_s / up_s)), float(np.exp(-step_s / down_s))
    out = np.empty_like(target)
    for side in range(target.shape[1]):
        now, mine = float(target[0, side]), []
        for commanded in target[:, side].tolist():  # which lag it is, the speed before says
            now = commanded + (now - commanded) * (rise if commanded > now else fall)
            mine.append(now)
        out[:, side] = mine
    return out


def _ringing(u: Array, step_s: float, shape: Shape) -> Array:
    """(rows, 2) behind a speed loop of second order, x'' + 2 d w x' + w^2 x = w^2 u with 2 d / w the lag.

    On throttles that run straight from row to row or, `stepped`, stand until the next one; starts settled.
    """
    from scipy.signal import cont2discrete, lfilter, lfilter_zi

    damping = shape["damping"]
    rate = 2.0 * damping / shape["lag_s"]
    loop = ([1.0], [1.0 / rate**2, 2.0 * damping / rate, 1.0])
    b, a, _ = cont2discrete(loop, step_s, method="zoh" if "stepped" in shape else "foh")
    taps = b.ravel()[1:] if "stepped" in shape else b.ravel()  # a jump right after the row before
    out, _ = lfilter(taps, a, u, axis=0, zi=lfilter_zi(taps, a)[:, None] * u[:1])
    return np.asarray(out)


def ringing_shapes(_: StandFrame) -> Sequence[Shape]:
    """A governor with an integral part: the speed overshoots its command."""
    return [
        {"lag_s": s, "damping": d, **form}
        for s in STAND_LAGS_S[::2]
        for d in DAMPINGS
        for form in ({}, {"stepped": 1.0})
    ]


def _late(frame: StandFrame, shape: Shape) -> Array:
    """(rows, 2) speeds behind the throttles; what they did in a gap that outlasts the lag is not known.

    They are taken to have moved before its end as right behind it, within what the log has: on a ramp the
    speed is late from its first row on.
    """
    u, step = drive(frame), float(np.median(np.diff(frame.time_s)))
    gaps = np.flatnonzero(np.diff(frame.time_s) > max(1.5 * step, FORGOTTEN * shape["lag_s"])) + 1
    if not len(gaps):
        return _behind(u, step, shape)
    before = np.arange(-int(min(np.ceil(SETTLED * shape["lag_s"] / step), len(u))), 0)[:, None]
    low, high, out = u.min(axis=0), u.max(axis=0), []
    for first, end in pairwise([0, *gaps.tolist(), len(u)]):
        mine = u[first:end]
        if first and len(mine) > 1:
            mine = np.concatenate([np.clip(mine[0] + before * (mine[1] - mine[0]), low, high), mine])
        out.append(_behind(mine, step, shape)[first - end :])
    return np.concatenate(out)


def _behind(u: Array, step: float, shape: Shape) -> Array:
    """(rows, rotors) speeds behind throttles: one lag, a second stage before it, other lags up and down.

    With `lower` the lower rotor's lag is so many times the upper one's.
    """
    if "lower" in shape:
        alike = {name: value for name, value in shape.items() if name != "lower"}
        slower = alike | {"lag_s": shape["lag_s"] * shape["lower"]}
        return np.concatenate([_behind(u[:, :1], step, alike), _behind(u[:, 1:], step, slower)], axis=1)
    if "damping" in shape:
        return _ringing(u, step, shape)
    lag = shape["lag_s"]
    follow = _stepped if "stepped" in shape else lagged
    if "second_s" in shape:
        u = follow(u, step, shape["second_s"])
    if "down" not in shape:
        return follow(u, step, lag)
    target = u if "stepped" in shape else 0.5 * (u + np.concatenate([u[:1], u[:-1]]))
    return _both_ways(target, step, lag, lag * shape["down"])


def wake_shapes(frame: StandFrame) -> Sequence[Shape]:
    """The upper rotor's wake that takes its time to reach the lower one: its loads lag behind the upper
    speed.

    Where speeds were measured that is all that can be late (Leishman 2006, ch. 10: inflow takes time to
    build up).
    """
    return (
        []
        if frame.driven or frame.throttles is not None
        else [{"lag_s": s, "wake": 1.0} for s in STAND_LAGS_S]
    )


def _lag_columns(frame: StandFrame, shape: Shape) -> Array:
    late = _late(frame, shape)
    if "wake" in shape:
        late = np.stack([late[:, 0], drive(frame)[:, 1]], axis=1)
    out = changed_by(frame, late)
    if "wake" in shape:
        out[:, :2] = 0.0
    return out[..., None]


def _lag_free(_: StandFrame, shape: Shape) -> Mapping[str, tuple[float, float]]:
    limits = {
        "lag_s": (0.005, 3.0),
        "second_s": (0.002, 1.0),
        "down": (0.4, 2.5),
        "lower": (0.4, 2.5),
        "damping": (0.1, 1.5),
    }
    return {name: limit for name, limit in limits.items() if name in shape}


def _lag_variants(_: StandFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    if "damping" in shape:
        return []
    if "wake" in shape:
        return [] if "second_s" in shape else [({**shape, "second_s": 0.2 * shape["lag_s"]}, c)]
    second, down, lower = {"second_s": 0.2 * shape["lag_s"]}, {"down": 1.2}, {"lower": 1.2}
    if {"second_s", "down", "lower"} & set(shape):
        more_of = (second, down, lower)
        return [({**shape, **more}, np.ones(1)) for more in more_of if not set(more) & set(shape)]
    other = {"lag_s": shape["lag_s"]} | ({} if "stepped" in shape else {"stepped": 1.0})
    one = np.ones(1)
    return [
        *(({**shape, **more}, c) for more in (second, down, second | down, lower)),
        *(({**other, **more}, one) for more in (second, down, second | down, lower)),
    ]


STAND: Tracing[StandFrame] = Tracing(
    name="rotor_lag",
    stage=0,
    physics="the speed follows the throttle as a first-order lag",
    source="first-order motor dynamics (Hamandi, Tognon and Franchi 2020)",
    needs=("time_s", "upper_throttle"),
    channels=STAND_CHANNELS,
    units={
        "lag_s": "s",
        "share": "1",
        "second_s": "s",
        "down": "1",
        "lower": "1",
        "stepped": "1",
        "damping": "1",
        "wake": "1",
    },
    missing=_no_time,
    shapes=lambda frame: [
        *({"lag_s": s, **form} for s in STAND_LAGS_S for form in ({}, {"stepped": 1.0})),
        *ringing_shapes(frame),
        *wake_shapes(frame),
    ],
    columns=_lag_columns,
    parameters=lambda _, shape, c: {**shape, "share": float(c[0])},
    inverse=lambda _, p: ({k: v for k, v in p.items() if k != "share"}, np.array([p["share"]])),
    refuse=lambda p: outside("share", p["share"], 0.7, 1.4),
    cause=lambda frame, _, channel: (
        "throttle_rate_1_s",
        np.gradient(drive(frame)[:, 1 if channel.startswith("lower") else 0], frame.time_s),
    ),
    free=_lag_free,
    variants=_lag_variants,
)


EFFECT = PhysicalEffect(
    name="rotor_lag",
    stage=Stage.DRIVE,
    parameters=(
        Parameter("lag_s", "s", 0.0, 3.0, (0.05, 0.05),
            source="assumed: 20 ms (5 in propellers) to 100 ms (30 in)"),
        Parameter("share", "1", 0.7, 1.4, (1.0, 0.1),
            source="1 by definition, the whole of the lag; 0.1 is assumed for filters that differ"),
        Parameter("second", "1", 0.0, 1.0, source="a switch, 0 or 1: two lags in a row, current and blades"),
        Parameter("second_s", "s", 0.002, 1.0,
            source="wide: any value between the bounds; a second lag goes with the controller's current "
                   "loop"),
        Parameter("asymmetry", "1", -0.6, 0.6,
            source="wide: any value between the bounds; slower down than up without braking, by how much "
                   "goes with the controller"),
        Parameter("down", "1", 0.4, 2.5,
            source="wide: any value between the bounds; slower down than up without braking, by how much "
                   "goes with the controller"),
        Parameter("lower", "1", 0.4, 2.5,
            source="wide: any value between the bounds; the lower rotor's lag over the upper one's, by motor "
                   "and propeller"),
        Parameter("damping", "1", 0.1, 1.5,
            source="wide: any value between the bounds; a governor's gains set how far speed overshoots"),
        Parameter("wake", "1", 0.0, 1.0,
            source="a switch, 0 or 1: the wake comes late, not the speeds (Leishman 2006, ch. 10)"),
        Parameter("stepped", "1", 0.0, 1.0, source="a switch, 0 or 1: the throttle jumps right after a row"),
    ),
    flight=FLIGHT,
    stand=STAND,
    no_static="a mixer is static: declare motor_lag_s and tune the loops for the slower rotor",
    no_live="declare motor_lag_s and tune the loops to it",
)  # fmt: skip
