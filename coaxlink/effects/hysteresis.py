"""A stand that remembers where it came from: friction of the rig, and blades that recover late from stall.

Two kinds of memory. *Sharp*: the load depends on the sign of the last change alone (or only while the speed
moves). *Worn in*: after a turn the memory changes over a way, as a row of elements does that stick until each
has slipped its own way (Iwan 1966, J. Applied Mechanics 33, 893; Prandtl's play operators), or it fades with
the way that was gone since, whatever it was (Dahl 1968, Aerospace Corporation TOR-0158). And the throttle's
own path may have play, of a linkage or of a speed controller that ignores small changes of its input: then
the speed remembers, and both rotors' loads with it (Tao and Kokotovic 1996).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from coaxlink.constants import SIGMA_PER_MAD
from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.drive import changed_by, drivable, drive
from coaxlink.effects.tracing import Array, NotShown, Tracing
from coaxlink.frames import STAND_CHANNELS, StandFrame

SIDES = {"upper": 0, "lower": 1}
SHARES = {"thrust_share": 0.05, "torque_share": 0.05}  # starts
REACHES = (0.03, 0.1)  # of normalised speed: to turn the middle element round
# of the throttle: starts of the fit, no judgement
GAPS = (0.0015, 0.005, 0.015, 0.03, 0.045, 0.06, 0.09, 0.13)
RELAY_STEP, RELAY_WIDEST, RELAY_VARIANTS = 0.06, 0.35, (0.02, 0.007)  # of normalised speed
RELAY_MOST = 2.0  # of normalised speed: what runs further is no speed
SPREAD = 1.8  # a start of the fit: the longest way of four elements over the shortest is its cube
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


def _way(frame: StandFrame, channel: int, p: Numbers) -> Array:
    """(rows,) -1..1: from above, from below; of one load channel."""
    side = channel // 2
    if "reach" in p:
        path = _path(frame).sum(axis=1) if "sweep" in p else frame.speeds[:, side]
        if "load" in p:  # a cell's friction knows its own load only, whatever speeds made it
            path = frame.predicted[:, channel] / frame.reference[channel]
        if "angle" in p:
            path = _ratio(frame)
        quiet, share, way = _quiet(path), p.get("fading", 0.0), np.zeros(len(path))
        if "fading" in p:
            way = share * fading(quiet, 0.5 * p["reach"])
        if "spread" in p:
            ways = p["reach"] * p["spread"] ** STICKING
            way = way + (1.0 - share) * slipping(quiet, ways).mean(axis=1)
        return np.asarray(way)
    if "sweep" in p:  # the stand as a whole is loaded or unloaded, whichever rotor does it
        rate = np.gradient(_path(frame).sum(axis=1))
        way = np.where(np.abs(rate) > 1e-3, np.sign(rate), 0.0)
        if "moving" in p:
            return way
        last = np.maximum.accumulate(np.where(way != 0.0, np.arange(len(way)), 0))
        return way[last]
    return moving(frame, side) if "moving" in p else direction(frame, side)


def _relay_starts(frame: StandFrame) -> list[Numbers]:
    """The lower rotor's flow flips above one speed of the upper rotor and flips back below another.

    Source: a relay with two thresholds, the element of Preisach's operator (Mayergoyz 2003).
    """
    u = frame.speeds[:, 0]
    if not 2.0 * RELAY_STEP < np.ptp(u) < RELAY_MOST:
        return []
    levels = np.arange(np.min(u) + RELAY_STEP, np.max(u), RELAY_STEP)
    return [
        {**SHARES, "lower": 1.0, "relay": 0.0, "on": float(on), "off": float(off)}
        for on in levels
        for off in levels
        if RELAY_STEP < on - off < RELAY_WIDEST
    ]


ANGLE_REACHES = (0.1, 0.3, 0.6)  # of the ratio's logarithm; starts of the fit, judgement


def _angle_starts(frame: StandFrame) -> list[Numbers]:
    """A lower rotor that recovers late from stall: its blades' angle goes with the ratio of both speeds."""
    if len(frame.speeds) < 2 or np.ptp(_ratio(frame)) <= ANGLE_REACHES[0]:
        return []
    return [{**SHARES, "lower": 1.0, "angle": 1.0, "reach": r, "spread": SPREAD} for r in ANGLE_REACHES]


def _ratio(frame: StandFrame) -> Array:
    """(rows,) logarithm of the upper over the lower speed; of rotors that all but stand, of their slowest."""
    u = np.maximum(frame.speeds, 0.05)
    return np.asarray(np.log(u[:, 0] / u[:, 1]))


def _flipped(frame: StandFrame, p: Numbers) -> Array:
    """(rows,) 1 from where the speed rose above `on` until it falls below `off`."""
    u, row = frame.speeds[:, int(p["relay"])], np.arange(len(frame.speeds))
    on = np.maximum.accumulate(np.where(u > p["on"], row, -1))
    off = np.maximum.accumulate(np.where(u < p["off"], row, -1))
    return np.asarray(on > off, float)


def _weight(frame: StandFrame, side: int, p: Numbers) -> Array:
    """(rows, 2) of thrust and torque: what a share is a share of.

    The load itself, the load where the blades are slow (`bulge`), or by a power of the load from 1
    for the load to 0 for dry friction, which is the same at every load.
    """
    weight = frame.predicted[:, 2 * side : 2 * side + 2]
    if "bulge" in p:
        return np.asarray(weight * (4.0 * np.clip(1.0 - frame.speeds[:, side], 0.0, 1.0))[:, None])
    if "power" in p:
        full = frame.reference[2 * side : 2 * side + 2]
        return np.asarray(full * np.maximum(np.abs(weight) / full, 1e-3) ** p["power"])
    return weight


def _played(frame: StandFrame, p: Numbers) -> Array:
    """(rows, 2) speeds behind throttles whose path has play: the middle of it where it was never crossed."""
    u = drive(frame)
    states = [slipping(u[:, side], np.array([p["reach"]]))[:, 0] for side in (0, 1)]
    return np.asarray(u - 0.5 * p["reach"] * np.stack(states, axis=1))


def _adds(frame: StandFrame, p: Numbers) -> Array:
    if "share" in p:
        return p["share"] * changed_by(frame, _played(frame, p))
    out, both = np.zeros((len(frame.time_s), 6)), not set(SIDES) & set(p)
    for name, side in SIDES.items():
        if name not in p and not both:
            continue
        for k, share in enumerate((p["thrust_share"], p["torque_share"])):
            load = 2 * side + k
            if "relay" in p:
                out[:, load] = share * frame.predicted[:, load] * _flipped(frame, p)
                continue
            weight = _weight(frame, side, p)[:, k] * (p.get("lower_over_upper", 1.0) if side else 1.0)
            # a cell's own way, or the speed's
            way = _way(frame, load if "load" in p else 2 * side, p)
            out[:, load] = share * -0.5 * weight * way
    return out


def _starts(frame: StandFrame) -> list[Numbers]:
    if why := _no_return(frame):
        raise NotShown(why)
    worn: list[Numbers] = [
        {"power": 0.0, "reach": 0.03, "spread": SPREAD},
        *({"reach": r, "spread": SPREAD} for r in REACHES),
    ]
    forms: list[Numbers] = [{}, {"bulge": 1.0}, {"moving": 1.0}, *worn]
    sides: list[Numbers] = [{}, {"sweep": 1.0}]
    sides += [{name: 1.0} for name, side in SIDES.items() if _returns(frame, side)]
    commands = [] if drivable(frame) else [{"share": 1.0, "reach": r} for r in GAPS]
    return [
        *commands,
        *({**SHARES, **side, **form} for side in sides for form in forms),
        *({**SHARES, "load": 1.0, **form} for form in worn),
        # one dirty slide: dry friction of a single rotor's cells
        *(
            {**SHARES, side: 1.0, "load": 1.0, "power": 0.0, "reach": r, "spread": SPREAD}
            for side in SIDES
            for r in REACHES
        ),
        *_relay_starts(frame),
        *_angle_starts(frame),
    ]


def _further(_: StandFrame, p: Numbers) -> list[Numbers]:
    """Worn in, at every load alike or by a power of it, on both rotors by one share or by two."""
    if "angle" in p or "share" in p:
        return []
    if "relay" in p:
        return [
            {**p, "on": p["on"] + a, "off": p["off"] + b}
            for step in RELAY_VARIANTS
            for a, b in ((step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step))
            if p["on"] + a > p["off"] + b
        ]
    way = {"reach": p.get("reach", REACHES[0]), "spread": p.get("spread", SPREAD)}
    forms: list[Numbers] = []
    bare = {k: v for k, v in p.items() if k not in ("moving", "reach", "spread", "fading")}
    both = not set(SIDES) & set(p)
    each = {"lower_over_upper": 1.0} if both else {}
    if "fading" not in p:
        forms.append({**each, **bare, "fading": 1.0, "reach": way["reach"]})
    if ("fading" in p) != ("spread" in p):  # a part of it fades, the rest sticks
        forms.append({**each, **bare, **way, "fading": 0.5})
    if "reach" not in p:
        forms += [{**bare, **way, "reach": r} for r in REACHES]
    if "power" not in p:
        forms.append({k: v for k, v in bare.items() if k != "bulge"} | way | {"power": 0.7})
    if "load" not in p:  # what remembers is not the speed's way but each cell's own
        own = {k: v for k, v in p.items() if k in (*SIDES, *SHARES)}
        forms.append({**each, **own, **way, "load": 1.0, "power": 0.3})
    if both and ("lower_over_upper" not in p or "fading" in p):  # every slide has a friction of its own
        plain = {k: v for k, v in p.items() if k not in ("moving", "fading")}
        forms += [{**plain, **way, **power, "lower_over_upper": 1.0} for power in ({}, {"power": 0.3})]
    return forms


STAND: Tracing[StandFrame] = Tracing(
    needs=("upper_rpm", "lower_rpm"),
    channels=STAND_CHANNELS,
    starts=_starts,
    further=_further,
    adds=_adds,
    cause=lambda frame, _, channel: (
        "direction of the sweep",
        direction(frame, 1 if channel.startswith("lower") else 0),
    ),
)

_DIRECTION_UNKNOWN = "the mixer does not know which way the speed came"
_WAYS = "wide: any value between the bounds; the ways over which a memory wears in go with the rig"
_FORMS = {
    "upper": "of the upper rotor alone",
    "lower": "of the lower rotor alone",
    "sweep": "of the stand as a whole, whichever rotor loads it",
    "load": "of each cell's own load",
    "bulge": "of the load where the blades are slow, and stall",
    "moving": "only while the speed moves",
    "angle": "over the ratio of both speeds, which sets the blades' angle",
}
EFFECT = PhysicalEffect(
    name="hysteresis",
    stage=Stage.STAND,
    physics="a load depends on whether the speed came from above or below",
    source="friction of the rig and stall of the blades on the way down; Iwan 1966",
    parameters=(
        *(Parameter(name, "1", -most, most, (0.0, 0.05), amount=True,
            source="assumed: friction and late recovery of blades hold back 5 % of a load on a sound stand")
          for name, most in zip(SHARES, (0.5, 1.0), strict=True)),
        *(
            Parameter(name, "1", 0.0, 1.0, source=f"a switch, 0 or 1: {what}")
            for name, what in _FORMS.items()
        ),
        *(Parameter(name, "1", low, high, moves=True, source=_WAYS)
          for name, low, high in (("reach", 0.0005, 0.6), ("spread", 1.02, 3.0), ("power", 0.0, 1.5),
                                  ("lower_over_upper", 0.2, 5.0))),
        Parameter("fading", "1", 0.0, 1.0, moves=("spread",), source=_WAYS),
        Parameter("share", "1", 0.7, 1.4, amount=True,
            source="wide: any value between the bounds; of a command with play, all of it is felt: 1"),
        Parameter("relay", "1", 0.0, 1.0,
            source="a number of the rotor (0 upper, 1 lower) whose speed flips it"),
        *(Parameter(name, "1", 0.0, 1.5, source=_WAYS) for name in ("on", "off")),
    ),
    stand=STAND,
    no_static=_DIRECTION_UNKNOWN,
    no_live=_DIRECTION_UNKNOWN,
)  # fmt: skip
