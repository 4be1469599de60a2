"""Data that cannot be what their labels say: stuck cells, lying tachometers, repeats, wrong labels and units.

Found before anything is fitted; the rows are left out, or the column where all of it is concerned, or, where
nothing that is left could be trusted, nothing is claimed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.frames import STAND_CHANNELS, Array, StandFrame, rows_of
from coaxlink.residual.channels.stand import COLUMN_OF, fitted_model
from coaxlink.residual.faults.cell_gain import gain_steps
from coaxlink.residual.faults.column_labels import mislabels
from coaxlink.residual.faults.context_columns import frozen_columns
from coaxlink.residual.faults.load_cells import (
    clipped_rows,
    dropped_rows,
    names_of,
    odd_arms,
    repeated_rows,
    stuck_rows,
)
from coaxlink.residual.faults.row_ranges import Mask
from coaxlink.residual.faults.tachometers import biased_readings, coarse_step, stuck_readings
from coaxlink.residual.faults.throttle_labels import crossed_throttles
from coaxlink.residual.result import Suspect

SWAP = 0.25  # of the squares left when the labels are exchanged
LEAST_LEFT = 8  # rows
MOST_FROZEN = 0.5  # of the rows
RESTART_ROWS = 5  # judgement: within which a clock that was restarted begins


@dataclass(frozen=True)
class FlaggedColumns:
    """What of a stand log cannot be trusted."""

    suspects: tuple[Suspect, ...]
    bad: Mask  # (rows,) to leave out
    columns: tuple[str, ...]  # to leave out
    mislabelled: bool  # the labels as a whole are wrong: nothing can be claimed


@dataclass
class _Finding:
    """What was found so far."""

    frame: StandFrame
    suspects: list[Suspect]
    bad: Mask
    columns: list[str]
    swapped: bool = False  # or else so wrong that nothing can be claimed

    def rows(self, column: str, rows: Mask, why: str) -> None:
        """Flag a column in some rows."""
        self.bad |= rows
        self.suspects.append(Suspect(column, rows_text(rows), why))

    def throughout(self, column: str, why: str, *leave_out: str) -> None:
        """Flag a column throughout."""
        self.suspects.append(Suspect(column, "all", why))
        self.columns += leave_out

    @property
    def silent(self) -> bool:
        """Whether nothing is left to be claimed."""
        loads = {COLUMN_OF[STAND_CHANNELS[c]] for c in self.frame.present if c < 4}
        return bool(self.swapped or loads <= set(self.columns) or np.sum(~self.bad) < LEAST_LEFT)


def find_suspects(frame: StandFrame) -> FlaggedColumns:
    """All that contradicts its label in a log."""
    found = _Finding(frame, [], np.zeros(len(frame.time_s), bool), [])
    _look_at_stamps(found)
    _look_at_cells(found)
    _look_at_labels(found)
    if not found.silent:
        _look_at_plugs(found)
        _look_at_drives(found)
        _look_at_context(found)
    if not found.silent:
        for step in gain_steps(frame, ~found.bad):
            found.rows(COLUMN_OF[STAND_CHANNELS[step.channel]], step.rows, step.why)
    return FlaggedColumns(tuple(found.suspects), found.bad, tuple(found.columns), found.silent)


def _look_at_stamps(found: _Finding) -> None:
    """Rows whose stamp is before one that stands above them: a clock set back, blocks in the wrong order."""
    time = found.frame.context("time_s")
    if time is None or len(time) < 2:
        return
    step = float(np.median(np.abs(np.diff(time))))
    # a session of its own begins where the first one did
    anew = np.concatenate([[True], (np.diff(time) < 0.0) & (time[1:] <= time[0] + RESTART_ROWS * step)])
    rows = np.zeros(len(time), bool)
    for run in np.split(np.arange(len(time)), np.flatnonzero(anew)[1:]):
        rows[run] = time[run] < np.maximum.accumulate(time[run])
    if rows.any():
        why = "time goes back: what follows from one row to the next is not known here"
        found.rows("time_s", rows, why)


def _look_at_cells(found: _Finding) -> None:
    frame = found.frame
    for c in [c for c in frame.present if c < 4]:
        column, stuck, clipped = COLUMN_OF[STAND_CHANNELS[c]], stuck_rows(frame, c), clipped_rows(frame, c)
        if clipped is not None:
            why = f"the cell reads no further than {clipped[1]:g}, where speeds give more: it is saturated"
            found.rows(column, clipped[0], why)
        elif stuck.any():
            why = "one reading repeats exactly while the rotors turn and other cells do not stand still"
            found.rows(column, stuck, why)
    for side, name in enumerate(("upper_rpm", "lower_rpm")):
        stuck = stuck_readings(frame, side)
        if stuck.any():
            found.rows(name, stuck, "one reading repeats exactly while the rotor's load goes up and down")
    repeated = repeated_rows(frame) & ~found.bad
    if repeated.any():
        found.rows("all loads", repeated, "these readings stand in the log before, digit by digit")


def _look_at_plugs(found: _Finding) -> None:
    frame = found.frame
    for c in [c for c in frame.present if c < 4 and COLUMN_OF[STAND_CHANNELS[c]] not in found.columns]:
        dropped = dropped_rows(frame, c, ~found.bad)
        if dropped.any():
            why = "it reads nothing for some rows while the rotor pulls: a plug or a wire is loose"
            found.rows(COLUMN_OF[STAND_CHANNELS[c]], dropped, why)


def _look_at_context(found: _Finding) -> None:
    """Where half of a log and more stands still, the column is of no use; else these rows are of none."""
    for name, rows in frozen_columns(found.frame):
        why = "one reading repeats exactly, which it does nowhere else, while the loads move"
        if np.mean(rows) < MOST_FROZEN:
            found.rows(name, rows, why)
        else:
            found.throughout(name, why, name)


def _look_at_labels(found: _Finding) -> None:
    frame = found.frame
    if found.silent:
        return
    for wrong in mislabels(frame, ~found.bad):
        if not wrong.of_all_rows:
            found.rows(wrong.way.columns, wrong.rows, wrong.why)
            continue
        names = [] if wrong.way.speeds else [COLUMN_OF[STAND_CHANNELS[c]] for c in wrong.way.channels]
        found.throughout(wrong.way.columns, wrong.why, *names)
        found.swapped |= wrong.way.speeds
    for channels, why in odd_arms(frame, ~found.bad) if frame.free_nuisance else ():
        found.throughout(names_of(channels), why, *names_of(channels).split(", "))
    if not found.silent and not found.columns:
        said = _swapped(rows_of(frame, np.flatnonzero(~found.bad)))
        if said is not None:
            found.throughout("upper_*, lower_* speeds", said)
            found.swapped = True


def _look_at_drives(found: _Finding) -> None:
    names = ("upper_throttle", "lower_throttle")
    crossed = crossed_throttles(found.frame, ~found.bad)
    if crossed is not None and crossed.of_all_rows:
        found.throughout(", ".join(names), crossed.why, *names)
        return
    if crossed is not None:
        found.rows(", ".join(names), crossed.rows, crossed.why)
    for side in (0, 1):
        step = coarse_step(found.frame, side)
        if step is not None:  # loads of speeds that nobody knows
            why = f"reads in steps of {100 * step:.1f} % of full speed, while the throttle moves far finer"
            found.throughout(f"{('upper', 'lower')[side]}_rpm", why)
            found.swapped = True
    if found.silent:
        return
    sound = np.flatnonzero(~found.bad)
    for bias in biased_readings(rows_of(found.frame, sound)) if len(sound) >= LEAST_LEFT else ():
        rows = np.zeros(len(found.bad), bool)
        rows[sound[bias.rows]] = True
        found.rows(f"{('upper', 'lower')[bias.side]}_rpm", rows, bias.why)


def rows_text(mask: Array | NDArray[np.bool_]) -> str:
    """Row ranges of a mask, counted from 1: "12-30, 44"."""
    rows = np.flatnonzero(mask)
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    shown = [f"{r[0] + 1}-{r[-1] + 1}" if len(r) > 1 else f"{r[0] + 1}" for r in runs[:6]]
    return ", ".join(shown) + (f" and {len(runs) - 6} more" if len(runs) > 6 else "")


def _swapped(frame: StandFrame) -> str | None:
    """Only the lower rotor feels the other's wake; where only the upper one does, labels are swapped."""
    if not {0, 2} <= set(frame.present) or min(np.ptp(frame.speeds, axis=0)) < 0.2:
        return None
    left = []
    for u in (frame.speeds, frame.speeds[:, ::-1]):
        model = fitted_model(u, frame.measured, [0, 2], frame.model.speed_max_rpm)
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
