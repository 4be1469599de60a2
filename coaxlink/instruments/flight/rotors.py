"""Labels and clocks that the rotors contradict: two motors exchanged, an answer at another time.

The same rotors make lift, roll and pitch, with one lag: where one of the three comes later than the others
the sensor that tells it is late. Gusts, which the loops answer with commands, make any of them seem late too:
the less it is like what the commands make, the more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray

from coaxlink.channels.flight import reduce_columns
from coaxlink.constants import NORMAL_999
from coaxlink.frames import Array, FlightFrame
from coaxlink.instruments.findings import Suspect
from coaxlink.instruments.flight.apart import LATE_S, PERIOD_S, SHIFTS_S
from coaxlink.instruments.flight.kinematics import ACCEL, GYRO
from coaxlink.signals import low_pass

# priors: name = value  # unit, source
SWAP = 0.1  # of the torque's squares left with two motors exchanged
# times what the exchange leaves: one failing rotor, or a centre of mass, that leaves less explains as much
FAILS = 3.0
# what moves the vehicle before its command (judgement: twice what clocks of one autopilot are apart); band of
# what tells, how like the two must be where one is shifted, and parts of a flight that have to bear it out
LEADS_S, BAND_HZ, ALIKE, PIECES = 0.02, 0.5, 0.7, 8
TORQUES = (3, 4)  # roll and pitch, of a frame's channels
SHOWN_BY = ((2, ACCEL[2], "lift"), (3, GYRO[0], "roll"), (4, GYRO[1], "pitch"))


def rotor_faults(frame: FlightFrame) -> list[Suspect]:
    """Labels and clocks that the rotors contradict: two motors exchanged, an answer at another time."""
    return [*_swapped(frame), *(_early(frame) or _late(frame))]


def _swapped(frame: FlightFrame) -> list[Suspect]:
    """Two motors whose commands explain the torques only when exchanged."""
    speeds = np.clip(reduce_columns(frame, frame.speeds), 0.0, None)
    measured = reduce_columns(frame, frame.measured)[:, 3:]
    scale = np.std(measured, axis=0) + 1e-9

    def left(order: list[int]) -> Array:
        loads = frame.airframe.body_loads(*frame.airframe.loads(frame.model, speeds[:, order]))
        return np.asarray(np.mean(((measured - loads[:, 3:]) / scale) ** 2, axis=1))

    count = speeds.shape[1]
    labelled = left(list(range(count)))
    exchanged, pair = labelled, (0, 0)
    for i, j in combinations(range(count), 2):
        order = list(range(count))
        order[i], order[j] = j, i
        now = left(order)
        if now.mean() < exchanged.mean():
            exchanged, pair = now, (i, j)
    as_labelled, best = float(labelled.mean()), float(exchanged.mean())
    if best > SWAP * as_labelled or as_labelled < 0.05:
        return []
    # cables are exchanged from the first row on; what fits as it is labelled for a while began in mid-flight
    pieces = zip(np.array_split(labelled, PIECES), np.array_split(exchanged, PIECES), strict=True)
    if any(FAILS * a.mean() < b.mean() for a, b in pieces):
        return []
    if min(rival(frame, measured / scale, scale) for rival in (_one_fails, off_centre)) < FAILS * best:
        return []
    closer = np.sqrt(as_labelled / best)
    why = f"with the two exchanged the torques fit {closer:.0f} times closer: they are swapped"
    return [Suspect(f"motor{pair[0] + 1}, motor{pair[1] + 1}", "all", why)]


def _one_fails(frame: FlightFrame, measured: Array, scale: Array) -> float:
    """What is left of the torques (kept, 3), over `scale`, if one rotor lost some of its loads."""
    at = replace(frame, keep=np.arange(len(measured))).turning_at(
        np.clip(reduce_columns(frame, frame.speeds), 0.0, None)
    )
    misfit = measured - at.predicted[:, 3:] / scale
    least = np.inf
    for k in range(at.thrust.shape[1]):
        only = np.eye(at.thrust.shape[1])[k]
        none = np.zeros_like(at.thrust)
        lost = [
            at.airframe.body_loads(at.thrust * only, none),
            at.airframe.body_loads(none, at.torque * only),
        ]
        columns = np.stack([(x[:, 3:] / scale).ravel() for x in lost], axis=1)
        fit = np.linalg.lstsq(columns, misfit.ravel(), rcond=None)[0]
        least = min(least, float(np.mean((misfit.ravel() - columns @ fit) ** 2)))
    return least


def off_centre(frame: FlightFrame, measured: Array, scale: Array) -> float:
    """What is left of the torques (kept, 3), over `scale`, with the centre of mass at its best."""
    loads = reduce_columns(frame, frame.predicted)
    none = np.zeros(len(loads))
    along = np.stack([none, -loads[:, 2], loads[:, 1]], axis=1)  # e_x x F
    aside = np.stack([loads[:, 2], none, -loads[:, 0]], axis=1)  # e_y x F
    columns = np.stack([(x / scale).ravel() for x in (along, aside)], axis=1)
    misfit = (measured - loads[:, 3:] / scale).ravel()
    fit = np.linalg.lstsq(columns, misfit, rcond=None)[0]
    return float(np.mean((misfit - columns @ fit) ** 2))


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
