"""A stand that remembers where it came from: friction of the rig, and blades that recover late from stall.

Two kinds of memory. *Sharp*: the load depends on the sign of the last change alone (or only while the speed
moves). *Worn in*: after a turn the memory changes over a way, as a row of elements does that stick until each
has slipped its own way (Iwan 1966, J. Applied Mechanics 33, 893; Prandtl's play operators), or it fades with
the way that was gone since, whatever it was (Dahl 1968, Aerospace Corporation TOR-0158). And the throttle's
own path may have play, of a linkage or of a speed controller that ignores small changes of its input: then
the speed remembers, and both rotors' loads with it (Tao and Kokotovic 1996).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from coaxlink.constants import SIGMA_PER_MAD
from coaxlink.effects.base import Parameter, PhysicalEffect, Stage
from coaxlink.effects.drive import changed_by, drivable, drive
from coaxlink.effects.tracing import Array, Shape, Tracing, outside
from coaxlink.frames import STAND_CHANNELS, StandFrame

SIDES = {"upper": 0, "lower": 1}
REACHES = (0.03, 0.1)  # of normalised speed: to turn the middle element round
# of the throttle: starts of the fit, no judgement
GAPS = (0.015, 0.03, 0.045, 0.06, 0.09, 0.13)
SHARES = (0.7, 1.4)  # judgement, as of `rotor_lag`: of the play, what the speeds feel; 1 is physics
RELAY_STEP, RELAY_WIDEST, RELAY_VARIANTS = 0.06, 0.35, (0.02, 0.007)  # of normalised speed
RELAY_MOST = 2.0  # of normalised speed: what runs further is no speed
NAMES = ("thrust_share", "torque_share", "both", "upper", "lower", "sweep", "load", "bulge", "moving",
         "power", "reach", "spread", "fading", "lower_over_upper",
         "relay", "on", "off", "angle", "command", "share")  # fmt: skip
ALL = {"both", "sweep", "load"}  # not one rotor's alone, unless that is named beside
FREE = {
    "fading": (0.0, 1.0),
    "reach": (0.004, 0.6),
    "spread": (1.02, 3.0),
    "power": (0.0, 1.5),
    "lower_over_upper": (0.2, 5.0),
}
TURNED = 0.01  # of normalised speed: less is no turn
TREMBLES = 0.1  # of a path's range, judgement: three deviations of a held speed are less
SAME, RETURNS = 0.03, 0.1  # of normalised speed; of the rows: had at a speed from one side and the other
JUMP = 0.3  # of normalised speed from row to row: the next sweep begins, no way back
STICKING = np.array([-1.5, -0.5, 0.5, 1.5])  # elements: their ways are reach * spread^k


def direction(frame: StandFrame, side: int) -> Array:
    """(rows,) +1 where the speed last rose, -1 where it last fell, 0 before it moved or where it jumped."""
    u = _path(frame)[:, side]
    rows = np.arange(len(u))
    state = slipping(u, np.array([TURNED]))[:, 0]  # what a tachometer's noise cannot turn round
    settled = np.where(np.abs(state) > 0.999, np.sign(state), 0.0)
    way = settled[np.maximum.accumulate(np.where(settled != 0.0, rows, 0))]
    turn = np.diff(way, prepend=0.0) != 0.0
    jumped = np.abs(np.diff(u, prepend=u[0])) > JUMP
    since = np.maximum.accumulate(np.where(turn, rows, 0))
    return np.where(jumped[since], 0.0, way)


def moving(frame: StandFrame, side: int) -> Array:
    """(rows,) +1 while the speed rises, -1 while it falls, 0 while it stands."""
    rate = np.gradient(_path(frame)[:, side])
    return np.where(np.abs(rate) > 1e-3, np.sign(rate), 0.0)


def slipping(path: Array, ways: Array) -> Array:
    """(rows, K) states -1..1 of elements that follow the path (rows,) and slip after the ways (K,).

    Read-only: a search asks for the same states again and again.
    """
    return _slipping(np.asarray(path, float).tobytes(), np.asarray(ways, float).tobytes())


@lru_cache(maxsize=64)
def _slipping(path_of: bytes, ways_of: bytes) -> Array:
    """Two levels: pieces of the path become one map each, side by side, then run from their starts."""
    path, ways = np.frombuffer(path_of), np.frombuffer(ways_of)
    move = np.diff(path, prepend=path[0])[:, None] * (2.0 / ways)
    rows = len(move)
    length = max(1, int(np.sqrt(rows)))
    pieces = -(-rows // length)
    padded = np.zeros((pieces * length, len(ways)))
    padded[:rows] = move
    by_step = padded.reshape(pieces, length, -1).transpose(1, 0, 2)  # (length, pieces, K)
    shift = by_step.sum(axis=0)
    low, high = np.full_like(shift, -np.inf), np.full_like(shift, np.inf)
    ends = np.stack([low, high])
    for step in by_step:
        _slip(ends, step, -1.0, 1.0, ends)
    low, high = ends
    start = np.zeros_like(shift)
    for k in range(1, pieces):
        _slip(start[k - 1], shift[k - 1], low[k - 1], high[k - 1], start[k])
    out = np.empty_like(by_step)
    state = start
    for k, step in enumerate(by_step):
        state = _slip(state, step, -1.0, 1.0, out[k])
    states = np.ascontiguousarray(out.transpose(1, 0, 2).reshape(pieces * length, -1)[:rows])
    states.setflags(write=False)
    return states


def _slip(state: Array, step: Array, low: Array | float, high: Array | float, out: Array) -> Array:
    """The state (..., K) moved by a step and kept inside, into `out`; np.clip costs three times that."""
    np.add(state, step, out=out)
    np.minimum(out, high, out=out)
    return np.maximum(out, low, out=out)


def fading(path: Array, reach: float) -> Array:
    """(rows,) state -1..1 that follows the path (rows,) and forgets by 1/e over the way `reach`.

    Two levels, as `slipping`: every step is one line, state to state, and so is a piece of them.
    """
    move = np.diff(path, prepend=path[0]) / reach
    rows = len(move)
    length = max(1, int(np.sqrt(rows)))
    pieces = -(-rows // length)
    padded = np.zeros(pieces * length)
    padded[:rows] = move
    steps = padded.reshape(pieces, length).T  # (length, pieces)
    keep, add = np.exp(-np.abs(steps)), -np.sign(steps) * np.expm1(-np.abs(steps))
    slope, shift = np.ones(pieces), np.zeros(pieces)
    for k in range(length):
        slope, shift = slope * keep[k], shift * keep[k] + add[k]
    state = np.zeros(pieces)
    for k in range(1, pieces):
        state[k] = state[k - 1] * slope[k - 1] + shift[k - 1]
    out = np.empty_like(steps)
    for k in range(length):
        state = state * keep[k] + add[k]
        out[k] = state
    return np.asarray(out.T.ravel()[:rows])


def _path(frame: StandFrame) -> Array:
    return frame.speeds if frame.throttles is None else frame.throttles


def _returns(frame: StandFrame, side: int) -> bool:
    """Whether a rotor stood at the same speeds coming from below and from above.

    A level that was visited once has one sign, and what the nuisance misses there would be its hysteresis.
    """
    way, u = direction(frame, side), frame.speeds[:, side]
    _, level = np.unique(np.round((u - u.min()) / SAME), return_inverse=True)
    rose, fell = np.bincount(level, way > 0), np.bincount(level, way < 0)
    return bool(2.0 * np.minimum(rose, fell).sum() > RETURNS * len(u))


def _no_return(frame: StandFrame) -> str | None:
    if _returns(frame, 0) or _returns(frame, 1):
        return None
    return "no speed was come to from below and from above"


def _quiet(path: Array) -> Array:
    """The path (rows,) behind a play as wide as its noise: what only trembles while held wears nothing.

    A path whose points were visited in random order, one row each, tells no noise: it is taken as it is.
    """
    play = 3.0 * SIGMA_PER_MAD * float(np.median(np.abs(np.diff(path, 2)))) / np.sqrt(6.0)
    if not 1e-9 < play < TREMBLES * np.ptp(path):
        return path
    return np.asarray(path - play * slipping(path, np.array([2.0 * play]))[:, 0])


def _way(frame: StandFrame, channel: int, shape: Shape) -> Array:
    """(rows,) -1..1: from above, from below; of one load channel."""
    side = channel // 2
    if "reach" in shape:
        path = _path(frame).sum(axis=1) if "sweep" in shape else frame.speeds[:, side]
        if "load" in shape:  # a cell's friction knows its own load only, whatever speeds made it
            path = frame.predicted[:, channel] / frame.reference[channel]
        if "angle" in shape:
            path = _ratio(frame)
        quiet, share, way = _quiet(path), shape.get("fading", 0.0), np.zeros(len(path))
        if "fading" in shape:
            way = share * fading(quiet, 0.5 * shape["reach"])
        if "spread" in shape:
            ways = shape["reach"] * shape["spread"] ** STICKING
            way = way + (1.0 - share) * slipping(quiet, ways).mean(axis=1)
        return np.asarray(way)
    if "sweep" in shape:  # the stand as a whole is loaded or unloaded, whichever rotor does it
        rate = np.gradient(_path(frame).sum(axis=1))
        way = np.where(np.abs(rate) > 1e-3, np.sign(rate), 0.0)
        if "moving" in shape:
            return way
        last = np.maximum.accumulate(np.where(way != 0.0, np.arange(len(way)), 0))
        return way[last]
    return moving(frame, side) if "moving" in shape else direction(frame, side)


def relay_shapes(frame: StandFrame) -> list[dict[str, float]]:
    """The lower rotor's flow flips above one speed of the upper rotor and flips back below another.

    Source: a relay with two thresholds, the element of Preisach's operator (Mayergoyz 2003).
    """
    u = frame.speeds[:, 0]
    if not 2.0 * RELAY_STEP < np.ptp(u) < RELAY_MOST:
        return []
    levels = np.arange(np.min(u) + RELAY_STEP, np.max(u), RELAY_STEP)
    return [
        {"lower": 1.0, "relay": 0.0, "on": float(on), "off": float(off)}
        for on in levels
        for off in levels
        if RELAY_STEP < on - off < RELAY_WIDEST
    ]


ANGLE_REACHES = (0.1, 0.3, 0.6)  # of the ratio's logarithm; starts of the fit, judgement


def angle_shapes(frame: StandFrame) -> list[dict[str, float]]:
    """A lower rotor that recovers late from stall: its blades' angle goes with the ratio of both speeds."""
    u = frame.speeds
    if len(u) < 2 or np.ptp(_ratio(frame)) <= ANGLE_REACHES[0]:
        return []
    return [{"lower": 1.0, "angle": 1.0, "reach": r, "spread": 1.8} for r in ANGLE_REACHES]


def _ratio(frame: StandFrame) -> Array:
    """(rows,) logarithm of the upper over the lower speed; of rotors that all but stand, of their slowest."""
    u = np.maximum(frame.speeds, 0.05)
    return np.asarray(np.log(u[:, 0] / u[:, 1]))


def _flipped(frame: StandFrame, shape: Shape) -> Array:
    """(rows,) 1 from where the speed rose above `on` until it falls below `off`."""
    u, row = frame.speeds[:, int(shape["relay"])], np.arange(len(frame.speeds))
    on = np.maximum.accumulate(np.where(u > shape["on"], row, -1))
    off = np.maximum.accumulate(np.where(u < shape["off"], row, -1))
    return np.asarray(on > off, float)


def _weight(frame: StandFrame, side: int, shape: Shape) -> Array:
    """(rows, 2) of thrust and torque: what a share is a share of.

    The load itself, the load where the blades are slow (`bulge`), or by a power of the load from 1
    for the load to 0 for dry friction, which is the same at every load.
    """
    weight = frame.predicted[:, 2 * side : 2 * side + 2]
    if "bulge" in shape:
        return np.asarray(weight * (4.0 * np.clip(1.0 - frame.speeds[:, side], 0.0, 1.0))[:, None])
    if "power" in shape:
        full = frame.reference[2 * side : 2 * side + 2]
        return np.asarray(full * np.maximum(np.abs(weight) / full, 1e-3) ** shape["power"])
    return weight


def _played(frame: StandFrame, shape: Shape) -> Array:
    """(rows, 2) speeds behind throttles whose path has play: the middle of it where it was never crossed."""
    u = drive(frame)
    states = [slipping(u[:, side], np.array([shape["reach"]]))[:, 0] for side in (0, 1)]
    return np.asarray(u - 0.5 * shape["reach"] * np.stack(states, axis=1))


def _of_both(shape: Shape) -> bool:
    return bool(ALL & set(shape)) and not set(SIDES) & set(shape)


def _columns(frame: StandFrame, shape: Shape) -> Array:
    if "command" in shape:
        return changed_by(frame, _played(frame, shape))[..., None]
    out = np.zeros((len(frame.time_s), 6, 2))
    for name, side in SIDES.items():
        if name in shape and "relay" in shape:
            out[:, 2 * side, 0], out[:, 2 * side + 1, 1] = (
                frame.predicted[:, 2 * side : 2 * side + 2] * _flipped(frame, shape)[:, None]
            ).T
        elif name in shape or _of_both(shape):
            weight = _weight(frame, side, shape) * (shape.get("lower_over_upper", 1.0) if side else 1.0)
            thrust = _way(frame, 2 * side, shape)
            # a cell's own way, or the speed's
            torque = _way(frame, 2 * side + 1, shape) if "load" in shape else thrust
            for k, way in enumerate((thrust, torque)):
                out[:, 2 * side + k, k] = -0.5 * weight[:, k] * way
    return out


def _shapes(frame: StandFrame) -> list[dict[str, float]]:
    forms = [
        {},
        {"bulge": 1.0},
        {"moving": 1.0},
        {"power": 0.0, "reach": 0.03, "spread": 1.8},
        *({"reach": r, "spread": 1.8} for r in REACHES),
    ]
    worn = [form for form in forms if "reach" in form]
    sides = ["both", "sweep", *(name for name, side in SIDES.items() if _returns(frame, side))]
    commands = [] if drivable(frame) else [{"command": 1.0, "reach": r} for r in GAPS]
    return [
        *commands,
        *({side: 1.0, **form} for side in sides for form in forms),
        *({"load": 1.0, **form} for form in worn),
        # one dirty slide: dry friction of a single rotor's cells
        *(
            {side: 1.0, "load": 1.0, "power": 0.0, "reach": r, "spread": 1.8}
            for side in SIDES
            for r in REACHES
        ),
    ]


def _free(_: StandFrame, shape: Shape) -> dict[str, tuple[float, float]]:
    mixed = {"fading", "spread"} <= set(shape)
    return {name: limit for name, limit in FREE.items() if name in shape and (mixed or name != "fading")}


def _variants(_: StandFrame, shape: Shape, c: Array) -> list[tuple[Shape, Array]]:
    """Worn in, at every load alike or by a power of it, on both rotors by one share or by two."""
    if "angle" in shape or "command" in shape:
        return []
    if "relay" in shape:
        return [
            ({**shape, "on": shape["on"] + a, "off": shape["off"] + b}, c)
            for step in RELAY_VARIANTS
            for a, b in ((step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step))
            if shape["on"] + a > shape["off"] + b
        ]
    way = {"reach": shape.get("reach", REACHES[0]), "spread": shape.get("spread", 1.8)}
    forms: list[tuple[Shape, Array]] = []
    bare = {k: v for k, v in shape.items() if k not in ("moving", "reach", "spread", "fading")}
    each = {"lower_over_upper": 1.0} if _of_both(shape) else {}
    if "fading" not in shape:
        forms.append(({**each, **bare, "fading": 1.0, "reach": way["reach"]}, c))
    if ("fading" in shape) != ("spread" in shape):  # a part of it fades, the rest sticks
        forms.append(({**each, **bare, **way, "fading": 0.5}, c))
    if "reach" not in shape:
        forms += [({**bare, **way, "reach": r}, c) for r in REACHES]
    if "power" not in shape:
        forms.append(({k: v for k, v in bare.items() if k != "bulge"} | way | {"power": 0.7}, c))
    if "load" not in shape:  # what remembers is not the speed's way but each cell's own
        own = {side: 1.0 for side in SIDES if side in shape} or {"lower_over_upper": 1.0}
        forms.append(({**own, **way, "load": 1.0, "power": 0.3}, c))
    if _of_both(shape) and ("lower_over_upper" not in shape or "fading" in shape):
        # every slide has a friction of its own
        plain = {k: v for k, v in shape.items() if k not in ("moving", "fading")}
        forms += [({**plain, **way, **power, "lower_over_upper": 1.0}, c) for power in ({}, {"power": 0.3})]
    return forms


def _parameters(_: StandFrame, shape: Shape, c: Array) -> dict[str, float]:
    if "command" in shape:
        return {"share": float(c[0]), **shape}
    return {"thrust_share": float(c[0]), "torque_share": float(c[1]), **shape}


def _inverse(_: StandFrame, p: Mapping[str, float]) -> tuple[Shape, Array]:
    coefficients = ("share",) if "command" in p else ("thrust_share", "torque_share")
    return {k: v for k, v in p.items() if k not in coefficients}, np.array([p[k] for k in coefficients])


def _refuse(p: Mapping[str, float]) -> str | None:
    if "command" in p:
        return outside("share", p["share"], *SHARES)
    return outside("thrust_share", p["thrust_share"], -0.5, 0.5)


STAND: Tracing[StandFrame] = Tracing(
    name="hysteresis",
    stage=7,
    physics="a load depends on whether the speed came from above or below",
    source="friction of the rig and stall of the blades on the way down; Iwan 1966",
    needs=("upper_rpm", "lower_rpm"),
    channels=STAND_CHANNELS,
    units=dict.fromkeys(NAMES, "1"),
    missing=_no_return,
    shapes=lambda frame: [*_shapes(frame), *relay_shapes(frame), *angle_shapes(frame)],
    columns=_columns,
    parameters=_parameters,
    inverse=_inverse,
    refuse=_refuse,
    cause=lambda frame, _, channel: (
        "direction of the sweep",
        direction(frame, 1 if channel.startswith("lower") else 0),
    ),
    free=_free,
    variants=_variants,
)  # fmt: skip

_DIRECTION_UNKNOWN = "the mixer does not know which way the speed came"
_SHARE = "assumed: friction and late recovery of blades hold back 5 % of a load on a sound stand"
_WAYS = "wide: any value between the bounds; the ways over which a memory wears in go with the rig"
_PLAY = "wide: any value between the bounds; what follows a command with play feels all of it"
_FORMS = {
    "both": "of both rotors",
    "upper": "of the upper rotor",
    "lower": "of the lower rotor",
    "sweep": "of the stand as a whole, whichever rotor loads it",
    "load": "of each cell's own load",
    "bulge": "of the load where the blades are slow, and stall",
    "moving": "only while the speed moves",
    "command": "play of the command: speeds follow the throttle behind a gap, the reach",
    "angle": "over the ratio of both speeds, which sets the blades' angle",
}
EFFECT = PhysicalEffect(
    name="hysteresis",
    stage=Stage.STAND,
    parameters=(
        *(Parameter(name, "1", -1.0, 1.0, (0.0, 0.05), source=_SHARE) for name in NAMES[:2]),
        *(
            Parameter(name, "1", 0.0, 1.0, source=f"a switch, 0 or 1: {what}")
            for name, what in _FORMS.items()
        ),
        *(Parameter(name, "1", *limits, source=_WAYS) for name, limits in FREE.items()),
        Parameter("share", "1", *SHARES, source=_PLAY),
        Parameter("relay", "1", 0.0, 1.0,
            source="a number of the rotor (0 upper, 1 lower) whose speed flips it"),
        *(Parameter(name, "1", 0.0, 1.5, source=_WAYS) for name in ("on", "off")),
    ),
    stand=STAND,
    no_static=_DIRECTION_UNKNOWN,
    no_live=_DIRECTION_UNKNOWN,
)  # fmt: skip
