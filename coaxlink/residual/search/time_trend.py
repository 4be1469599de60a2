"""Time trends: what changes over time for a cause that the log does not hold, a rival of every effect.

A supply that sags, a battery that was changed, weather: where voltage or air were not logged, speeds or loads
still change with them, and an effect whose own column happens to run alike would take their place. A free
time trend, the same for both rotors, has no name, nor has a recorded column that no effect knows. What
is needless beside one of these is not claimed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from coaxlink.effects.tracing import Tracing, one_shape, present
from coaxlink.frames import STAND_LOADS, Array, StandFrame
from coaxlink.residual.regression.dependence import hats
from coaxlink.residual.regression.joint_model import Joint
from coaxlink.residual.regression.problem import Option, from_design
from coaxlink.residual.search.trial import Judge

KNOTS = 8
FEW_VALUES = 6
KNOWN = ("_rpm", "_throttle", "_thrust_N", "_torque_Nm", "_V", "_A", "_W", "_C", "_Pa", "_pwm")
CLEAR_P, CLEAR_SHARE = 1e-6, 0.3  # a trend counts that takes this share of a load's squared error
BESIDE = 0.25  # and this share of what the effect takes


def explained_by_time(joint: Joint, frame: StandFrame, reduce: Callable[[Array], Array]) -> set[str]:
    """Names of members that are needless beside a time trend which the log clearly demands."""
    q, found = joint.problem, set()
    for columns in (*_time_trends(frame), *_unknown_columns(frame)) if joint.members else ():
        added = (reduce(columns) / q.sigma[:, None]).astype(q.design.dtype)
        at = q.design.shape[-1]
        trend = Option(free_trend, {}, np.arange(at, at + added.shape[-1]))
        design = np.concatenate([q.design, added], axis=-1)
        judge = Judge(from_design(q, design, q.residual, [*q.options, trend], frame=frame))
        members = list(q.options)
        there = judge.trial(members, trend)
        if there.gain <= 0.0 or there.p_value > CLEAR_P or there.share < CLEAR_SHARE:
            continue
        taken = judge.left(members) - judge.left([*members, trend])
        for m in members:
            rest = [o for o in members if o is not m]
            if taken < BESIDE * (judge.left(rest) - judge.left(members)):
                continue  # the effect is what mostly changes over time here
            if judge.trial([*rest, trend], m).why_not is not None:
                found.add(m.name)
    return found


def _unknown_columns(frame: StandFrame) -> list[Array]:
    """(rows, 6, K) of each recorded column that no effect knows, and its square, in loads and scales."""
    out = []
    for name, values in frame.columns.items():
        known = name.endswith(KNOWN) or name in ("time_s", "log", "rotor_spacing_m")
        if known or not np.all(np.isfinite(values)) or len(np.unique(values)) < FEW_VALUES:
            continue
        scaled = (values - np.mean(values)) / max(float(np.std(values)), 1e-12)
        columns = np.zeros((len(values), 6, 16))
        for c in range(4):
            for k, way in enumerate((scaled, scaled**2 - 1.0)):
                columns[:, c, 4 * c + 2 * k] = way * frame.reference[c]
                columns[:, c, 4 * c + 2 * k + 1] = way * frame.predicted[:, c]
        out.append(columns)
    return out


def _time_trends(frame: StandFrame) -> list[Array]:
    """(rows, 6, KNOTS) of speeds against the throttles, and of all loads, by hats over the time."""
    time, rows = frame.time_s, len(frame.time_s)
    if rows < 8 * KNOTS or not time[-1] > time[0]:
        return []
    bumps = hats(time, np.linspace(time[0], time[-1], KNOTS))
    drive = frame.speeds if frame.throttles is None else frame.throttles
    slowed = np.stack([frame.slowed(drive * hat[:, None]) for hat in bumps.T], axis=-1)
    loads = np.zeros((rows, 6, KNOTS))
    loads[:, :4] = frame.predicted[:, :4, None] * bumps[:, None, :]
    return [slowed, loads] if frame.driven or frame.throttles is not None else [loads]


free_trend: Tracing[StandFrame] = Tracing(
    name="time_trend",
    physics="something changes over time",
    source="",
    needs=("time_s",),
    channels=STAND_LOADS,
    units={},
    missing=present,
    shapes=one_shape,
    columns=lambda frame, _: _time_trends(frame)[0],
    parameters=lambda _, __, c: {f"knot_{k}": float(x) for k, x in enumerate(c)},
    inverse=lambda _, p: ({}, np.array(list(p.values()))),
    refuse=lambda _: None,
    cause=lambda frame, _, __: ("time_s", frame.time_s),
)
