"""Dead band: below a throttle the motor does not turn.

Source: speed controllers' start threshold. Above the band the command is the speed, or the scale is
stretched from the band on, or curved as idling power is taken off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.drive import changed_by, drivable, drive
from coaxlink.effects.static import LeftOut, StaticVehicle
from coaxlink.effects.tracing import Array, Shape, Tracing, outside
from coaxlink.frames import STAND_CHANNELS, StandFrame

AT_REST, TREMOR = 0.05, 0.005  # of the throttle; of normalised speed: no more is no turning
BANDS = (0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1, 0.13, 0.16, 0.2)
BEND = (1.0, 12.0)


def turned(p: Numbers, command: Array) -> Array:
    """Speeds of commands, the band taken off whole."""
    u, band = np.maximum(command, 0.0), p["band"]
    if "bend" in p:
        return np.asarray(np.maximum(u ** p["bend"] - band ** p["bend"], 0.0) ** (1.0 / p["bend"]))
    if "stretched" in p:
        return np.asarray(np.maximum(u - band, 0.0) / (1.0 - band))
    return np.where(u < band, 0.0, u)


# Starts and bounds of the fit, judgement: play and stiction of a mounted cell, of the largest load. They let
# go at once: what sets in over several bands (a knee below 4) is how the pair itself bends at low speed
CELL_BANDS, KNEES = (0.01, 0.02, 0.04, 0.08), (6.0, 9.0)
CELLS = {"band": (0.003, 0.25), "knee": (4.0, 12.0), "torque": (0.2, 5.0)}


def cell_shapes(frame: StandFrame) -> Sequence[Shape]:
    """Cells with play or stiction: of a small force they read nothing, of a large one as much less.

    Or one that tracks its zero, as scales do: it shows none of a small force, and all of a large one.
    """
    play: list[Shape] = [
        {"cells": 1.0, "band": b, "knee": k, **which}
        for b in CELL_BANDS
        for k in KNEES
        for which in ({"torque": 1.0}, {"only": 0.0}, {"only": 1.0})
    ]
    loads = [float(c) for c in frame.present if c < 4]
    return play + [{"cells": 1.0, "band": b, "knee": 6.0, "tracks": c} for b in CELL_BANDS for c in loads]


def of_what_is_logged(frame: StandFrame, effect: Tracing[StandFrame]) -> Tracing[StandFrame]:
    """The effect; its cells alone for a log without throttles: what no motor can be judged by, a cell can."""
    if effect.name != "dead_band" or effect.missing(frame) is None:
        return effect
    return replace(effect, shapes=cell_shapes, missing=lambda _: None, stage=8)


def _unread(frame: StandFrame, shape: Shape) -> Array:
    """(rows, 6) what cells do not read: all of a small load, and no more than the band of a large one.

    The band is a share of what the larger of both rotors' loads is; cells of one kind have one.
    """
    out = np.zeros((len(frame.time_s), 6))
    if "tracks" in shape:
        load = int(shape["tracks"])
        over = np.abs(frame.predicted[:, load]) / (frame.reference[load] * shape["band"])
        out[:, load] = -frame.predicted[:, load] / (1.0 + over ** shape["knee"])
        return out
    for load in range(4):
        if load % 2 != shape.get("only", load % 2):
            continue
        full = max(frame.reference[load], frame.reference[(load + 2) % 4])
        band = full * shape["band"] * (shape.get("torque", 1.0) if load % 2 else 1.0)
        over = frame.predicted[:, load] / band
        out[:, load] = -band * over / (1.0 + np.abs(over) ** shape["knee"]) ** (1.0 / shape["knee"])
    return out


def _dead_columns(frame: StandFrame, shape: Shape) -> Array:
    if "cells" in shape:
        return _unread(frame, shape)[..., None]
    return changed_by(frame, _dead(frame, shape))[..., None]


def _dead(frame: StandFrame, shape: Shape) -> Array:
    """(rows, 2) speeds: none, then as the throttle says; all stretched; or idling taken off.

    With a `start` a rotor at rest waits for that throttle, and then turns until the band stops it.
    """
    u, band = drive(frame), shape["band"]
    if "start" in shape:
        running = _running(u, band, shape["start"])
        return np.where(running, _dead(frame, {k: v for k, v in shape.items() if k != "start"}), 0.0)
    return turned(shape, u)


def _running(u: Array, band: float, start: float) -> Array:
    """(rows, 2) whether rotors turn that start above one throttle and stop below another."""
    row = np.arange(len(u))[:, None]
    started = np.maximum.accumulate(np.where(u > start, row, -1), axis=0)
    stopped = np.maximum.accumulate(np.where(u <= band, row, -1), axis=0)
    return np.asarray(started > stopped)


def _dead_apply(frame: StandFrame, parameters: Mapping[str, float]) -> StandFrame:
    """The frame with its rotors at rest below the band, where a supply or a warm winding changes nothing.

    What these take off on the average stays in: it is the scale of the throttle, which the nuisance has too.
    """
    shape, c = STAND.inverse(frame, parameters)
    predicted = frame.predicted + STAND.columns(frame, shape) @ c
    if not frame.driven and "cells" not in shape:
        u = drive(frame)
        stands = _dead(frame, shape) <= 0.0
        for side in (0, 1):
            rest, turns = stands[:, side] & (u[:, side] > 0.0), ~stands[:, side]
            if rest.any() and turns.any():
                usual = float(np.mean(frame.predicted[turns, 4 + side] / u[turns, side]))
                predicted[rest, 4 + side] = (usual - c[0]) * u[rest, side]
    return replace(frame, predicted=predicted)


def _entered(frame: StandFrame) -> float:
    """The lowest throttle that a rotor was given: of a band below it these rows show nothing."""
    u = drive(frame)[frame.keep]
    return float(np.min(u[u > 0.0], initial=1.0))


def _no_low(frame: StandFrame) -> str | None:
    return None if float(np.mean(drive(frame) < 0.2)) > 0.01 else "no rows at low throttle"


def _dead_shapes(frame: StandFrame) -> Sequence[Shape]:
    # where no row is low, a band shows only if it stretches the whole scale
    forms: list[Shape] = [{"stretched": 1.0}] if _no_low(frame) else [{}, {"stretched": 1.0}, {"bend": 2.0}]
    seen = _entered(frame)
    return [{"band": b, **form} for b in BANDS for form in forms if b > seen or "stretched" in form]


def _dead_free(frame: StandFrame, shape: Shape) -> Mapping[str, tuple[float, float]]:
    if "cells" in shape:
        return {name: limits for name, limits in CELLS.items() if name in shape}
    # a start threshold stands between two set-points: nothing continuous to move
    if "bend" in shape:
        return {"band": (min(max(0.005, _entered(frame)), 0.39), 0.4), "bend": BEND}
    return {"band": (0.005, 0.4)} if "stretched" in shape else {}


def _start(frame: StandFrame) -> tuple[float, float] | None:
    """The highest throttle that leaves a rotor at rest, and the lowest that turns one."""
    sides = [c - 4 for c in frame.present if c > 3]
    if frame.driven or not sides:
        return None
    u, speed = drive(frame)[:, sides], frame.measured[:, [4 + s for s in sides]]
    turning = speed >= np.maximum(AT_REST * u, TREMOR)
    rests, turns = ~turning & (u > 0.0), turning & (u > 0.0)
    if not rests.any() or not turns.any():
        return None
    return float(np.max(u[rests])), float(np.min(u[turns]))


def _dead_variants(frame: StandFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    if "cells" in shape:
        return []
    bare, observed = {"band": shape["band"]}, _start(frame)
    forms: list[tuple[Shape, Array]] = []
    if observed is not None:
        rests, turns = observed
        forms.append(({"band": 0.5 * (rests + turns)}, np.ones(1)))
        if "bend" in shape:  # it begins below the lowest that turns, and steeply
            forms.append(({"band": 0.99 * turns, "bend": shape["bend"]}, c))
        if rests > turns:  # at one throttle it stands or turns, as it came there
            late = {"band": min(shape["band"], turns), "start": rests + 1e-6}
            forms += [({**late, **form}, c) for form in ({"stretched": 1.0}, {"bend": 1.5}, {})]
    if "bend" not in shape and shape["band"] > _entered(frame):
        forms += [({**bare, "bend": b}, c) for b in (1.5, 3.0)]
    return [form for form in forms if form[0] != shape]


STAND: Tracing[StandFrame] = Tracing(
    name="dead_band",
    stage=2,
    physics="below a throttle the motor does not turn",
    source="speed controllers' start threshold",
    needs=("upper_throttle",),
    channels=STAND_CHANNELS,
    units={
        "band": "1",
        "share": "1",
        "stretched": "1",
        "bend": "1",
        "start": "1",
        "cells": "1",
        "knee": "1",
        "tracks": "1",
        "only": "1",
        "torque": "1",
    },
    missing=drivable,
    shapes=lambda frame: [*_dead_shapes(frame), *cell_shapes(frame)],
    columns=_dead_columns,
    parameters=lambda _, shape, c: {**shape, "share": float(c[0])},
    inverse=lambda _, p: ({k: v for k, v in p.items() if k != "share"}, np.array([p["share"]])),
    refuse=lambda p: outside("share", p["share"], 0.6, 1.5),
    cause=lambda frame, _, channel: (
        "throttle",
        drive(frame)[:, 1 if channel.startswith("lower") else 0],
    ),
    apply=_dead_apply,
    free=_dead_free,
    variants=_dead_variants,
)


def _static(vehicle: StaticVehicle, p: Numbers) -> str:
    if "cells" in p:
        raise LeftOut(_OF_THE_CELLS)
    if not {"stretched", "bend"} & set(p):  # above the band the command is the speed
        raise LeftOut(_BELOW)
    share = p.get("share", 1.0)

    def speed_of(command: Array) -> Array:
        return np.asarray(np.maximum(command + share * (turned(p, command) - command), 0.0))

    vehicle.turn_at(speed_of)
    half = float(speed_of(np.array(0.5)))
    return f"commands count from {p['band']:g} on, where motors start: at 0.5 they turn at {half:.3f}"


_BELOW = (
    "no mixer turns a motor below its start: raise the outputs' minimum to the band "
    "(PWM_MAIN_MINn, MOT_SPIN_MIN)"
)
_OF_THE_CELLS = "a property of the stand's cells, not of the rotors"
EFFECT = PhysicalEffect(
    name="dead_band",
    stage=Stage.DRIVE,
    parameters=(
        Parameter("band", "1", 0.0, 0.99, (0.05, 0.05),
            source="assumed: speed controllers start a motor within the first tenth of the throttle"),
        Parameter("share", "1", 0.6, 1.5, (1.0, 0.1),
            source="1 by definition, the whole of the band; 0.1 is assumed for rows whose rotor was just "
                   "starting"),
        Parameter("stretched", "1", 0.0, 1.0, source="a switch, 0 or 1: the scale begins at the band's end"),
        Parameter("bend", "1", 1e-3, 100.0,
            source="wide: any value between the bounds; how idling power is taken off goes with the "
                   "controller's firmware"),
        Parameter("start", "1", 0.0, 1.0,
            source="wide: any value between the bounds; where a motor starts goes with its load and its "
                   "controller"),
        Parameter("cells", "1", 0.0, 1.0, source="a switch, 0 or 1: load cells, not motors, have the band"),
        Parameter("knee", "1", *CELLS["knee"],
            source="wide: any value between the bounds; how sharply play or stiction ends goes with "
                   "the mount"),
        Parameter("only", "1", 0.0, 1.0,
            source="a switch, 0 or 1: the two thrust cells alone have the band, or the two torque cells"),
        Parameter("tracks", "1", 0.0, 3.0,
            source="a number of a load, 0 to 3: its cell shows none of a small force, and all of a large "
                   "one (zero tracking, OIML R 76-1)"),
        Parameter("torque", "1", *CELLS["torque"],
            source="wide: any value between the bounds; torque cells and thrust cells are of two kinds"),
    ),
    stand=STAND,
    static=_static,
    required=("band",),
    surface=3,
    no_static=_BELOW,
    no_live=_BELOW,
)  # fmt: skip
