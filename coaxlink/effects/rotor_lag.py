"""Rotor lag: the speed follows its command later than the airframe file declares.

Source: first-order motor and rotor dynamics, lag x' = u - x (Hamandi, Tognon and Franchi 2020). Delays of a
few milliseconds are clocks and belong to the nuisance; a lag also rounds off what is fast, in forces and
torques alike. Two lags in a row (current and blades) and one that is slower down than up (a controller that
does not brake) are other forms of the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.drive import SETTLED_S, changed_by, drive
from coaxlink.effects.parameter import Range
from coaxlink.effects.tracing import Array, NotShown, Tracing
from coaxlink.frames import STAND_CHANNELS, FlightFrame, StandFrame
from coaxlink.signals import lagged

LAG_ROUNDS = 4  # of a lag that depends on the speed that it makes
# finer around a small one: the nuisance's delay is confounded with most of it, and what share is left turns
# quickly
SMALL_S = (0.0, 0.01, 0.015, 0.02, 0.025, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08)
FLIGHT_LAGS_S = (*SMALL_S, 0.1, 0.12, 0.15, 0.18, 0.22, 0.27, 0.33)


FORGOTTEN, SETTLED = 2.0, 5.0  # lags: 86 % of what was before is gone, 99.3 %
DAMPINGS = (0.35, 0.6)  # starts of the fit: a step overshoots by exp(-pi d / sqrt(1 - d^2)), 30 and 10 %
STAND_LAGS_S = tuple(round(0.02 * 1.2**k, 4) for k in range(25))


def _flight_starts(frame: FlightFrame) -> Sequence[Numbers]:
    if not float(np.std(np.diff(frame.commands, axis=0))) > 1e-5:
        raise NotShown("the commands hardly move")
    declared, least = frame.airframe.motor_lag_s, max(8e-3, 0.5 * frame.step_s)
    return [{"share": 1.0, "lag_s": lag} for lag in FLIGHT_LAGS_S if abs(lag - declared) > least]


def _seen(frame: FlightFrame | StandFrame | None, _: Numbers) -> Range:
    """A stand's rows tell no lag of less; a flight's loop would not close on more.

    When a command changed between two rows of a flight is not known to half their distance: where that is
    more than the declared lag, only a longer one is seen.
    """
    if frame is None:
        return 0.0, 3.0
    if not isinstance(frame, FlightFrame):
        return 0.005, 3.0
    declared, unknown = frame.airframe.motor_lag_s, 0.5 * frame.step_s
    return (declared + unknown if unknown > declared else 0.0), 0.5


def late_speeds(frame: FlightFrame, p: Numbers) -> Array:
    """(rows, N) normalised speeds that follow the commands as the numbers say."""
    lag = p["lag_s"]
    if "second" in p:
        return frame.filtered(frame.filtered(frame.commands, 0.5 * lag), 0.5 * lag)
    speeds = frame.filtered(frame.commands, lag)
    bend = p.get("asymmetry", 0.0)
    if bend != 0.0:
        # lag x' = e + a |e|, e = u - x: quicker up than down; solved by putting |e| on the command
        for _ in range(LAG_ROUNDS):
            speeds = frame.filtered(frame.commands + bend * np.abs(frame.commands - speeds), lag)
    return speeds


def _changes(frame: FlightFrame, p: Numbers) -> FlightFrame:
    return frame.turning_at(frame.speeds + p["share"] * (late_speeds(frame, p) - frame.speeds))


def _flight_further(_: FlightFrame, p: Numbers) -> Sequence[Numbers]:
    whole = {"share": 1.0, "lag_s": p["lag_s"]}
    return [{**whole, "second": 1.0}, {**whole, "asymmetry": 0.1}]


FLIGHT: Tracing[FlightFrame] = Tracing(
    needs=("time_s", "motor1"),
    channels=("force_z", "torque_x", "torque_y", "torque_z"),
    starts=_flight_starts,
    further=_flight_further,
    changes=_changes,
    cause=lambda frame, *_: (
        "command_rate_1_s",
        np.gradient(frame.commands.mean(axis=1), 1.0 / frame.rate_hz),
    ),
)


def _no_time(frame: StandFrame) -> str | None:
    step = float(np.median(np.diff(frame.time_s))) if len(frame.time_s) > 2 else np.inf
    if not step > 0.0:
        return "most rows repeat the time of the row before"
    if not step < SETTLED_S:
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


def _ringing(u: Array, step_s: float, p: Numbers) -> Array:
    """(rows, 2) behind a speed loop of second order, x'' + 2 d w x' + w^2 x = w^2 u with 2 d / w the lag.

    On throttles that run straight from row to row or, `stepped`, stand until the next one; starts settled.
    """
    from scipy.signal import cont2discrete, lfilter, lfilter_zi

    damping = p["damping"]
    rate = 2.0 * damping / p["lag_s"]
    loop = ([1.0], [1.0 / rate**2, 2.0 * damping / rate, 1.0])
    b, a, _ = cont2discrete(loop, step_s, method="zoh" if "stepped" in p else "foh")
    taps = b.ravel()[1:] if "stepped" in p else b.ravel()  # a jump right after the row before
    out, _ = lfilter(taps, a, u, axis=0, zi=lfilter_zi(taps, a)[:, None] * u[:1])
    return np.asarray(out)


def _late(frame: StandFrame, p: Numbers) -> Array:
    """(rows, 2) speeds behind the throttles; what they did in a gap that outlasts the lag is not known.

    They are taken to have moved before its end as right behind it, within what the log has: on a ramp the
    speed is late from its first row on.
    """
    u, step = drive(frame), float(np.median(np.diff(frame.time_s)))
    gaps = np.flatnonzero(np.diff(frame.time_s) > max(1.5 * step, FORGOTTEN * p["lag_s"])) + 1
    if not len(gaps):
        return _behind(u, step, p)
    before = np.arange(-int(min(np.ceil(SETTLED * p["lag_s"] / step), len(u))), 0)[:, None]
    low, high, out = u.min(axis=0), u.max(axis=0), []
    for first, end in pairwise([0, *gaps.tolist(), len(u)]):
        mine = u[first:end]
        if first and len(mine) > 1:
            mine = np.concatenate([np.clip(mine[0] + before * (mine[1] - mine[0]), low, high), mine])
        out.append(_behind(mine, step, p)[first - end :])
    return np.concatenate(out)


def _behind(u: Array, step: float, p: Numbers) -> Array:
    """(rows, rotors) speeds behind throttles: one lag, a second stage before it, other lags up and down.

    With `lower` the lower rotor's lag is so many times the upper one's.
    """
    if "lower" in p:
        alike = {name: value for name, value in p.items() if name != "lower"}
        slower = alike | {"lag_s": p["lag_s"] * p["lower"]}
        return np.concatenate([_behind(u[:, :1], step, alike), _behind(u[:, 1:], step, slower)], axis=1)
    if "damping" in p:
        return _ringing(u, step, p)
    lag = p["lag_s"]
    follow = _stepped if "stepped" in p else lagged
    if "second_s" in p:
        u = follow(u, step, p["second_s"])
    if "down" not in p:
        return follow(u, step, lag)
    target = u if "stepped" in p else 0.5 * (u + np.concatenate([u[:1], u[:-1]]))
    return _both_ways(target, step, lag, lag * p["down"])


def _starts(frame: StandFrame) -> Sequence[Numbers]:
    """One lag; a governor with an integral part, whose speed overshoots; a wake that reaches the lower rotor
    late.

    Where speeds were measured the wake is all that can be late (Leishman 2006, ch. 10: inflow takes time to
    build up).
    """
    if why := _no_time(frame):
        raise NotShown(why)
    jumps: tuple[Numbers, ...] = ({}, {"stepped": 1.0})
    lags: list[Numbers] = [{"share": 1.0, "lag_s": s} for s in STAND_LAGS_S]
    if not frame.driven and frame.throttles is None:
        return [{**lag, "wake": 1.0} for lag in lags]
    return [
        *({**lag, **jump} for lag in lags for jump in jumps),
        *({**lag, "damping": d, **jump} for lag in lags[::2] for d in DAMPINGS for jump in jumps),
    ]


def _adds(frame: StandFrame, p: Numbers) -> Array:
    late = _late(frame, p)
    if "wake" not in p:
        return p["share"] * changed_by(frame, late)
    out = changed_by(frame, np.stack([late[:, 0], drive(frame)[:, 1]], axis=1))
    out[:, :2] = 0.0
    return p["share"] * out


def _further(_: StandFrame, p: Numbers) -> Sequence[Numbers]:
    """A second stage before it, other lags up and down or of the rotors, throttles that jump; of what
    overshoots what does not."""
    if "damping" in p:  # what is late by as much, or forgets as slowly, and does not overshoot
        jump = {"stepped": 1.0} if "stepped" in p else {}
        p = {"share": 1.0, "lag_s": p["lag_s"] * max(2.0 * p["damping"], 1.0 / p["damping"]), **jump}
    second, down, lower = {"second_s": 0.2 * p["lag_s"]}, {"down": 1.2}, {"lower": 1.2}
    if "wake" in p:
        return [] if "second_s" in p else [{**p, **second}]
    whole = {**p, "share": 1.0}
    if {"second_s", "down", "lower"} & set(p):
        jump = {name: v for name, v in whole.items() if name != "stepped"}
        jump |= {} if "stepped" in p else {"stepped": 1.0}
        return [jump, *({**whole, **more} for more in (second, down, lower) if not set(more) & set(p))]
    other = {"share": 1.0, "lag_s": p["lag_s"]} | ({} if "stepped" in p else {"stepped": 1.0})
    more_of = (second, down, second | down, lower)
    return [*({**p, **more} for more in more_of), *({**other, **more} for more in more_of)]


STAND: Tracing[StandFrame] = Tracing(
    needs=("time_s", "upper_throttle"),
    channels=STAND_CHANNELS,
    starts=_starts,
    further=_further,
    adds=_adds,
    cause=lambda frame, _, channel: (
        "throttle_rate_1_s",
        np.gradient(drive(frame)[:, 1 if channel.startswith("lower") else 0], frame.time_s),
    ),
)


EFFECT = PhysicalEffect(
    name="rotor_lag",
    stage=Stage.DRIVE,
    physics="the speed follows its command as a first-order lag of another length than declared",
    source="first-order motor dynamics (Hamandi, Tognon and Franchi 2020)",
    parameters=(
        Parameter("lag_s", "s", 0.0, 3.0, (0.05, 0.05), moves=True, within=_seen,
            source="assumed: 20 ms (5 in propellers) to 100 ms (30 in)"),
        Parameter("share", "1", 0.7, 1.4, (1.0, 0.1), amount=True,
            source="1 by definition, the whole of the lag; 0.1 is assumed for filters that differ"),
        Parameter("second", "1", 0.0, 1.0, source="a switch, 0 or 1: two lags in a row, current and blades"),
        Parameter("second_s", "s", 0.002, 1.0, moves=True,
            source="wide: any value between the bounds; a second lag goes with the controller's current "
                   "loop"),
        Parameter("asymmetry", "1", -0.6, 0.6, moves=True,
            source="wide: any value between the bounds; slower down than up without braking, by how much "
                   "goes with the controller"),
        Parameter("down", "1", 0.4, 2.5, moves=True,
            source="wide: any value between the bounds; slower down than up without braking, by how much "
                   "goes with the controller"),
        Parameter("lower", "1", 0.4, 2.5, moves=True,
            source="wide: any value between the bounds; the lower rotor's lag over the upper one's, by motor "
                   "and propeller"),
        Parameter("damping", "1", 0.1, 1.5, moves=True,
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
