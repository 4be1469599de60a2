"""Sensor drift: a load cell's zero wanders with time.

Source: creep (a power of time, Findley 1944) and warm-up of strain gauges.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.tracing import Array, NotShown, Tracing
from coaxlink.frames import STAND_LOADS, StandFrame

MEMORIES = (0.1, 0.3)  # of the run: time constants of a drift that settles
# a room that is heated in turns: a run sees some of them; from less than a quarter off a step finds it
CYCLES, PHASES = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0), (0.0, 0.125, 0.25, 0.375)
BEGINNINGS = (0.2, 0.5)  # of the run
ALSO, SETTLING, SPAN = "also_", "settling_per_minute", "span_per_minute"
DRIFT = ("per_minute", "zero", SETTLING, SPAN)
ROOM, ROOM_SPAN = "drift", "span"
REST, SWEPT = 0.05, 0.2  # of full speed: rests are no level; less is one level
BACK = 0.1  # of a speed's range, judgement: less of a way back is no level that was come to again
PAUSE, PAUSE_S = 20.0, 30.0  # times the usual step, and seconds: a stand that is started anew is tared


def _starts(frame: StandFrame) -> Sequence[Numbers]:
    """One cell's zero; the factor of an amplifier or supply of all, every load by the same share; a room.

    A cell's zero goes with its temperature (OIML R 60: so much of a division in 5 K), and four cells of one
    stand stand in one room, which is heated once or in turns: their zeros follow one trend, each by its own.
    """
    if why := _no_clock(frame) or _one_way(frame):
        raise NotShown(why)
    cells = [c for c in frame.present if c < 4]
    ways = _tared(frame, [{}, *({"memory": m} for m in MEMORIES)])
    rooms = _tared(frame, [{}, {"power": 0.5}, *({"memory": m} for m in MEMORIES)])
    rooms += [{"cycles": c, "phase": p, "slope": 0.0} for c in CYCLES for p in PHASES]
    each = {f"cell{n}_{kind}": 0.0 for n in range(len(cells)) for kind in (ROOM, "zero")}
    return [
        *({"channel": float(c), "per_minute": 0.0, "zero": 0.0, **way} for c in cells for way in ways),
        *({SPAN: 0.0, **way} for way in ways),
        *({**each, **way} for way in rooms if each),
    ]


def _tared(frame: StandFrame, ways: list[Numbers]) -> list[Numbers]:
    """The ways, and where the run had pauses the same of a stand that is tared behind each."""
    return ways + [{**way, "tared": 1.0} for way in ways] if np.any(_pauses(frame)) else ways


def _pauses(frame: StandFrame) -> NDArray[np.bool_]:
    """(rows,) where a run begins anew behind a pause: there cells are tared."""
    step = np.diff(frame.time_s, prepend=frame.time_s[0])
    usual = max(float(np.median(step)), 1e-9)
    return np.asarray(step > np.maximum(PAUSE * usual, PAUSE_S))


def _elapsed(frame: StandFrame, p: Numbers) -> Array:
    """(rows,) seconds since the cells' zeros were set."""
    if "tared" not in p:
        return frame.time_s - frame.time_s[0]
    rows = np.arange(len(frame.time_s))
    return frame.time_s - frame.time_s[np.maximum.accumulate(np.where(_pauses(frame), rows, 0))]


def _room(elapsed: Array, p: Numbers) -> Array:
    """(rows,) a room's trend, from 0 at the start of a run to about 1."""
    along = elapsed / max(float(np.max(elapsed)), 1e-9)
    if "cycles" in p:
        turns = p["cycles"] * (along - 0.5) - p["phase"]
        return np.asarray(np.cos(2.0 * np.pi * turns) + p["slope"] * along)
    if "memory" in p:
        return np.asarray(-np.expm1(-along / p["memory"]))
    return np.asarray(along ** p.get("power", 1.0))


def _trends(elapsed: Array, p: Numbers) -> tuple[Array, Array]:
    """(rows,) minutes of drift, and those of what settles beside it (the same where nothing does)."""
    span = max(float(np.max(elapsed)), 1e-9)
    if "memory" not in p:
        began = np.maximum(elapsed - p.get("since", 0.0) * span, 0.0)
        drift = span / 60.0 * (began / span) ** p.get("power", 1.0)
        return drift, drift
    memory = p["memory"] * span
    settling = memory / 60.0 * (1.0 - np.exp(-elapsed / memory))
    return (elapsed / 60.0 if SETTLING in p else settling), settling


def _adds(frame: StandFrame, p: Numbers) -> Array:
    elapsed, out = _elapsed(frame, p), np.zeros((len(frame.time_s), 6))
    if "cell0_zero" in p:
        trend = _room(elapsed, p)
        for n, cell in enumerate(c for c in frame.present if c < 4):
            out[:, cell] = p[f"cell{n}_{ROOM}"] * trend + p[f"cell{n}_zero"]
            out[:, cell] += p.get(f"cell{n}_{ROOM_SPAN}", 0.0) * trend * frame.predicted[:, cell]
        return out
    drift, settling = _trends(elapsed, p)
    if "channel" not in p:
        out[:, :4] = p[SPAN] * drift[:, None] * frame.predicted[:, :4]
        return out
    for name, before in (("channel", ""), ("also", ALSO)):
        if name in p:
            cell = int(p[name])
            # the nuisance model may hold no constant: the zero at the start comes with the drift
            out[:, cell] = p[before + "per_minute"] * drift + p[before + "zero"]
            out[:, cell] += p.get(before + SETTLING, 0.0) * settling
            # a gauge that warms up changes its factor with its zero
            out[:, cell] += p.get(before + SPAN, 0.0) * settling * frame.predicted[:, cell]
    return out


def _further(frame: StandFrame, p: Numbers) -> Sequence[Numbers]:
    """A zero that drifts later, by a power of time, settles, or settles and creeps on; also in two cells."""
    steady = {k: v for k, v in p.items() if k not in ("memory", "power")}
    forms: list[Numbers] = []
    if "cell0_zero" in p:
        if f"cell0_{ROOM_SPAN}" in p:
            return []
        ways: list[Numbers] = [] if "cycles" in p else [{"power": 0.6}, {"memory": 0.3}]
        forms = [{**steady, **way} for way in ways if not set(way) & set(p)]
        spans = {f"cell{n}_{ROOM_SPAN}": 0.0 for n in range(4) if f"cell{n}_zero" in p}
        return [*forms, *({**form, **spans} for form in [p, *forms])]
    if "channel" not in p:
        ways = [{"memory": 0.1}, {"memory": 0.3}, {"power": 0.6}]
        return [{**steady, **way} for way in ways if not set(way) & set(p)]
    befores = ("", ALSO) if "also" in p else ("",)
    if not {SETTLING, "since", "power", SPAN} & set(p):
        memory = p.get("memory", 0.3)
        forms += [{**steady, "since": s} for s in BEGINNINGS]
        forms.append({**steady, "power": 0.6})
        if "memory" not in p:
            forms.append({**p, "memory": memory})
        halves = {b + n: 0.5 * p[b + "per_minute"] for b in befores for n in ("per_minute", SETTLING)}
        forms += [{**p, **halves, "memory": m} for m in (memory, 0.1)]
    if SPAN not in p:
        forms.append({**p, **{b + SPAN: 0.0 for b in befores}})
    if "also" not in p:
        others = [k for k in frame.present if k < 4 and k != int(p["channel"])]
        forms += [
            {**form, "also": float(k), **{ALSO + n: 0.01 * form[n] for n in DRIFT if n in form}}
            for form in [p, *forms[-1:]]
            for k in others
        ]
    return forms


def _no_clock(frame: StandFrame) -> str | None:
    if frame.context("time_s") is None:
        return "time_s is not in the log: the order of rows is the order of a sweep"
    return None if frame.time_s[-1] > frame.time_s[0] else "time_s does not run"


def _one_way(frame: StandFrame) -> str | None:
    """Why a log without a model tells no drift from its map: a rotor went from one end to the other once."""
    path = frame.speeds if frame.throttles is None else frame.throttles
    for side, u in enumerate(path[frame.keep].T if frame.free_nuisance else ()):
        turning = u[u > REST]
        if len(turning) < 2 or np.ptp(turning) < SWEPT:
            continue
        back = min(np.max(np.maximum.accumulate(way) - way) for way in (turning, -turning))
        if back < BACK * np.ptp(turning):
            name = ("upper", "lower")[side]
            return f"the {name} rotor went through its speeds once, one way: run its levels out of order"
    return None


STAND: Tracing[StandFrame] = Tracing(
    needs=("time_s",),
    channels=STAND_LOADS,
    starts=_starts,
    further=_further,
    adds=_adds,
    cause=lambda frame, *_: ("time_s", frame.time_s),
)


_OF_THE_STAND = "a property of the stand's cells, not of the rotors"
EFFECT = PhysicalEffect(
    name="sensor_drift",
    stage=Stage.INSTRUMENT,
    physics="a load cell's zero wanders with time, its factor may with it",
    source="creep (a power of time, Findley 1944) and warm-up of strain gauges",
    parameters=(
        *(
            Parameter(before + name, "N or N m", -1e4, 1e4, amount=True,
                source="wide: any value between the bounds; creep and warm-up go with a cell's range and "
                       "class")
            for before in ("", ALSO)
            for name in DRIFT[:3]
        ),
        *(
            Parameter(before + SPAN, "1/min", -10.0, 10.0, amount=True,
                source="wide: any value between the bounds; a cell's factor warms up with its zero")
            for before in ("", ALSO)
        ),
        *(
            Parameter(f"cell{n}_{kind}", "1" if kind == ROOM_SPAN else "N or N m", -1e4, 1e4, amount=True,
                source="wide: any value between the bounds; how a cell answers its room's temperature goes "
                       "with its range and class")
            for n in range(4)
            for kind in (ROOM, "zero", ROOM_SPAN)
        ),
        *(
            Parameter(name, "1", 0.0, 3.0,
                source="a number of the stand's loads (0 upper thrust ... 3 lower torque), each as likely")
            for name in ("channel", "also")
        ),
        Parameter("memory", "1", 0.01, 4.0, moves=True,
            source="wide: any value between the bounds; cells warm up in minutes, runs last from seconds "
                   "to hours"),
        Parameter("since", "1", 0.02, 0.9, moves=True,
            source="wide: any value between the bounds; the share of the run after which it began"),
        Parameter("power", "1", 0.2, 3.0, moves=True,
            source="wide: any value between the bounds; creep goes with a power of time (Findley 1944), "
                   "warm-up steeper at first"),
        Parameter("cycles", "1", 0.5, 12.0, moves=True,
            source="wide: any value between the bounds; times that a room was heated while the run lasted"),
        Parameter("phase", "1", -0.5, 1.0, moves=True,
            source="wide: any value between the bounds; where in its turn the heating was in mid-run"),
        Parameter("slope", "1", -3.0, 3.0, moves=True,
            source="wide: any value between the bounds; a room that warms up besides"),
        Parameter("tared", "1", 0.0, 1.0, source="a switch, 0 or 1: its zero is set at every start"),
    ),
    stand=STAND,
    no_static=_OF_THE_STAND,
    no_live=_OF_THE_STAND,
)  # fmt: skip
