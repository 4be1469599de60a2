"""What the owner of an ArduPilot board tuned and a table must not undo: the spin range, the outputs.

A table is made for a spin range (MOT_SPIN_MIN, _MAX); the owner found his where the motors start and stop. So
his stays, and the table's curve is made for it: MOT_THST_EXPO and MOT_THST_HOVER mean other numbers there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from coaxlink.mavlink.parameters import Number
from firmware_params.ardupilot.parameters import MOTOR_FUNCTIONS
from firmware_params.ardupilot.table import expo_for

SPIN = ("MOT_SPIN_ARM", "MOT_SPIN_MIN", "MOT_SPIN_MAX")
EXPO, HOVER = "MOT_THST_EXPO", "MOT_THST_HOVER"
_SAME = 1e-6  # of a share; boards keep float32
_EXPO_RANGE = (-1.0, 1.0)  # AP_MotorsMulticopter.cpp, MOT_THST_EXPO
_HOVER_RANGE = (0.125, 0.6875)  # AP_MOTORS_THST_HOVER_MIN and _MAX


@dataclass(frozen=True)
class ForBoard:
    """A table's parameters as one board gets them, and what of the board's stays, in words."""

    params: Mapping[str, Number]
    kept: tuple[str, ...] = ()  # lines to say


def for_board(
    params: Mapping[str, Number], board: Mapping[str, Number], *, spin_from_table: bool = False
) -> ForBoard:
    """`params` of a table without what the owner of `board` tuned, its curve made for his spin range."""
    made, remarks = dict(params), []
    if not spin_from_table and all(n in board and n in params for n in SPIN):
        his, its = ([float(p[n]) for n in SPIN] for p in (board, params))
        if any(abs(a - b) > _SAME for a, b in zip(his, its, strict=True)):
            for name in SPIN:
                del made[name]
            changed = _curve(made, its, his)
            numbers = ", ".join(
                f"{n} {a:.4g} (table: {b:.4g})" for n, a, b in zip(SPIN, his, its, strict=True)
            )
            curve = ", ".join(f"{n} {params[n]:.4g} -> {made[n]:.4g}" for n in changed)
            made_for = f"; the table's curve is made for them: {curve}" if curve else ""
            remarks.append(
                f"stays as the board has it: {numbers}{made_for}; `spin_from_table` takes the table's"
            )
    outputs = [n for n in params if n.startswith("SERVO") and n.endswith("_FUNCTION")]
    if outputs and _drives_all(params, board):
        moved = [n for n in outputs if n in board and board[n] != params[n]]
        for name in outputs:
            del made[name]
        if moved:
            remarks.append(f"the board's motor outputs stay: {', '.join(f'{n} {board[n]:g}' for n in moved)}")
    return ForBoard(made, tuple(remarks))


def _drives_all(params: Mapping[str, Number], board: Mapping[str, Number]) -> bool:
    """Whether the board's outputs drive each motor of the table, and each one by one output."""

    def driven(of: Mapping[str, Number]) -> list[float]:
        functions = (float(of.get(f"SERVO{n}_FUNCTION", 0)) for n in range(1, 33))
        return sorted(f for f in functions if f in MOTOR_FUNCTIONS)

    return driven(board) == driven(params)


def _curve(made: dict[str, Number], old: list[float], new: list[float]) -> list[str]:
    """Set EXPO and HOVER of a table for another spin range; the names that changed.

    The table's own belief is thrust = f u^2 + (1 - f) u over normalised speed u: f follows from its EXPO and
    range (the inverse of `expo_for`), the EXPO of the other range from f; HOVER is the demand of as much
    thrust. Ranges that are none leave all as it is: the board's own checks name them.
    """
    _, low, high = old
    _, least, most = new
    if EXPO not in made or not (0.0 <= least < most <= 1.0 and 0.0 <= low < high <= 1.0):
        return []
    expo, span = float(made[EXPO]), high - low
    share = expo / (span * (1.0 - expo) + expo * (1.0 - 2.0 * low))
    changed = {EXPO: min(max(expo_for(share, least, most), _EXPO_RANGE[0]), _EXPO_RANGE[1])}

    def thrust(u: float) -> float:
        return share * u * u + (1.0 - share) * u

    if HOVER in made:
        demand = float(made[HOVER])
        half = (1.0 - expo) / (2.0 * expo) if abs(expo) > _SAME else 0.0
        fraction = math.sqrt(half * half + demand / expo) - half if half or expo == 1.0 else demand
        hover = (thrust(low + span * fraction) - thrust(least)) / (thrust(most) - thrust(least))
        changed[HOVER] = min(max(hover, _HOVER_RANGE[0]), _HOVER_RANGE[1])
    made.update({name: round(value, 6) for name, value in changed.items()})
    return list(changed)
