"""Data that cannot be what their labels say: stuck cells, lying tachometers, repeats, swapped rotors.

Found before anything is fitted; the rows are left out, or, where every row is concerned, nothing is claimed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coaxlink.residual.frames import STAND_CHANNELS, Array, StandFrame
from coaxlink.residual.result import Suspect
from coaxlink.residual.stand import COLUMN_OF, own_model
from coaxlink.residual.tachometers import lies

STUCK_ROWS = 4
REPEATED_ROWS = 3
SWAP = 0.25  # of the squares left when the labels are exchanged


def find_suspects(frame: StandFrame) -> tuple[list[Suspect], Array, bool]:
    """Suspects, (rows,) mask of rows to leave out, and whether the labels as a whole are wrong."""
    out: list[Suspect] = []
    bad = np.zeros(len(frame.time_s), bool)
    for c in frame.present:
        if c < 4:
            stuck = _stuck(frame, c)
            if stuck.any():
                bad |= stuck
                why = "one reading repeats exactly while the rotors turn and other cells do not stand still"
                out.append(Suspect(COLUMN_OF[STAND_CHANNELS[c]], rows_text(stuck), why))
    for lie in lies(frame):
        bad |= lie.rows
        out.append(Suspect(f"{('upper', 'lower')[lie.side]}_rpm", rows_text(lie.rows), lie.why))
    repeated = _repeated(frame) & ~bad
    if repeated.any():
        bad |= repeated
        out.append(
            Suspect(
                "all loads", rows_text(repeated), "these readings stand in the log before, digit by digit"
            )
        )
    swapped = _swapped(frame)
    if swapped is not None:
        out.append(Suspect("upper_*, lower_* speeds", "all", swapped))
    return out, bad, swapped is not None


def rows_text(mask: Array | NDArray[np.bool_]) -> str:
    """Row ranges of a mask, counted from 1: "12-30, 44"."""
    rows = np.flatnonzero(mask)
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    shown = [f"{r[0] + 1}-{r[-1] + 1}" if len(r) > 1 else f"{r[0] + 1}" for r in runs[:6]]
    return ", ".join(shown) + (f" and {len(runs) - 6} more" if len(runs) > 6 else "")


def _stuck(frame: StandFrame, channel: int) -> Array:
    values = frame.measured[:, channel]
    same = np.concatenate([[False], np.diff(values) == 0.0])
    start = np.flatnonzero(~same)
    out = np.zeros(len(values), bool)
    need = max(STUCK_ROWS, len(values) // 100)
    # a cell that else never shows one reading twice is stuck even where the load should stand still
    noisy = float(np.mean(same)) < 0.2 and len(values) > 50
    long = max(3 * STUCK_ROWS, len(values) // 50)
    for first, end in zip(start, np.append(start[1:], len(values)), strict=True):
        expected = np.ptp(frame.predicted[first:end, channel])
        level = np.max(np.abs(frame.predicted[first:end, channel]))
        still = noisy and end - first >= long and level > 0.05 * frame.reference[channel]
        moved = end - first >= need and expected > 0.02 * frame.reference[channel]
        if values[first] != 0.0 and (moved or still):
            out[first:end] = True
    return out


def _repeated(frame: StandFrame) -> Array:
    loads = [c for c in frame.present if c < 4]
    values = frame.measured[:, loads]
    out = np.zeros(len(values), bool)
    if len(loads) < 2:
        return out
    _, first, inverse = np.unique(values, axis=0, return_index=True, return_inverse=True)
    turning = np.any(np.abs(values) > 1e-9, axis=1)
    twin = (first[inverse.ravel()] != np.arange(len(values))) & turning
    rows = np.flatnonzero(twin)
    for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
        if len(run) >= REPEATED_ROWS:
            out[run] = True
    return out


def _swapped(frame: StandFrame) -> str | None:
    """Only the lower rotor feels the other's wake; where only the upper one does, labels are swapped."""
    if not {0, 2} <= set(frame.present) or min(np.ptp(frame.speeds, axis=0)) < 0.2:
        return None
    left = []
    for u in (frame.speeds, frame.speeds[:, ::-1]):
        model = own_model(u, frame.measured, [0, 2], frame.model.speed_max_rpm)
        pair = model.loads(u[:, 0], u[:, 1])
        misses = (frame.measured[:, 0] - pair.upper_thrust, frame.measured[:, 2] - pair.lower_thrust)
        left.append(sum(float(np.mean(m**2)) / max(float(np.var(frame.measured[:, c])), 1e-12)
                        for m, c in zip(misses, (0, 2), strict=True)))  # fmt: skip
    if left[1] < SWAP * left[0] and left[0] > 1e-3:
        return (
            "with upper and lower exchanged the loads fit "
            f"{np.sqrt(left[0] / max(left[1], 1e-12)):.0f} times closer: labels or wires are swapped"
        )
    return None
