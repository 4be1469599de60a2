"""When lift and torques answer the commands: before them is another clock, one alone another column's.

The same rotors make lift, roll and pitch, with one lag: where one of the three comes later than the others
the sensor that tells it is late. Gusts, which the loops answer with commands, make any of them seem late too:
the less it is like what the commands make, the more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import NORMAL_999
from coaxlink.frames import Array, FlightFrame
from coaxlink.residual.faults.apart import SHIFTS_S
from coaxlink.residual.faults.commands_apart import LATE_S, PERIOD_S
from coaxlink.residual.faults.kinematics import ACCEL, GYRO
from coaxlink.residual.result import Suspect
from coaxlink.signals import low_pass

# priors: name = value  # unit, source
# what moves the vehicle before its command (judgement: twice what clocks of one autopilot are apart); band of
# what tells, how like the two must be where one is shifted, and parts of a flight that have to bear it out
LEADS_S, BAND_HZ, ALIKE, PIECES = 0.02, 0.5, 0.7, 8
TORQUES = (3, 4)  # roll and pitch, of a frame's channels
SHOWN_BY = ((2, ACCEL[2], "lift"), (3, GYRO[0], "roll"), (4, GYRO[1], "pitch"))


def response_faults(frame: FlightFrame) -> list[Suspect]:
    """Torques before their commands; or one of lift, roll and pitch at another time than the others."""
    return _early(frame) or _late(frame)


def _early(frame: FlightFrame) -> list[Suspect]:
    """Torques that come before their commands, as if motors had a lag less than none: a clock is off."""
    asked = frame.airframe.body_loads(*frame.airframe.loads(frame.model, np.clip(frame.commands, 0.0, None)))
    both = _Shifts.of(frame, asked, TORQUES)
    (late, spread), alike = both.late((0, 1)), both.alike(both.every).mean(axis=1).max()
    if alike < ALIKE or -late - 4.0 * spread < LEADS_S:
        return []
    why = (
        f"torques come {-1000.0 * late:.0f} ms before their commands: stamps of motors or of sensors are off"
    )
    return [Suspect("time_s", "all", why)]


def _late(frame: FlightFrame) -> list[Suspect]:
    """The one of lift, roll and pitch that is later or earlier than another one, and farther from no lag."""
    shifts = _Shifts.of(frame, frame.predicted, [channel for channel, *_ in SHOWN_BY])
    alike = shifts.alike(shifts.every).max(axis=0)
    known = [k for k in range(len(SHOWN_BY)) if alike[k] > ALIKE]
    late = {k: shifts.late((k,)) for k in known}
    # what is no answer to commands may move the best shift by as much of the reach as there is of it
    reach = {k: NORMAL_999 * late[k][1] + (1.0 - alike[k] ** 2) * float(SHIFTS_S[-1]) for k in known}
    for k, j in permutations(sorted(known, key=lambda k: -abs(late[k][0])), 2):
        (_, column, what), (_, other, others) = SHOWN_BY[k], SHOWN_BY[j]
        by = late[k][0] - late[j][0]
        apart = PERIOD_S if {column, other} <= set(GYRO) else LATE_S  # axes of one sensor, or two sensors
        if abs(by) > max(apart, float(np.hypot(reach[k], reach[j]))):
            way = "later" if by > 0.0 else "earlier"
            why = (
                f"{what} answers the commands {1000.0 * abs(by):.0f} ms {way} than {others}, and the same "
                "rotors make both: this column's stamps are off"
            )
            return [Suspect(column, "all", why)]
    return []


@dataclass(frozen=True)
class _Shifts:
    """How like what was measured and what is due are with the second so much later, by parts of a flight."""

    power: Array  # (PIECES, K) of what was measured
    cross: Array  # (PIECES, SHIFTS_S, K)
    own: Array  # (PIECES, SHIFTS_S, K) of what is due

    @classmethod
    def of(cls, frame: FlightFrame, due: Array, channels: Sequence[int]) -> _Shifts:
        """Of some channels of loads (rows, 6) that are due."""
        measured, due = (_band(frame, x[:, list(channels)]) for x in (frame.measured, due))
        measured = measured[frame.keep]
        shifted = [_shifted(frame, due, shift)[frame.keep] for shift in SHIFTS_S]
        pieces = np.array_split(np.arange(len(frame.keep)), PIECES)
        return cls(
            np.stack([np.sum(measured[p] ** 2, axis=0) for p in pieces]),
            np.stack([[np.sum(measured[p] * x[p], axis=0) for x in shifted] for p in pieces]),
            np.stack([[np.sum(x[p] ** 2, axis=0) for x in shifted] for p in pieces]),
        )

    @property
    def every(self) -> NDArray[np.intp]:
        """All parts."""
        return np.arange(PIECES)

    def alike(self, use: NDArray[np.intp]) -> Array:
        """(SHIFTS_S, K) cosines, by some parts."""
        scale = np.sqrt(np.maximum(self.power[use].sum(axis=0) * self.own[use].sum(axis=0), 1e-300))
        return np.asarray(self.cross[use].sum(axis=0) / scale)

    def late(self, channels: Sequence[int]) -> tuple[float, float]:
        """Seconds by which what was measured comes later in some channels, and their jackknife's sd."""

        def best(use: NDArray[np.intp]) -> float:
            return _highest(self.alike(use)[:, list(channels)].mean(axis=1))

        parts = np.array([best(np.delete(self.every, k)) for k in self.every])
        spread = np.sqrt((PIECES - 1) / PIECES * np.sum((parts - parts.mean()) ** 2))
        return best(self.every), float(spread)


def _highest(alike: Array) -> float:
    """The shift of the highest point of a parabola through the highest (SHIFTS_S,) and its neighbours, s."""
    at = int(np.clip(np.argmax(alike), 1, len(alike) - 2))
    before, best, behind = alike[at - 1 : at + 2]
    bend = min(float(before - 2.0 * best + behind), -1e-300)
    return float(
        SHIFTS_S[at] + np.clip(0.5 * (before - behind) / bend, -1.0, 1.0) * (SHIFTS_S[1] - SHIFTS_S[0])
    )


def _stretches(frame: FlightFrame, made: Callable[[NDArray[np.intp]], Array]) -> Array:
    """(rows, K) what is made of the rows of every stretch without a gap."""
    parts = [np.flatnonzero(frame.stretch == number) for number in np.unique(frame.stretch)]
    values = [made(rows) for rows in parts]
    out = np.zeros((len(frame.time_s), *values[0].shape[1:]))
    for rows, value in zip(parts, values, strict=True):
        out[rows] = value
    return out


def _band(frame: FlightFrame, loads: Array) -> Array:
    """(rows, K) between BAND_HZ and what is judged."""

    def between(rows: NDArray[np.intp]) -> Array:
        smooth = low_pass(loads[rows], frame.rate_hz, frame.cutoff_hz)
        return smooth - low_pass(loads[rows], frame.rate_hz, BAND_HZ)

    return _stretches(frame, between)


def _shifted(frame: FlightFrame, loads: Array, later_s: float) -> Array:
    """(rows, K) as they were so much earlier, within stretches."""

    def earlier(rows: NDArray[np.intp]) -> Array:
        time = frame.time_s[rows]
        return np.stack([np.interp(time - later_s, time, x) for x in loads[rows].T], axis=1)

    return _stretches(frame, earlier)
