"""Ways in which the instruments of a stand lie: how each is undone, and its words.

    name                    undone                              words
    exchanged columns       back in their places                labels or wires are swapped
    exchanged speeds        of the two rotors                   "
    exchanged throttles     of the two rotors                   the commands are swapped
    a cell's factor         divided by it                       another unit, sign or gain
    a cell's plug           not: it reads nothing               a plug or a wire is loose
    a cell's rows           read some rows earlier              its amplifier or its clock is late
    a tachometer's ratio    divided by it                       pulses are counted wrong
    a tachometer, anything  the speed that its throttle gives   "

Columns that stand still, copies and limits repeat digit by digit: `stand_repeats`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from coaxlink.channels.stand import COLUMN_OF
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.frames import STAND_CHANNELS, Array, StandFrame
from coaxlink.instruments.chain import WHOLE
from coaxlink.instruments.findings import Mask

GAIN_ERROR, UNIT_ERROR = 0.02, 0.05  # of a factor that is known: half a bridge, another gain; another unit
RATIOS = (2.0, 0.5, 1.5, 2.0 / 3.0, 3.0, 1.0 / 3.0)  # of pulses counted to pulses due: poles, marks, edges
UNITS = {  # of a newton, and of a newton metre
    "thrust": {"kgf": 1 / GRAVITY_M_S2, "gf": 1000 / GRAVITY_M_S2, "mN": 1000.0, "lbf": 0.2248089,
               "ozf": 3.596943},
    "torque": {"N cm": 100.0, "N mm": 1000.0, "kgf cm": 100 / GRAVITY_M_S2, "gf cm": 1e5 / GRAVITY_M_S2,
               "kgf m": 1 / GRAVITY_M_S2, "ozf in": 141.6119, "lbf in": 8.850746},
}  # fmt: skip
RPM = ("upper_rpm", "lower_rpm")
AGREED = "throttle and loads agree on what it shows in the other rows"


@dataclass(frozen=True)
class Readings:
    """What of a log the states are about."""

    speeds: Array  # (rows, 2)
    loads: Array  # (rows, 4)
    throttles: Array  # (rows, 2)


def readings_of(frame: StandFrame) -> Readings:
    """Of a stand log."""
    throttles = np.zeros((len(frame.time_s), 2)) if frame.throttles is None else frame.throttles
    return Readings(frame.speeds, frame.measured[:, :4], throttles)


@dataclass(frozen=True)
class State:
    """A way in which columns lie: how it is undone, and its words."""

    columns: str
    says: str
    channels: tuple[int, ...] = ()  # loads whose readings it changes
    source: tuple[int, ...] = (0, 1, 2, 3)  # the load that each column really shows
    factor: float = 1.0  # of its channels; nothing: a plug is off
    exchanged: str = ""  # speeds or throttles: of the two rotors
    side: int = -1  # whose tachometer lies
    ratio: float = 0.0  # that it reads of the speed; nothing: anything
    late: int = 0  # rows that its channels are behind

    @property
    def exchanges(self) -> bool:
        """Whether labels are exchanged, which takes nothing away."""
        return bool(self.exchanged) or self.source != (0, 1, 2, 3)

    @property
    def kept(self) -> bool:
        """Whether its rows say as much as sound ones, once it is undone."""
        return self.exchanges or self.late > 0

    @property
    def concerns(self) -> tuple[int, ...]:
        """Channels that must be closer with it: loads, speeds over throttle."""
        if self.side >= 0:
            return (2 * self.side, 2 * self.side + 1)
        return (4, 5) if self.exchanged == "throttles" else self.channels

    @property
    def one_cell(self) -> bool:
        """Whether it is of one load cell."""
        return len(self.channels) == 1 and not self.exchanged

    def undo(self, log: Readings, rows: Mask | None = None) -> Readings:
        """The readings as they should be, in some rows."""
        at = np.ones(len(log.speeds), bool) if rows is None else rows

        def mixed(a: Array, b: Array) -> Array:
            return np.where(at[:, None], b, a)

        if self.exchanged:
            name = self.exchanged
            whole: Array = getattr(log, name)
            return replace(log, **{name: mixed(whole, whole[:, ::-1])})
        if self.side >= 0:
            times = np.ones(2)
            times[self.side] = self.ratio or 1.0
            return replace(log, speeds=mixed(log.speeds, log.speeds / times))
        times = np.ones(4)
        times[list(self.channels)] = self.factor or 1.0
        loads = log.loads[:, list(self.source)] / times
        for c in self.channels if self.late else ():
            loads[:, c] = earlier(loads[:, c], self.late)
        return replace(log, loads=mixed(log.loads, loads))


@dataclass(frozen=True)
class Faulty:
    """Rows in which a state holds."""

    state: State
    rows: Mask
    times: float  # closer than as labelled
    readings: Array  # (rows,) of a tachometer over the speed

    @property
    def of_all_rows(self) -> bool:
        """Whether it concerns every row of the log."""
        return float(np.mean(self.rows)) > WHOLE

    @property
    def why(self) -> str:
        """In words."""
        if self.state.side >= 0:
            low, high = (100.0 * (f(self.readings[self.rows]) - 1.0) for f in (np.min, np.max))
            by = f"{low:+.1f} %" if high - low < 0.1 else f"{low:+.0f} to {high:+.0f} %"
            return f"reads {by} here: {self.state.says}"
        if not self.state.factor:
            return self.state.says
        return f"{self.state.says} ({self.times:.0f} times closer than as labelled)"


def earlier(column: Array, rows: int) -> Array:
    """A column (rows,) by so many rows earlier; its end stands.

    >>> earlier(np.array([0.0, 0.0, 1.0, 2.0]), 1).tolist()
    [0.0, 1.0, 2.0, 2.0]
    """
    return np.asarray(np.concatenate([column[rows:], np.repeat(column[-1], min(rows, len(column)))]))


def exchanges(frame: StandFrame) -> list[State]:
    """Columns that may stand in one another's places."""
    loads = tuple(c for c in frame.present if c < 4)
    out = []
    if min(np.ptp(frame.speeds, axis=0)) > 0.0:
        says = "with the speeds of upper and lower exchanged the loads fit: labels or wires are swapped"
        out.append(State("upper_*, lower_* speeds", says, loads, exchanged="speeds"))
    if {4, 5} <= set(frame.present):
        says = "each rotor's measured speed follows the other's throttle: the commands are swapped"
        out.append(State("upper_throttle, lower_throttle", says, exchanged="throttles"))
    pairs = [(a, b) for a in loads for b in loads if a < b]
    for pair in [*pairs, (0, 2, 1, 3)]:
        if set(pair) <= set(loads):
            source = [0, 1, 2, 3]
            for a, b in zip(pair[::2], pair[1::2], strict=True):
                source[a], source[b] = b, a
            names = ", ".join(COLUMN_OF[STAND_CHANNELS[c]] for c in pair)
            says = "exchanged, the columns fit: labels or wires are swapped"
            out.append(State(names, says, tuple(sorted(pair)), tuple(source)))
    return out


def named(channel: int, factor: float) -> tuple[str, bool]:
    """The unit that a factor is, and whether it is one of these, or of an amplifier's or a bridge's gains."""
    units = UNITS[("thrust", "torque")[channel % 2]] | {"": 1.0, "half": 0.5, "twice": 2.0}
    near = min(units, key=lambda name: abs(np.log(abs(factor) / units[name])))
    most = GAIN_ERROR if near in ("half", "twice") else UNIT_ERROR
    known = bool(abs(np.log(abs(factor) / units[near])) < most) and (near != "" or factor < 0.0)
    return near if known else "", known


def scale_words(channel: int, factor: float) -> str:
    """What a factor of a load's readings is."""
    name = named(channel, factor)[0]
    guesses = ["its sign"] * (factor < 0) + [name] * (name not in ("", "half", "twice"))
    guess = f": {' and '.join(guesses)}?" if guesses else ""
    return f"{factor:.3g} times what the speeds give{guess}; no effect of physics does that"
