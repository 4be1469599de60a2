"""Dead band: below a throttle the motor does not turn.

Source: speed controllers' start threshold. Above the band the command is the speed, or the scale is
stretched from the band on, or curved as idling power is taken off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.drive import changed_by, drivable, drive
from coaxlink.effects.parameter import Range
from coaxlink.effects.static import LeftOut, StaticVehicle
from coaxlink.effects.tracing import Array, Tracing
from coaxlink.frames import STAND_CHANNELS, StandFrame

AT_REST, TREMOR = 0.05, 0.005  # of the throttle; of normalised speed: no more is no turning
BANDS = (0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1, 0.13, 0.16, 0.2)


def turned(p: Numbers, command: Array) -> Array:
    """Speeds of commands, the band taken off whole."""
    u, band = np.maximum(command, 0.0), p["band"]
    if "bend" in p:
        return np.asarray(np.maximum(u ** p["bend"] - band ** p["bend"], 0.0) ** (1.0 / p["bend"]))
    if "stretched" in p:
        return np.asarray(np.maximum(u - band, 0.0) / (1.0 - band))
    return np.where(u < band, 0.0, u)


# Starts of the fit: play and stiction of a mounted cell, of the largest load. They let go at once: what sets
# in over several bands (a knee below 4) is how the pair itself bends at low speed
CELL_BANDS, KNEES = (0.01, 0.02, 0.04, 0.08), (6.0, 9.0)


def _cell_starts(frame: StandFrame) -> Sequence[Numbers]:
    """Cells with play or stiction: of a small force they read nothing, of a large one as much less.

    Or one that tracks its zero, as scales do: it shows none of a small force, and all of a large one.
    """
    cells = {"share": 1.0, "cells": 1.0}
    play: list[Numbers] = [
        {**cells, "band": b, "knee": k, **which}
        for b in CELL_BANDS
        for k in KNEES
        for which in ({"torque": 1.0}, {"only": 0.0}, {"only": 1.0})
    ]
    loads = [float(c) for c in frame.present if c < 4]
    return play + [{**cells, "band": b, "knee": 6.0, "tracks": c} for b in CELL_BANDS for c in loads]


def _unread(frame: StandFrame, p: Numbers) -> Array:
    """(rows, 6) what cells do not read: all of a small load, and no more than the band of a large one.

    The band is a share of what the larger of both rotors' loads is; cells of one kind have one.
    """
    out = np.zeros((len(frame.time_s), 6))
    if "tracks" in p:
        load = int(p["tracks"])
        over = np.abs(frame.predicted[:, load]) / (frame.reference[load] * p["band"])
        out[:, load] = -frame.predicted[:, load] / (1.0 + over ** p["knee"])
        return out
    for load in range(4):
        if load % 2 != p.get("only", load % 2):
            continue
        full = max(frame.reference[load], frame.reference[(load + 2) % 4])
        band = full * p["band"] * (p.get("torque", 1.0) if load % 2 else 1.0)
        over = frame.predicted[:, load] / band
        out[:, load] = -band * over / (1.0 + np.abs(over) ** p["knee"]) ** (1.0 / p["knee"])
    return out


def _dead(frame: StandFrame, p: Numbers) -> Array:
    """(rows, 2) speeds: none, then as the throttle says; all stretched; or idling taken off.

    With a `start` a rotor at rest waits for that throttle, and then turns until the band stops it.
    """
    u, band = drive(frame), p["band"]
    if "start" in p:
        running = _running(u, band, p["start"])
        return np.where(running, _dead(frame, {k: v for k, v in p.items() if k != "start"}), 0.0)
    return turned(p, u)


def _running(u: Array, band: float, start: float) -> Array:
    """(rows, 2) whether rotors turn that start above one throttle and stop below another."""
    row = np.arange(len(u))[:, None]
    started = np.maximum.accumulate(np.where(u > start, row, -1), axis=0)
    stopped = np.maximum.accumulate(np.where(u <= band, row, -1), axis=0)
    return np.asarray(started > stopped)


def _changes(frame: StandFrame, p: Numbers) -> StandFrame:
    """The frame with its rotors at rest below the band, where a supply or a warm winding changes nothing.

    What these take off on the average stays in: it is the scale of the throttle, which the nuisance has too.
    """
    if "cells" in p:
        return replace(frame, predicted=frame.predicted + p["share"] * _unread(frame, p))
    if drivable(frame):  # measured speeds have it in
        return frame
    speeds, u = _dead(frame, p), drive(frame)
    predicted = frame.predicted + p["share"] * changed_by(frame, speeds)
    if not frame.driven:
        stands = speeds <= 0.0
        for side in (0, 1):
            rest, turns = stands[:, side] & (u[:, side] > 0.0), ~stands[:, side]
            if rest.any() and turns.any():
                usual = float(np.mean(frame.predicted[turns, 4 + side] / u[turns, side]))
                predicted[rest, 4 + side] = (usual - p["share"]) * u[rest, side]
    return replace(frame, predicted=predicted)


def _entered(frame: StandFrame) -> float:
    """The lowest throttle that a rotor was given: of a band below it these rows show nothing."""
    u = drive(frame)[frame.keep]
    return float(np.min(u[u > 0.0], initial=1.0))


def _no_low(frame: StandFrame) -> str | None:
    return None if float(np.mean(drive(frame) < 0.2)) > 0.01 else "no rows at low throttle"


def _starts(frame: StandFrame) -> Sequence[Numbers]:
    """Of motors and of cells; without throttles cells alone, for then no motor can be judged."""
    motors = [] if drivable(frame) else _motor_starts(frame)
    return [*motors, *_cell_starts(frame)]


def _motor_starts(frame: StandFrame) -> Sequence[Numbers]:
    # where no row is low, a band shows only if it stretches the whole scale
    forms: list[Numbers] = [{"stretched": 1.0}] if _no_low(frame) else [{}, {"stretched": 1.0}, {"bend": 2.0}]
    seen = _entered(frame)
    return [
        {"share": 1.0, "band": b, **form} for b in BANDS for form in forms if b > seen or "stretched" in form
    ]


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


def _further(frame: StandFrame, p: Numbers) -> Sequence[Numbers]:
    if "cells" in p:
        return []
    bare, whole, observed = {"share": p["share"], "band": p["band"]}, {"share": 1.0}, _start(frame)
    forms: list[Numbers] = []
    if observed is not None:
        rests, turns = observed
        forms.append({**whole, "band": 0.5 * (rests + turns)})
        if "bend" in p:  # it begins below the lowest that turns, and steeply
            forms.append({**bare, "band": 0.99 * turns, "bend": p["bend"]})
        if rests > turns:  # at one throttle it stands or turns, as it came there
            late = {**bare, "band": min(p["band"], turns), "start": rests + 1e-6}
            forms += [{**late, **form} for form in ({"stretched": 1.0}, {"bend": 1.5}, {})]
    if "bend" not in p and p["band"] > _entered(frame):
        forms += [{**bare, "bend": b} for b in (1.5, 3.0)]
    return [form for form in forms if {**form, **whole} != {**p, **whole}]


def _band(frame: StandFrame | None, p: Numbers) -> Range:
    """Of a bend, within what throttles were given; of cells, which are finer."""
    if "cells" in p:
        return 0.003, 0.25
    if frame is None:
        return 0.0, 0.99
    return (min(max(0.005, _entered(frame)), 0.39) if "bend" in p else 0.005), 0.4


STAND: Tracing[StandFrame] = Tracing(
    needs=("upper_throttle",),
    channels=STAND_CHANNELS,
    starts=_starts,
    further=_further,
    changes=_changes,
    cause=lambda frame, _, channel: (
        "throttle",
        drive(frame)[:, 1 if channel.startswith("lower") else 0],
    ),
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
    place=2,
    physics="below a throttle the motor does not turn",
    source="speed controllers' start threshold",
    parameters=(
        # a start threshold stands between two set-points: nothing continuous to move
        Parameter("band", "1", 0.0, 0.99, (0.05, 0.05), moves=("stretched", "bend", "cells"), within=_band,
            source="assumed: speed controllers start a motor within the first tenth of the throttle"),
        Parameter("share", "1", 0.6, 1.5, (1.0, 0.1), amount=True,
            source="1 by definition, the whole of the band; 0.1 is assumed for rows whose rotor was just "
                   "starting"),
        Parameter("stretched", "1", 0.0, 1.0, source="a switch, 0 or 1: the scale begins at the band's end"),
        Parameter("bend", "1", 1.0, 12.0, moves=True,
            source="wide: any value between the bounds; how idling power is taken off goes with the "
                   "controller's firmware"),
        Parameter("start", "1", 0.0, 1.0,
            source="wide: any value between the bounds; where a motor starts goes with its load and its "
                   "controller"),
        Parameter("cells", "1", 0.0, 1.0, source="a switch, 0 or 1: load cells, not motors, have the band"),
        Parameter("knee", "1", 4.0, 12.0, moves=True,
            source="wide: any value between the bounds; how sharply play or stiction ends goes with "
                   "the mount"),
        Parameter("only", "1", 0.0, 1.0,
            source="a switch, 0 or 1: the two thrust cells alone have the band, or the two torque cells"),
        Parameter("tracks", "1", 0.0, 3.0,
            source="a number of a load, 0 to 3: its cell shows none of a small force, and all of a large "
                   "one (zero tracking, OIML R 76-1)"),
        Parameter("torque", "1", 0.2, 5.0, moves=True,
            source="wide: any value between the bounds; torque cells and thrust cells are of two kinds"),
    ),
    stand=STAND,
    static=_static,
    required=("band",),
    surface=3,
    no_static=_BELOW,
    no_live=_BELOW,
)  # fmt: skip
