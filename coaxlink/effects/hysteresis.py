"""A stand that remembers where it came from: friction of the rig, and blades that recover late from stall.

Two kinds of memory. *Sharp*: the load depends on the sign of the last change alone (or only while the speed
moves). *Worn in*: after a turn the memory changes over a way (`play`). And the throttle's own path may have
play, of a linkage or of a speed controller that ignores small changes of its input: then the speed remembers,
and both rotors' loads with it (Tao and Kokotovic 1996). `form_of` says which form a file's numbers are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coaxlink.constants import SIGMA_PER_MAD
from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.drive import SETTLED_S, changed_by, drivable, drive
from coaxlink.effects.play import fading, slipping
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


def direction(frame: StandFrame, side: int, turned: float = TURNED) -> Array:
    """(rows,) +1 where the speed last rose by more than `turned`, -1 where it last fell by that, 0 before it
    moved or where it jumped.
    """
    u = _path(frame)[:, side]
    rows = np.arange(len(u))
    state = slipping(u, np.array([turned]))[:, 0]  # what a tachometer's noise cannot turn round
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


def _path(frame: StandFrame) -> Array:
    return frame.speeds if frame.throttles is None else frame.throttles


def _returns(frame: StandFrame, side: int) -> bool:
    """Whether a rotor stood at the same speeds coming from below and from above.

    A level that was visited once has one sign, and what the nuisance misses there would be its hysteresis.
    """
    # a supply that sags moves what a throttle gives by some per cent
    way, u = direction(frame, side, 2.0 * SAME), frame.speeds[:, side]
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


class OfRotor:
    """What each rotor's own speed remembers. Paths and signs are (rows,), of a load by its number 0..3."""

    def path(self, frame: StandFrame, load: int) -> Array:
        """That a memory wears in along."""
        return np.asarray(frame.speeds[:, load // 2])

    def sign(self, frame: StandFrame, load: int, moves: bool) -> Array:
        """-1..1 of a sharp memory, or while it moves."""
        return moving(frame, load // 2) if moves else direction(frame, load // 2)


class OfSweep(OfRotor):
    """What the stand as a whole remembers, loaded or unloaded, whichever rotor does it."""

    def path(self, frame: StandFrame, load: int) -> Array:
        """Both together."""
        return np.asarray(_path(frame).sum(axis=1))

    def sign(self, frame: StandFrame, load: int, moves: bool) -> Array:
        """Of both together."""
        rate = np.gradient(self.path(frame, load))
        way = np.where(np.abs(rate) > 1e-3, np.sign(rate), 0.0)
        if moves:
            return way
        return way[np.maximum.accumulate(np.where(way != 0.0, np.arange(len(way)), 0))]


class OfLoad(OfRotor):
    """What a cell remembers: its friction knows its own load only, whatever speeds made it."""

    def path(self, frame: StandFrame, load: int) -> Array:
        """The load, of its largest."""
        return np.asarray(frame.predicted[:, load] / frame.reference[load])


class OfAngle(OfRotor):
    """What the blades' angle remembers, which goes with the ratio of both speeds."""

    def path(self, frame: StandFrame, load: int) -> Array:
        """The ratio's logarithm."""
        return _ratio(frame)


@dataclass(frozen=True)
class Sharp:
    """A memory of the last change's sign alone; `moves`: only while the speed moves."""

    moves: bool

    def way(self, frame: StandFrame, load: int, of: OfRotor) -> Array:
        """(rows,) -1..1: from above, from below."""
        return of.sign(frame, load, self.moves)


@dataclass(frozen=True)
class Worn:
    """A memory that changes over a way: `faded` of it is forgotten, the rest sticks in elements."""

    reach: float
    spread: float | None  # None: no elements
    faded: float | None  # None: nothing is forgotten

    def way(self, frame: StandFrame, load: int, of: OfRotor) -> Array:
        """(rows,) -1..1: from above, from below."""
        quiet, share = _quiet(of.path(frame, load)), self.faded or 0.0
        way = np.zeros(len(quiet)) if self.faded is None else share * fading(quiet, 0.5 * self.reach)
        if self.spread is not None:
            ways = self.reach * self.spread**STICKING
            way = way + (1.0 - share) * slipping(quiet, ways).mean(axis=1)
        return np.asarray(way)


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


class OwnLoad:
    """A share of the load itself."""

    def weight(self, frame: StandFrame, side: int) -> Array:
        """(rows, 2) of thrust and torque: what a share is a share of."""
        return np.asarray(frame.predicted[:, 2 * side : 2 * side + 2])


class SlowBlades(OwnLoad):
    """A share of the load where the blades are slow, and stall."""

    def weight(self, frame: StandFrame, side: int) -> Array:
        """Fades to nothing at full speed."""
        slow = 4.0 * np.clip(1.0 - frame.speeds[:, side], 0.0, 1.0)
        return np.asarray(super().weight(frame, side) * slow[:, None])


@dataclass(frozen=True)
class PowerOfLoad(OwnLoad):
    """A share of a power of the load: 1 for the load, 0 for dry friction, the same at every load."""

    power: float

    def weight(self, frame: StandFrame, side: int) -> Array:
        """Of the largest load, so that a share means the same."""
        full = frame.reference[2 * side : 2 * side + 2]
        of_full = np.maximum(np.abs(super().weight(frame, side)) / full, 1e-3)
        return np.asarray(full * of_full**self.power)


@dataclass(frozen=True)
class Memory:
    """Loads that depend on where the stand came from: what remembers, how, and how much each load."""

    of: OfRotor
    keeps: Sharp | Worn
    size: OwnLoad
    shares: tuple[float, float]  # of thrust and torque
    sides: tuple[int, ...]
    lower_over_upper: float = 1.0

    def adds(self, frame: StandFrame) -> Array:
        """(rows, 6) by channels."""
        out = np.zeros((len(frame.time_s), 6))
        for side in self.sides:
            for k, share in enumerate(self.shares):
                load = 2 * side + k
                weight = self.size.weight(frame, side)[:, k] * (self.lower_over_upper if side else 1.0)
                way = self.keeps.way(frame, load, self.of)
                out[:, load] = share * -0.5 * weight * way
        return out


@dataclass(frozen=True)
class Relay:
    """Loads that flip above one speed of a rotor and flip back below another (Mayergoyz 2003)."""

    rotor: int
    on: float
    off: float
    shares: tuple[float, float]
    sides: tuple[int, ...]

    def adds(self, frame: StandFrame) -> Array:
        """(rows, 6) by channels."""
        out = np.zeros((len(frame.time_s), 6))
        u, row = frame.speeds[:, self.rotor], np.arange(len(frame.speeds))
        on = np.maximum.accumulate(np.where(u > self.on, row, -1))
        off = np.maximum.accumulate(np.where(u < self.off, row, -1))
        flipped = np.asarray(on > off, float)
        for side in self.sides:
            for k, share in enumerate(self.shares):
                load = 2 * side + k
                out[:, load] = share * frame.predicted[:, load] * flipped
        return out


@dataclass(frozen=True)
class PlayedCommand:
    """Speeds behind throttles whose path has play: the middle of it where it was never crossed."""

    share: float
    reach: float

    def adds(self, frame: StandFrame) -> Array:
        """(rows, 6) by channels."""
        u = drive(frame)
        states = [slipping(u[:, side], np.array([self.reach]))[:, 0] for side in (0, 1)]
        played = np.asarray(u - 0.5 * self.reach * np.stack(states, axis=1))
        return self.share * changed_by(frame, played)


def form_of(p: Numbers) -> Memory | Relay | PlayedCommand:
    """The form that has these numbers."""
    if "share" in p:
        return PlayedCommand(p["share"], p["reach"])
    shares = p["thrust_share"], p["torque_share"]
    sides = tuple(side for name, side in SIDES.items() if name in p) or (0, 1)
    if "relay" in p:
        return Relay(int(p["relay"]), p["on"], p["off"], shares, sides)
    keeps = Worn(p["reach"], p.get("spread"), p.get("fading")) if "reach" in p else Sharp("moving" in p)
    of = next((kind for name, kind in REMEMBERS.items() if name in p), OfRotor())
    size = SlowBlades() if "bulge" in p else PowerOfLoad(p["power"]) if "power" in p else OwnLoad()
    return Memory(of, keeps, size, shares, sides, p.get("lower_over_upper", 1.0))


# by the number of a file that asks for it; the later goes before the earlier, of what it wears in along
REMEMBERS = {"angle": OfAngle(), "load": OfLoad(), "sweep": OfSweep()}


def _adds(frame: StandFrame, p: Numbers) -> Array:
    return form_of(p).adds(frame)


def _starts(frame: StandFrame) -> list[Numbers]:
    if why := _no_return(frame):
        raise NotShown(why)
    worn: list[Numbers] = [
        {"power": 0.0, "reach": 0.03, "spread": SPREAD},
        *({"reach": r, "spread": SPREAD} for r in REACHES),
    ]
    forms: list[Numbers] = [{}, {"bulge": 1.0}, *worn]
    if len(frame.time_s) > 1 and float(np.median(np.diff(frame.time_s))) < SETTLED_S:
        forms.insert(2, {"moving": 1.0})
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
        Parameter("share", "1", 0.7, 1.4, (1.0, 0.1), amount=True,
            source="1 by definition: all of a command's play is felt; 0.1 is assumed for paths that differ"),
        Parameter("relay", "1", 0.0, 1.0,
            source="a number of the rotor (0 upper, 1 lower) whose speed flips it"),
        *(Parameter(name, "1", 0.0, 1.5, source=_WAYS) for name in ("on", "off")),
    ),
    stand=STAND,
    no_static=_DIRECTION_UNKNOWN,
    no_live=_DIRECTION_UNKNOWN,
)  # fmt: skip
