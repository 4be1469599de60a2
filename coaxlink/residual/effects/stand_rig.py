"""What the rig itself does: drifting cells, a stand that remembers where it came from, a lying tachometer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from coaxlink.residual.effects.base import Array, Effect, Shape, outside
from coaxlink.residual.frames import STAND_LOADS, StandFrame

FAST_S = 0.3  # rows slower than that are settled
MEMORIES = (0.1, 0.3)  # of the run: time constants of a drift that settles
SIDES = {"upper": 0, "lower": 1}


def _drift_shapes(frame: StandFrame) -> Sequence[Shape]:
    forms: list[dict[str, float]] = [{}, *({"memory": m} for m in MEMORIES)]
    return [{"channel": float(c), **form} for c in frame.present if c < 4 for form in forms]


def _drift_columns(frame: StandFrame, shape: Shape) -> Array:
    elapsed = frame.time_s - frame.time_s[0]
    span = max(float(elapsed[-1]), 1e-9)
    course = elapsed / 60.0
    if "memory" in shape:
        memory = shape["memory"] * span
        course = memory / 60.0 * (1.0 - np.exp(-elapsed / memory))
    # the base may hold no constant: the zero at the start comes with the drift
    out = np.zeros((len(elapsed), 6, 2))
    out[:, int(shape["channel"]), 0], out[:, int(shape["channel"]), 1] = course, 1.0
    return out


def _no_clock(frame: StandFrame) -> str | None:
    if frame.context("time_s") is None:
        return "time_s is not in the log: the order of rows is the order of a sweep"
    return None if frame.time_s[-1] > frame.time_s[0] else "time_s does not run"


SENSOR_DRIFT: Effect[StandFrame] = Effect(
    name="sensor_drift",
    stage=8,
    physics="a load cell's zero wanders with time",
    source="creep and warm-up of strain gauges",
    needs=("time_s",),
    channels=STAND_LOADS,
    units={"channel": "1", "per_minute": "N or N m", "zero": "N or N m", "memory": "1"},
    missing=_no_clock,
    shapes=_drift_shapes,
    columns=_drift_columns,
    parameters=lambda _, shape, c: {**shape, "per_minute": float(c[0]), "zero": float(c[1])},
    inverse=lambda _, p: (
        {k: v for k, v in p.items() if k not in ("per_minute", "zero")},
        np.array([p["per_minute"], p["zero"]]),
    ),
    refuse=lambda p: None,
    cause=lambda frame, _, __: ("time_s", frame.time_s),
)


def direction(frame: StandFrame, side: int) -> Array:
    """(rows,) +1 where the speed last rose, -1 where it last fell, 0 before it moved or where it jumped."""
    u = frame.speeds[:, side] if frame.throttles is None else frame.throttles[:, side]
    step = np.diff(u, prepend=u[0])
    moved = np.where(np.abs(step) > 1e-3, np.sign(step), 0.0)
    last = np.maximum.accumulate(np.where(moved != 0.0, np.arange(len(u)), 0))
    return moved[last]


def _no_return(frame: StandFrame) -> str | None:
    for side in (0, 1):
        way = direction(frame, side)
        if min(np.mean(way > 0), np.mean(way < 0)) > 0.2:
            return None
    return "no sweep runs both up and down"


def moving(frame: StandFrame, side: int) -> Array:
    """(rows,) +1 while the speed rises, -1 while it falls, 0 while it stands."""
    u = frame.speeds[:, side] if frame.throttles is None else frame.throttles[:, side]
    rate = np.gradient(u)
    return np.where(np.abs(rate) > 1e-3, np.sign(rate), 0.0)


def _way(frame: StandFrame, side: int, shape: Shape) -> Array:
    if "sweep" in shape:  # the stand as a whole is loaded or unloaded, whichever rotor does it
        both = frame.speeds if frame.throttles is None else frame.throttles
        rate = np.gradient(both.sum(axis=1))
        way = np.where(np.abs(rate) > 1e-3, np.sign(rate), 0.0)
        if "moving" in shape:
            return way
        last = np.maximum.accumulate(np.where(way != 0.0, np.arange(len(way)), 0))
        return way[last]
    return moving(frame, side) if "moving" in shape else direction(frame, side)


def _way_columns(frame: StandFrame, shape: Shape) -> Array:
    out = np.zeros((len(frame.time_s), 6, 2))
    for name, side in SIDES.items():
        if name in shape or "both" in shape or "sweep" in shape:
            way = 0.5 * _way(frame, side, shape)
            u = frame.speeds[:, side]
            weight = frame.predicted[:, 2 * side : 2 * side + 2]
            if "bulge" in shape:
                weight = weight * (4.0 * np.clip(1.0 - u, 0.0, 1.0))[:, None]
            out[:, 2 * side, 0] = -weight[:, 0] * way
            out[:, 2 * side + 1, 1] = -weight[:, 1] * way
    return out


HYSTERESIS: Effect[StandFrame] = Effect(
    name="hysteresis",
    stage=7,
    physics="a load depends on whether the speed came from above or below",
    source="friction of the rig and stall of the blades on the way down",
    needs=("upper_rpm", "lower_rpm"),
    channels=STAND_LOADS,
    units={
        "thrust_share": "1",
        "torque_share": "1",
        "both": "1",
        "upper": "1",
        "lower": "1",
        "bulge": "1",
        "moving": "1",
    },
    missing=_no_return,
    shapes=lambda _: [
        {side: 1.0, **form}
        for side in ("both", "upper", "lower", "sweep")
        for form in ({}, {"bulge": 1.0}, {"moving": 1.0})
    ],
    columns=_way_columns,
    parameters=lambda _, shape, c: {"thrust_share": float(c[0]), "torque_share": float(c[1]), **shape},
    inverse=lambda _, p: (
        {k: v for k, v in p.items() if not k.endswith("share")},
        np.array([p["thrust_share"], p["torque_share"]]),
    ),
    refuse=lambda p: outside("thrust_share", p["thrust_share"], -0.5, 0.5),
    cause=lambda frame, _, channel: (
        "direction of the sweep",
        direction(frame, 1 if channel.startswith("lower") else 0),
    ),
)


def _tachometer_columns(side: int, frame: StandFrame, shape: Shape) -> Array:
    """A reading too high by a share: the loads are those of a slower rotor, the speed channel reads high."""
    u = frame.speeds[:, side]
    out = np.zeros((len(u), 6, 1))
    out[:, :4, 0] = -frame.slope[:, :, side] * (u * (u > shape["above"]))[:, None]
    if frame.throttles is not None:
        throttle = frame.throttles[:, side]  # not the reading itself: it would explain its own noise
        out[:, 4 + side, 0] = throttle * (throttle > shape["above"])
    return out


def _tachometer(name: str) -> Effect[StandFrame]:
    side = SIDES[name]

    def columns(frame: StandFrame, shape: Shape) -> Array:
        return _tachometer_columns(side, frame, shape)

    def refuse(p: Mapping[str, float]) -> str | None:
        return outside("reads_high_by", p["reads_high_by"], -0.8, 3.0)

    return Effect(
        name=f"lying_tachometer_{name}",
        physics="the tachometer shows another speed than the loads and the throttle agree on",
        source="tachometer",
        needs=(f"{name}_rpm",),
        channels=(*STAND_LOADS, f"{name}_speed"),
        units={"reads_high_by": "1", "above": "1"},
        missing=lambda frame: "speeds are throttles" if frame.driven else None,
        shapes=lambda _: [{"above": a} for a in (0.3, 0.4, 0.5, 0.6, 0.7)],
        columns=columns,
        parameters=lambda _, shape, c: {"reads_high_by": float(c[0]), **shape},
        inverse=lambda _, p: ({"above": p["above"]}, np.array([p["reads_high_by"]])),
        refuse=refuse,
        cause=lambda frame, _, __: (f"{name}_speed", frame.speeds[:, side]),
        accused=f"{name}_rpm",
    )


TACHOMETERS = (_tachometer("upper"), _tachometer("lower"))


def _reaction(frame: StandFrame, shape: Shape) -> Array:
    step = float(np.median(np.diff(frame.time_s)))
    turning = np.gradient(frame.speeds, step, axis=0) * frame.model.speed_max_rpm * np.pi / 30.0
    out = np.zeros((len(frame.time_s), 6, 1))
    out[:, 1, 0], out[:, 3, 0] = turning[:, 0], turning[:, 1]
    return out


def _slow(frame: StandFrame) -> str | None:
    step = float(np.median(np.diff(frame.time_s))) if len(frame.time_s) > 2 else np.inf
    if frame.driven:
        return "the log has no rpm: how fast the rotor speeds up is not known"
    return None if 0.0 < step < FAST_S else f"rows are {step:.1f} s apart: speeds do not change within them"


INERTIA: Effect[StandFrame] = Effect(
    name="rotor_inertia_torque",
    stage=7,
    physics="speeding the rotor up takes torque, which the torque cell reads too: J dOmega/dt",
    source="balance of angular momentum (Bouabdallah 2007)",
    needs=("time_s", "upper_rpm"),
    channels=("upper_torque", "lower_torque"),
    units={"rotor_inertia_kg_m2": "kg m2"},
    missing=_slow,
    shapes=lambda _: [{}],
    columns=_reaction,
    parameters=lambda _, __, c: {"rotor_inertia_kg_m2": float(c[0])},
    inverse=lambda _, p: ({}, np.array([p["rotor_inertia_kg_m2"]])),
    refuse=lambda p: outside("rotor_inertia_kg_m2", p["rotor_inertia_kg_m2"], 1e-8, 0.05, "kg m2"),
    cause=lambda frame, _, channel: (
        "speed_rate_1_s",
        np.gradient(frame.speeds[:, 1 if channel.startswith("lower") else 0], frame.time_s),
    ),
)
