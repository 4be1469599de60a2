"""What the rig itself does: drifting cells, a lying tachometer, the reaction to a rotor that speeds up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from coaxlink.residual.effects.base import Array, Effect, Shape, outside
from coaxlink.residual.frames import STAND_LOADS, StandFrame

FAST_S = 0.3  # rows slower than that are settled
MEMORIES = (0.1, 0.3)  # of the run: time constants of a drift that settles
FREE = {"memory": (0.01, 4.0), "since": (0.02, 0.9), "power": (0.2, 3.0)}
BEGINNINGS = (0.2, 0.5)  # of the run
DRIFT = ("per_minute", "zero", "settling_per_minute")
ALSO = "also_"
ABOVE = tuple(0.05 * k for k in range(5, 17))  # of the full speed: from there on a tachometer lies
SIDES = {"upper": 0, "lower": 1}


def _drift_shapes(frame: StandFrame) -> Sequence[Shape]:
    forms: list[dict[str, float]] = [{}, *({"memory": m} for m in MEMORIES)]
    return [{"channel": float(c), **form} for c in frame.present if c < 4 for form in forms]


def _drift_columns(frame: StandFrame, shape: Shape) -> Array:
    elapsed = frame.time_s - frame.time_s[0]
    span = max(float(elapsed[-1]), 1e-9)
    began = np.maximum(elapsed - shape.get("since", 0.0) * span, 0.0)
    courses = [span / 60.0 * (began / span) ** shape.get("power", 1.0)]
    if "memory" in shape:
        memory = shape["memory"] * span
        settling = memory / 60.0 * (1.0 - np.exp(-elapsed / memory))
        courses = [elapsed / 60.0, settling] if "creep" in shape else [settling]
    # the base may hold no constant: the zero at the start comes with the drift
    cells = [int(shape[name]) for name in ("channel", "also") if name in shape]
    courses = [courses[0], np.ones(len(elapsed)), *courses[1:]]
    out = np.zeros((len(elapsed), 6, len(courses) * len(cells)))
    for n, cell in enumerate(cells):
        for k, course in enumerate(courses):
            out[:, cell, n * len(courses) + k] = course
    return out


def _drift_finer(frame: StandFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    """A zero that drifts later, by a power of time, settles, or settles and creeps on; also in two cells."""
    forms: list[tuple[Shape, Array]] = []
    if not {"creep", "since", "power"} & set(shape):
        steady = {k: v for k, v in shape.items() if k != "memory"}
        forms += [({**steady, "since": s}, c) for s in BEGINNINGS]
        forms.append(({**steady, "power": 0.6}, c))
        memory = shape.get("memory", 0.3)
        if "memory" not in shape:
            forms.append(({**shape, "memory": memory}, c))
        cells = np.reshape(c, (-1, 2))
        first = np.column_stack([0.5 * cells[:, 0], cells[:, 1], 0.5 * cells[:, 0]]).ravel()
        forms += [({**shape, "memory": m, "creep": 1.0}, first) for m in (memory, 0.1)]
    if "also" not in shape:
        others = [k for k in frame.present if k < 4 and k != int(shape["channel"])]
        both = [(shape, c), *forms[-1:]]
        forms += [
            ({**form, "also": float(k)}, np.concatenate([x, 0.01 * x])) for form, x in both for k in others
        ]
    return forms


def _drift_names(shape: Shape) -> tuple[str, ...]:
    names = DRIFT if "creep" in shape else DRIFT[:2]
    return (*names, *(ALSO + n for n in names)) if "also" in shape else names


def _drift_inverse(_: StandFrame, p: Mapping[str, float]) -> tuple[Shape, Array]:
    shape = {k: v for k, v in p.items() if k.removeprefix(ALSO) not in DRIFT}
    return shape, np.array([p[name] for name in _drift_names(shape)])


def _drift_carried(shape: Shape) -> tuple[int, ...]:
    return tuple(k for k, name in enumerate(_drift_names(shape)) if name.endswith("zero"))


def _no_clock(frame: StandFrame) -> str | None:
    if frame.context("time_s") is None:
        return "time_s is not in the log: the order of rows is the order of a sweep"
    return None if frame.time_s[-1] > frame.time_s[0] else "time_s does not run"


SENSOR_DRIFT: Effect[StandFrame] = Effect(
    name="sensor_drift",
    stage=8,
    physics="a load cell's zero wanders with time",
    source="creep (a power of time, Findley 1944) and warm-up of strain gauges",
    needs=("time_s",),
    channels=STAND_LOADS,
    units={"channel": "1", "also": "1", "memory": "1", "creep": "1", "since": "1", "power": "1"}
    | {before + name: "N or N m" for name in DRIFT for before in ("", ALSO)},
    missing=_no_clock,
    shapes=_drift_shapes,
    columns=_drift_columns,
    parameters=lambda _, shape, c: {**shape, **dict(zip(_drift_names(shape), map(float, c), strict=True))},
    inverse=_drift_inverse,
    refuse=lambda p: None,
    cause=lambda frame, _, __: ("time_s", frame.time_s),
    free=lambda _, shape: {k: limits for k, limits in FREE.items() if k in shape},
    finer=_drift_finer,
    carried=_drift_carried,
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


def _no_second_witness(frame: StandFrame) -> str | None:
    if frame.driven:
        return "speeds are throttles"
    return (
        "no throttle in the log: nothing but the loads could contradict it"
        if frame.throttles is None
        else None
    )


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
        missing=_no_second_witness,
        shapes=lambda _: [{"above": a} for a in ABOVE],
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
