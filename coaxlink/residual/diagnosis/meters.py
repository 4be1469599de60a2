"""Supply and winding without their meters' own noise from row to row.

A reading's noise would be a part of every load that is predicted from it (errors in variables, Fuller 1987):
a voltmeter good to 0.2 % makes 0.4 % of a thrust in every row, and whatever else moves as slowly as the
supply, a cell that drifts say, then fits better than the supply itself.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.signal import lfilter

from coaxlink.effects.drive import drive
from coaxlink.frames import Array, StandFrame
from coaxlink.signals import without_row_noise

VOLTS = ("voltage_V", "upper_voltage_V", "lower_voltage_V")
HEAT = ("motor_temperature_C",)
# the most that is a meter's noise from row to row, rms: of a voltmeter's reading (class 1, IEC 60051); of a
# thermometer, K, and of its reading in C (class B, IEC 60751). What changes by more does change, as a supply
# that is set anew at every point: taken as read
VOLTMETER = 0.01
THERMOMETER_C, THERMOMETER = 0.3, 0.005
# a supply sags with the currents of both motors, within a row: these go with their speeds to the third power
SAG_ORDER = 3
# a cell polarises behind its current, within seconds and within minutes (Chen and Rincon-Mora 2006)
POLARISES_S = (10.0, 30.0, 100.0)
LEAST_ROWS = 60  # judgement: several rows for each number of that sag
PAUSE, PAUSE_S = 20.0, 30.0  # times the usual step, and seconds: a run begins anew, its supply may be another


def calmed(frame: StandFrame) -> StandFrame:
    """The frame with its supply and windings as they are without their meters' noise."""
    ends = _runs(frame)
    u = drive(frame)
    columns = dict(frame.columns)
    for name in (*VOLTS, *HEAT):
        values = frame.context(name)
        if values is None or not np.all(np.isfinite(values)):
            continue
        values = np.asarray(values, float)
        sag = _sag(values, u, frame.time_s, ends) if name in VOLTS else np.zeros_like(values)
        slow = [without_row_noise((values - sag)[a:b]) for a, b in pairwise(ends)]
        calm = np.concatenate(slow) + sag
        usual = float(np.mean(np.abs(values)))
        most = VOLTMETER * usual if name in VOLTS else THERMOMETER_C + THERMOMETER * usual
        columns[name] = calm if np.std(values - calm) <= most else values
    return replace(frame, columns=columns)


def _runs(frame: StandFrame) -> list[int]:
    """Where logs and runs begin, and the end."""
    step = np.diff(frame.time_s, prepend=frame.time_s[:1])
    usual = max(float(np.median(step)), 1e-9)
    new = (step > np.maximum(PAUSE * usual, PAUSE_S)) | (step < 0.0)
    log = frame.context("log")
    if log is not None:
        new |= np.diff(log, prepend=log[:1]) != 0.0
    return [0, *(int(k) for k in np.flatnonzero(new) if k > 0), len(step)]


def _sag(volts: Array, u: Array, time_s: Array, ends: list[int]) -> Array:
    """(rows,) V that a supply gives way with the motors' commands (rows, 2), at once and by and by.

    Estimated from what changes between neighbours: how the pack empties drops out.
    """
    if len(volts) < LEAST_ROWS:
        return np.zeros_like(volts)
    powers = [(a, b) for a in range(SAG_ORDER + 1) for b in range(SAG_ORDER + 1 - a) if a + b]
    x = np.stack([u[:, 0] ** a * u[:, 1] ** b for a, b in powers], axis=1)
    x = np.column_stack([x, *(_behind(u, time_s, s, ends) for s in POLARISES_S)])
    inside = np.ones(len(volts) - 1, bool)
    inside[np.array(ends[1:-1], int) - 1] = False
    numbers, *_ = np.linalg.lstsq(np.diff(x, axis=0)[inside], np.diff(volts)[inside], rcond=1e-6)
    return np.asarray((x - x.mean(axis=0)) @ numbers)


def _behind(u: Array, time_s: Array, memory_s: float, ends: list[int]) -> Array:
    """(rows, 2) the power of both motors, u^3, behind a first-order memory; every run starts settled."""
    power, step = u**SAG_ORDER, float(np.median(np.diff(time_s)))
    share = float(-np.expm1(-max(step, 1e-9) / memory_s))
    runs = [power[a:b] for a, b in pairwise(ends)]
    late = [lfilter([share], [1.0, share - 1.0], r, axis=0, zi=(1.0 - share) * r[:1])[0] for r in runs]
    return np.concatenate(late)
