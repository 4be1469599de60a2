"""Sensor drift: a load cell's zero wanders with time.

Source: creep (a power of time, Findley 1944) and warm-up of strain gauges.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from coaxlink.effects.base import Parameter, PhysicalEffect, Stage
from coaxlink.effects.tracing import Array, Shape, Tracing
from coaxlink.frames import STAND_LOADS, StandFrame

MEMORIES = (0.1, 0.3)  # of the run: time constants of a drift that settles
FREE = {
    "memory": (0.01, 4.0),
    "since": (0.02, 0.9),
    "power": (0.2, 3.0),
    "cycles": (0.5, 12.0),
    "phase": (-0.5, 1.0),
    "slope": (-3.0, 3.0),
}
# a room that is heated in turns: a run sees some of them; from less than a quarter off a step finds it
CYCLES, PHASES = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0), (0.0, 0.125, 0.25, 0.375)
BEGINNINGS = (0.2, 0.5)  # of the run
DRIFT = ("per_minute", "zero", "settling_per_minute")
ALSO, SPAN = "also_", "span_per_minute"
ROOM, ROOM_SPAN = "drift", "span"
CELLS = {f"cell{n}_{kind}": n for n in range(4) for kind in (ROOM, "zero", ROOM_SPAN)}
PAUSE, PAUSE_S = 20.0, 30.0  # times the usual step, and seconds: a stand that is started anew is tared


def _drift_shapes(frame: StandFrame) -> Sequence[Shape]:
    forms: list[dict[str, float]] = [{}, *({"memory": m} for m in MEMORIES)]
    if np.any(_pauses(frame)):
        forms += [{**form, "tared": 1.0} for form in forms]
    return [{"channel": float(c), **form} for c in frame.present if c < 4 for form in forms]


def amplifier_shapes(frame: StandFrame) -> Sequence[Shape]:
    """One amplifier or supply of all cells whose factor warms up: every load by the same share."""
    forms: list[dict[str, float]] = [{}, *({"memory": m} for m in MEMORIES)]
    if np.any(_pauses(frame)):
        forms += [{**form, "tared": 1.0} for form in forms]
    return [{"amplifier": 1.0, **form} for form in forms]


def room_shapes(frame: StandFrame) -> Sequence[Shape]:
    """One room about all cells: their zeros follow one trend, each by a number of its own.

    A cell's zero goes with its temperature (OIML R 60: so much of a division in 5 K), and four cells of one
    stand stand in one room, which is heated once or in turns.
    """
    forms: list[dict[str, float]] = [{}, {"power": 0.5}, *({"memory": m} for m in MEMORIES)]
    if np.any(_pauses(frame)):
        forms += [{**form, "tared": 1.0} for form in forms]
    forms += [{"cycles": c, "phase": p, "slope": 0.0} for c in CYCLES for p in PHASES]
    return [{"room": float(sum(c < 4 for c in frame.present)), **form} for form in forms]


def _pauses(frame: StandFrame) -> NDArray[np.bool_]:
    """(rows,) where a run begins anew behind a pause: there cells are tared."""
    step = np.diff(frame.time_s, prepend=frame.time_s[0])
    usual = max(float(np.median(step)), 1e-9)
    return np.asarray(step > np.maximum(PAUSE * usual, PAUSE_S))


def _elapsed(frame: StandFrame, shape: Shape) -> Array:
    """(rows,) seconds since the cells' zeros were set."""
    if "tared" not in shape:
        return frame.time_s - frame.time_s[0]
    rows = np.arange(len(frame.time_s))
    return frame.time_s - frame.time_s[np.maximum.accumulate(np.where(_pauses(frame), rows, 0))]


def _room_columns(frame: StandFrame, shape: Shape) -> Array:
    """(rows, 6, K): of every cell the room's trend, a zero and, with a `span`, the trend of its factor."""
    elapsed = _elapsed(frame, shape)
    along = elapsed / max(float(np.max(elapsed)), 1e-9)
    if "cycles" in shape:
        turns = shape["cycles"] * (along - 0.5) - shape["phase"]
        trend = np.cos(2.0 * np.pi * turns) + shape["slope"] * along
    elif "memory" in shape:
        trend = -np.expm1(-along / shape["memory"])
    else:
        trend = along ** shape.get("power", 1.0)
    cells = [c for c in frame.present if c < 4]
    each = 3 if "span" in shape else 2
    out = np.zeros((len(along), 6, each * len(cells)))
    for n, cell in enumerate(cells):
        out[:, cell, n * each] = trend
        out[:, cell, n * each + 1] = 1.0
        if "span" in shape:
            out[:, cell, n * each + 2] = trend * frame.predicted[:, cell]
    return out


def _drift_columns(frame: StandFrame, shape: Shape) -> Array:
    if "room" in shape:
        return _room_columns(frame, shape)
    elapsed = _elapsed(frame, shape)
    span = max(float(np.max(elapsed)), 1e-9)
    began = np.maximum(elapsed - shape.get("since", 0.0) * span, 0.0)
    trends = [span / 60.0 * (began / span) ** shape.get("power", 1.0)]
    if "memory" in shape:
        memory = shape["memory"] * span
        settling = memory / 60.0 * (1.0 - np.exp(-elapsed / memory))
        trends = [elapsed / 60.0, settling] if "creep" in shape else [settling]
    if "amplifier" in shape:
        out = np.zeros((len(elapsed), 6, 1))
        out[:, :4, 0] = trends[0][:, None] * frame.predicted[:, :4]
        return out
    # the nuisance model may hold no constant: the zero at the start comes with the drift
    cells = [int(shape[name]) for name in ("channel", "also") if name in shape]
    trends = [trends[0], np.ones(len(elapsed)), *trends[1:]]
    each = len(trends) + ("span" in shape)
    out = np.zeros((len(elapsed), 6, each * len(cells)))
    for n, cell in enumerate(cells):
        for k, trend in enumerate(trends):
            out[:, cell, n * each + k] = trend
        if "span" in shape:  # a gauge that warms up changes its factor with its zero
            out[:, cell, n * each + each - 1] = (
                trends[-1 if "creep" in shape else 0] * frame.predicted[:, cell]
            )
    return out


def _drift_variants(frame: StandFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    """A zero that drifts later, by a power of time, settles, or settles and creeps on; also in two cells."""
    forms: list[tuple[Shape, Array]] = []
    if "room" in shape:
        if "span" in shape:
            return []
        cells = np.reshape(c, (-1, 2))
        with_span = np.column_stack([cells, np.zeros(len(cells))]).ravel()
        trends: list[dict[str, float]] = [] if "cycles" in shape else [{"power": 0.6}, {"memory": 0.3}]
        bare = {k: v for k, v in shape.items() if k not in ("memory", "power")}
        forms += [({**bare, **way}, c) for way in trends if not set(way) & set(shape)]
        return [*forms, *(({**form, "span": 1.0}, with_span) for form, _ in [(shape, c), *forms])]
    if "amplifier" in shape:
        steady = {k: v for k, v in shape.items() if k not in ("memory", "power")}
        ways = ({"memory": 0.1}, {"memory": 0.3}, {"power": 0.6})
        return [({**steady, **way}, c) for way in ways if set(way) - set(shape)]
    cells = np.reshape(c, (2 if "also" in shape else 1, -1))
    if not {"creep", "since", "power", "span"} & set(shape):
        steady = {k: v for k, v in shape.items() if k != "memory"}
        forms += [({**steady, "since": s}, c) for s in BEGINNINGS]
        forms.append(({**steady, "power": 0.6}, c))
        memory = shape.get("memory", 0.3)
        if "memory" not in shape:
            forms.append(({**shape, "memory": memory}, c))
        first = np.column_stack([0.5 * cells[:, 0], cells[:, 1], 0.5 * cells[:, 0]]).ravel()
        forms += [({**shape, "memory": m, "creep": 1.0}, first) for m in (memory, 0.1)]
    if "span" not in shape:
        forms.append(({**shape, "span": 1.0}, np.column_stack([cells, np.zeros(len(cells))]).ravel()))
    if "also" not in shape:
        others = [k for k in frame.present if k < 4 and k != int(shape["channel"])]
        both = [(shape, c), *forms[-1:]]
        forms += [
            ({**form, "also": float(k)}, np.concatenate([x, 0.01 * x])) for form, x in both for k in others
        ]
    return forms


def _drift_names(shape: Shape) -> tuple[str, ...]:
    if "room" in shape:
        kinds = (ROOM, "zero", ROOM_SPAN) if "span" in shape else (ROOM, "zero")
        return tuple(f"cell{n}_{kind}" for n in range(round(shape["room"])) for kind in kinds)
    if "amplifier" in shape:
        return (SPAN,)
    names = DRIFT if "creep" in shape else DRIFT[:2]
    names = (*names, SPAN) if "span" in shape else names
    return (*names, *(ALSO + n for n in names)) if "also" in shape else names


def _drift_inverse(_: StandFrame, p: Mapping[str, float]) -> tuple[Shape, Array]:
    shape = {k: v for k, v in p.items() if k.removeprefix(ALSO) not in (*DRIFT, SPAN) and k not in CELLS}
    return shape, np.array([p[name] for name in _drift_names(shape)])


def _drift_carried(shape: Shape) -> tuple[int, ...]:
    return tuple(k for k, name in enumerate(_drift_names(shape)) if name.endswith("zero"))


def _no_clock(frame: StandFrame) -> str | None:
    if frame.context("time_s") is None:
        return "time_s is not in the log: the order of rows is the order of a sweep"
    return None if frame.time_s[-1] > frame.time_s[0] else "time_s does not run"


STAND: Tracing[StandFrame] = Tracing(
    name="sensor_drift",
    stage=8,
    physics="a load cell's zero wanders with time, its factor may with it",
    source="creep (a power of time, Findley 1944) and warm-up of strain gauges",
    needs=("time_s",),
    channels=STAND_LOADS,
    units={
        "channel": "1",
        "also": "1",
        "memory": "1",
        "creep": "1",
        "since": "1",
        "power": "1",
        "tared": "1",
        "span": "1",
        "amplifier": "1",
        "room": "1",
        "cycles": "1",
        "phase": "1",
        "slope": "1",
        SPAN: "1/min",
        ALSO + SPAN: "1/min",
    }
    | {before + name: "N or N m" for name in DRIFT for before in ("", ALSO)}
    | {name: "1" if name.endswith(ROOM_SPAN) else "N or N m" for name in CELLS},
    missing=_no_clock,
    shapes=lambda frame: [*_drift_shapes(frame), *amplifier_shapes(frame), *room_shapes(frame)],
    columns=_drift_columns,
    parameters=lambda _, shape, c: {**shape, **dict(zip(_drift_names(shape), map(float, c), strict=True))},
    inverse=_drift_inverse,
    refuse=lambda p: None,
    cause=lambda frame, _, __: ("time_s", frame.time_s),
    free=lambda _, shape: {k: limits for k, limits in FREE.items() if k in shape},
    variants=_drift_variants,
    carried=_drift_carried,
)


_OF_THE_STAND = "a property of the stand's cells, not of the rotors"
EFFECT = PhysicalEffect(
    name="sensor_drift",
    stage=Stage.INSTRUMENT,
    parameters=(
        *(
            Parameter(before + name, "N or N m", -1e4, 1e4,
                source="wide: any value between the bounds; creep and warm-up go with a cell's range and "
                       "class")
            for name in DRIFT
            for before in ("", ALSO)
        ),
        Parameter("channel", "1", 0.0, 3.0,
            source="a number of the stand's loads (0 upper thrust ... 3 lower torque), each as likely"),
        Parameter("also", "1", 0.0, 3.0,
            source="a number of the stand's loads (0 upper thrust ... 3 lower torque), each as likely"),
        Parameter("memory", "1", *FREE["memory"],
            source="wide: any value between the bounds; cells warm up in minutes, runs last from seconds "
                   "to hours"),
        Parameter("creep", "1", 0.0, 1.0, source="a switch, 0 or 1: it settles and creeps on"),
        Parameter("since", "1", *FREE["since"],
            source="wide: any value between the bounds; the share of the run after which it began"),
        Parameter("power", "1", *FREE["power"],
            source="wide: any value between the bounds; creep goes with a power of time (Findley 1944), "
                   "warm-up steeper at first"),
        *(
            Parameter(before + SPAN, "1/min", -10.0, 10.0,
                source="wide: any value between the bounds; a cell's factor warms up with its zero")
            for before in ("", ALSO)
        ),
        Parameter("tared", "1", 0.0, 1.0, source="a switch, 0 or 1: its zero is set at every start"),
        Parameter("span", "1", 0.0, 1.0, source="a switch, 0 or 1: its factor drifts with its zero"),
        *(
            Parameter(name, "1" if name.endswith(ROOM_SPAN) else "N or N m", -1e4, 1e4,
                source="wide: any value between the bounds; how a cell answers its room's temperature goes "
                       "with its range and class")
            for name in CELLS
        ),
        Parameter("room", "1", 0.0, 4.0,
            source="a number of the stand's cells (one to four), whose zeros all follow the room"),
        Parameter("cycles", "1", *FREE["cycles"],
            source="wide: any value between the bounds; times that a room was heated while the run lasted"),
        Parameter("phase", "1", *FREE["phase"],
            source="wide: any value between the bounds; where in its turn the heating was in mid-run"),
        Parameter("slope", "1", *FREE["slope"],
            source="wide: any value between the bounds; a room that warms up besides"),
        Parameter("amplifier", "1", 0.0, 1.0, source="a switch, 0 or 1: the factor of all cells drifts"),
    ),
    stand=STAND,
    no_static=_OF_THE_STAND,
    no_live=_OF_THE_STAND,
)  # fmt: skip
