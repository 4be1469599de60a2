"""Speeds of ESCs that are none: silent while the motor is commanded, or one reading to the last digit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from coaxlink.data.resolution import resolution_of
from coaxlink.data.samples import Samples
from coaxlink.frames import Array
from coaxlink.residual.faults.mixer_demands import LEAST_ROWS, away, held_in_flight, is_no_reading, rows_of
from coaxlink.residual.faults.states import Finding, Mask

# priors: name = value  # unit, source
STUCK_S = 0.5  # less is a packet that was lost
QUIET = 5.0  # usual pauses: a longer one is silence, as `data.logs.streams` has it of a gap


def speed_faults(log: Samples, name: str, command: Array, flying: Mask, usable: Mask) -> Iterator[Finding]:
    """Where one rotor's logged speed (rows,) is no reading, in the air; `usable`: its command is one."""
    yield from _silent(log, name, flying)
    yield from _speed_held(log, name, command, usable)


def _silent(log: Samples, name: str, flying: Mask) -> Iterator[Finding]:
    """Where a speed that is logged elsewhere is not: from QUIET of its usual pauses on."""
    known, rows = np.flatnonzero(np.isfinite(log[name])), np.flatnonzero(flying)
    if not len(known):
        return
    usual = float(np.median(np.diff(log["time_s"][known]))) if len(known) > 1 else 0.0
    longest = max(QUIET * usual, STUCK_S)
    ends = np.concatenate([[rows[0] - 1], known[flying[known]], [rows[-1] + 1]])
    inside = np.clip(ends, 0, log.rows - 1)
    out = np.zeros(log.rows, bool)
    for k in np.flatnonzero(np.diff(log["time_s"][inside]) > longest):
        out[ends[k] + 1 : ends[k + 1]] = True
    out &= flying
    if out.any():
        yield name, out, "no speed is logged while its motor is commanded: the ESC is silent"


def _speed_held(log: Samples, name: str, command: Array, usable: Mask) -> Iterator[Finding]:
    """Where a speed stands still and its command moves."""
    speed = log[name]
    runs = held_in_flight(speed, usable)
    held = rows_of(runs, log.rows)
    design = np.stack([np.ones_like(command), command, command**2], axis=1)
    rows = np.zeros(log.rows, bool)
    most, step = float(np.nanmax(np.abs(speed), initial=1.0)), log.resolution.get(name, resolution_of(speed))
    for run in runs:
        a, b, _ = run
        known = usable & ~held
        if np.sum(known & np.isfinite(speed)) < LEAST_ROWS:  # it never moves
            rows[a:b] |= np.ptp(command[a:b]) > 0.0
        elif is_no_reading(away(speed / most, design, known, np.arange(a, b), step / most), run):
            rows[a:b] = True
    if rows.any():
        why = "one speed repeats exactly while its command moves: the ESC is silent"
        yield name, rows, why
