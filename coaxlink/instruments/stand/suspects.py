"""Data that cannot be what their labels say: stuck cells, lying tachometers, repeats, wrong labels and units.

Found before anything is fitted; the rows are left out, or the column where all of it is concerned, or, where
nothing that is left could be trusted, nothing is claimed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from coaxlink.channels.stand import COLUMN_OF
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.frames import STAND_CHANNELS, StandFrame
from coaxlink.instruments.findings import Mask, Suspect, rows_text
from coaxlink.instruments.stand.lies import lies, slips
from coaxlink.instruments.stand.repeats import (
    copied_columns,
    repeated_rows,
    stuck_cells,
    stuck_context,
    stuck_tachometers,
)
from coaxlink.instruments.stand.spikes import spikes
from coaxlink.instruments.stand.states import Faulty

LEAST_LEFT = 8  # rows
MOST_FROZEN = 0.5  # of the rows
ARM, USUAL_ARM = (0.002, 0.5), 0.03  # m: torque over thrust of any rotor between a hand's width and 4 m


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

    def reported(self, found: Faulty) -> None:
        """Flag what a state of the chain is about."""
        state = found.state
        if not found.of_all_rows:
            return self.rows(state.columns, found.rows, found.why)
        loads = [] if state.exchanged else [COLUMN_OF[STAND_CHANNELS[c]] for c in state.channels]
        self.swapped |= state.exchanged == "speeds" or state.side >= 0
        throttles = state.columns.split(", ") if state.exchanged == "throttles" else []
        return self.throughout(state.columns, found.why, *loads, *throttles)

    @property
    def silent(self) -> bool:
        """Whether nothing is left to be claimed."""
        loads = {COLUMN_OF[STAND_CHANNELS[c]] for c in self.frame.present if c < 4}
        return bool(self.swapped or loads <= set(self.columns) or np.sum(~self.bad) < LEAST_LEFT)


def find_suspects(frame: StandFrame) -> FlaggedColumns:
    """All that contradicts its label in a log."""
    found = _Finding(frame, [], np.zeros(len(frame.time_s), bool), [])
    for column, rows, why in (*stuck_cells(frame), *stuck_tachometers(frame)):
        found.rows(column, rows, why)
    repeated = repeated_rows(frame) & ~found.bad
    if repeated.any():
        found.rows("all loads", repeated, "these readings stand in the log before, digit by digit")
    for column, rows, why in (*copied_columns(frame, ~found.bad), *spikes(frame, ~found.bad)):
        found.rows(column, rows, why)
    if not found.silent:
        for reported in lies(frame, ~found.bad):
            found.reported(reported)
        for columns, why in _odd_arms(frame, ~found.bad) if frame.free_nuisance else ():
            found.throughout(", ".join(columns), why, *columns)
    if not found.silent:
        for reported in slips(frame, ~found.bad):
            found.reported(reported)
        # where half of a log and more stands still, the column is of no use; else these rows are of none
        for name, rows, why in stuck_context(frame):
            if np.mean(rows) < MOST_FROZEN:
                found.rows(name, rows, why)
            else:
                found.throughout(name, why, name)
    return FlaggedColumns(tuple(found.suspects), found.bad, tuple(found.columns), found.silent)


def _odd_arms(frame: StandFrame, usable: Mask) -> Iterator[tuple[list[str], str]]:
    """Loads of rotors whose torque over thrust no rotor has, with what they may be instead."""
    arms: dict[int, float] = {}
    for side in (0, 1):
        if {2 * side, 2 * side + 1} <= set(frame.present):
            loads = frame.measured[usable][:, 2 * side : 2 * side + 2]
            thrust, torque = np.quantile(np.abs(loads), 0.95, axis=0)
            if min(thrust, torque) > 0.0:
                arms[side] = float(torque / thrust)
    usual = next((arm for arm in arms.values() if ARM[0] < arm < ARM[1]), USUAL_ARM)
    for side, arm in arms.items():
        if ARM[0] < arm < ARM[1]:
            continue
        t, q = (COLUMN_OF[STAND_CHANNELS[2 * side + k]] for k in (0, 1))
        guesses = {
            "torque and thrust exchanged?": (1.0 / arm, [t, q]),
            "torque in N cm?": (arm / 100.0, [q]),
            "torque in N mm?": (arm / 1000.0, [q]),
            "thrust in gf?": (arm * 1000.0 / GRAVITY_M_S2, [t]),
        }
        guess = min(guesses, key=lambda name: abs(np.log(guesses[name][0] / usual)))
        yield guesses[guess][1], f"torque over thrust is {arm:.3g} m, which no rotor has: {guess}"
