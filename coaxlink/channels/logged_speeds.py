"""What rotors turned at by their ESCs' rpm, beside what the drive of their file gives at their commands.

Commands tell to the row what happens within a second; rpm come late and coarsely. What a command means they
alone tell: a pack that sags, windings that warm, another ESC than the stand's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.constants import TURNING
from coaxlink.data.samples import Samples
from coaxlink.frames import Array, FlightFrame

LEAST_ROWS = 50  # with a speed
# a pack's voltage, which all rotors share, answers a load within seconds; windings, each motor's own, warm
# within tens of them. So few speeds are in a mean, from ESCs that report once a second: what each is off by
# falls to a third
SLOW_S, OWN_S, FEW_SPEEDS = 2.0, 20.0, 8


def has_speed(log: Samples, rotor: int) -> bool:
    """Whether there are speeds of a rotor while it was commanded."""
    if not log.has(f"rpm{rotor}"):
        return False
    return int(np.sum((log[f"rpm{rotor}"] > 0.0) & (log[f"motor{rotor}"] > TURNING))) >= LEAST_ROWS


def has_speeds(log: Samples, airframe: Airframe) -> bool:
    """Whether more than half of the rotors have theirs (judgement)."""
    return 2 * sum(has_speed(log, r.number) for r in airframe.rotors) > len(airframe.rotors)


def by_logged_speeds(frame: FlightFrame, logs: Sequence[Samples]) -> FlightFrame | None:
    """The flight with its rotors at the speeds that the rpm of its logs tell, slowly, and quickly as the
    commands go; None where most rotors have no speeds.

    Every speed is times what rpm are over the drive's: of all rotors over SLOW_S around, of each against them
    over OWN_S. A rotor without rpm turns by its command as the others do.
    """
    if not all(has_speeds(log, frame.airframe) for log in logs):
        return None
    ratio = np.ones_like(frame.speeds)
    for number in np.unique(frame.stretch):
        rows = np.flatnonzero(frame.stretch == number)
        ratio[rows] = _ratios(frame, rows, logs[int(frame.log[rows[0]])])
    return replace(frame, commands=frame.commands * ratio).turning_at(frame.speeds * ratio)


def _ratios(frame: FlightFrame, rows: np.ndarray, log: Samples) -> Array:
    """(rows, N) rpm over the drive's."""
    time, at = frame.time_s[rows], log["time_s"]
    speeds = [k for k, r in enumerate(frame.airframe.rotors) if has_speed(log, r.number)]
    asked = np.stack([np.interp(at, time, frame.speeds[rows, k], np.nan, np.nan) for k in speeds], axis=1)
    turned = np.stack([log[f"rpm{frame.airframe.rotors[k].number}"] for k in speeds], axis=1)
    turned = turned / frame.model.speed_max_rpm
    known = np.isfinite(asked) & (asked > TURNING) & (turned > TURNING)
    every = float(np.median(np.diff(at[known.any(axis=1)]))) if known.any() else np.inf
    if known.sum() < FEW_SPEEDS:
        return np.ones((len(rows), len(frame.airframe.rotors)))
    asked, turned = np.where(known, asked, 0.0), np.where(known, turned, 0.0)
    quick, slow = max(SLOW_S, FEW_SPEEDS / len(speeds) * every), max(OWN_S, FEW_SPEEDS * every)
    ratio = _over(_around(at, turned.sum(axis=1), time, quick), _around(at, asked.sum(axis=1), time, quick))
    usual = np.interp(time, time[np.isfinite(ratio)], ratio[np.isfinite(ratio)])
    out = np.repeat(usual[:, None], len(frame.airframe.rotors), axis=1)
    own = asked * np.interp(at, time, usual)[:, None]  # what a rotor would turn at if it did as all do
    for k, mine, as_all in zip(speeds, turned.T, own.T, strict=True):
        out[:, k] *= 1.0 + _beyond_noise(at, mine, as_all, time, slow)
    return out


def _beyond_noise(at: Array, turned: Array, as_all: Array, time: Array, span_s: float) -> Array:
    """(rows,) share by which a rotor turns faster than as all do, shrunk by what noise makes of such means
    (James and Stein 1961): how they differ from one span to the next."""
    rows = as_all > 0.0
    more = _over(_around(at, turned - as_all, time, span_s), _around(at, as_all, time, span_s))
    known = np.isfinite(more)
    if not known.any():
        return np.zeros(len(time))
    more = np.interp(time, time[known], more[known])
    step = max(1, int(np.searchsorted(time, time[0] + span_s)))
    one = float(np.var(turned[rows] / as_all[rows])) * min(1.0, float(np.median(np.diff(at[rows]))) / span_s)
    between = 0.5 * float(np.mean((more[step:] - more[:-step]) ** 2)) if step < len(more) else 0.0
    return np.asarray(more * max(0.0, 1.0 - max(one, between) / max(float(np.mean(more**2)), 1e-300)))


def _around(at: Array, values: Array, time: Array, span_s: float) -> Array:
    """(rows,) sum of what lies within half a span of each time."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    first, end = (np.searchsorted(at, time + way * 0.5 * span_s) for way in (-1.0, 1.0))
    return np.asarray(sums[end] - sums[first])


def _over(values: Array, by: Array) -> Array:
    """(rows,) a ratio; NaN by nothing."""
    return np.divide(values, by, out=np.full_like(values, np.nan), where=by > 0.0)
