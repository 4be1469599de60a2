"""What a new table does to the rate loops, and the gains that keep them as they were.

A rate controller's output is a demand; a table decides how many N m a unit of it is. Gains that are scaled by
(old N m per unit) / (new N m per unit) leave the loops as they are. PX4: MC_*RATE_K multiplies P, I and D
(MulticopterRateControl); ArduPilot: ATC_RAT_*_P, _I and _D each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from coaxlink.tables.behaviour import TURNS, Behaviour

NAMES = {
    "px4": (("MC_ROLLRATE_K",), ("MC_PITCHRATE_K",), ("MC_YAWRATE_K",)),
    "ardupilot": tuple(
        tuple(f"ATC_RAT_{axis}_{letter}" for letter in "PID") for axis in ("RLL", "PIT", "YAW")
    ),
}
_ALIKE = 0.03  # a gain that changes by less is within what a battery does to it in one flight
_PX4_K = (0.01, 5.0)  # range of MC_*RATE_K in PX4's own metadata


@dataclass(frozen=True)
class AxisGain:
    """One axis of rotation under a new table."""

    axis: str  # roll, pitch, yaw
    scale: float  # of the rate gains; not finite or not positive: the axis is lost or turned round
    names: tuple[str, ...]  # the parameters that hold its rate gains
    held: Mapping[str, float]  # what the board has of them

    @property
    def usable(self) -> bool:
        """Whether a gain can mend it."""
        return 0.0 < self.scale < math.inf

    @property
    def wanted(self) -> dict[str, float]:
        """The gains that keep the loop as it was, of those the board holds."""
        return {name: value * self.scale for name, value in self.held.items()} if self.usable else {}


def axis_gains(
    firmware: str, flown: Behaviour, reference: Behaviour, board: Mapping[str, float | int]
) -> tuple[AxisGain, ...]:
    """(3,) for roll, pitch and yaw; `board` are the parameters on it, as far as they are known."""
    found = []
    for axis, names, scale in zip(TURNS, NAMES[firmware], flown.gain_hint(reference), strict=True):
        found.append(AxisGain(axis, scale, names, {n: float(board[n]) for n in names if n in board}))
    return tuple(found)


@dataclass(frozen=True)
class PreservedGains:
    """What a table does to the rate loops, in a line, and the gains that go with it."""

    axes: tuple[AxisGain, ...]  # (3,)
    line: str
    written: Mapping[str, float]  # parameters that become part of the table; empty unless requested
    problem: str  # why some of them are not

    def to_json(self) -> dict[str, Any]:
        """The key `rate_gains` of the JSON of `table`."""
        rows = [
            {
                "axis": gain.axis,
                "scale": gain.scale if gain.usable else None,
                "on_board": dict(gain.held),
                "keeps_the_loop": gain.wanted,
            }
            for gain in self.axes
        ]
        return {"rate_gains": rows}


def preserved_gains(
    firmware: str,
    flown: Behaviour,
    reference: Behaviour,
    board: Mapping[str, float | int],
    against: str,
    *,
    write: bool,
) -> PreservedGains:
    """Hold a table's gains against another's on the same rotors; with `write`, also those to set."""
    axes = axis_gains(firmware, flown, reference, board)
    written, problem = wanted_gains(firmware, axes) if write else ({}, "")
    line = gains_line(axes, against)
    if any(gain.usable and abs(gain.scale - 1.0) > _ALIKE for gain in axes):
        line += (
            "; gains that keep the loops are in the table"
            if written
            else "; `keep_gains` writes gains for it"
        )
    return PreservedGains(axes, line, written, problem)


def gains_line(gains: tuple[AxisGain, ...], against: str) -> str:
    """One sentence for the first lines of `table` and `upload`."""
    lost = [g.axis for g in gains if not g.usable]
    if lost:
        return f"rate loops: {' and '.join(lost)} lost or turned round against {against}; no gain mends that"
    moved = [g for g in gains if abs(g.scale - 1.0) > _ALIKE]
    if not moved:
        return f"rate loops: a demand gives what it gives {against}; the gains can stay"
    parts = ", ".join(f"{1.0 / g.scale:.2f} ({g.axis})" for g in moved)
    return f"rate loops: the same demand gives {parts} times the moment that it gives {against}"


def wanted_gains(firmware: str, gains: tuple[AxisGain, ...]) -> tuple[dict[str, float], str]:
    """The gains to write, and why some are not; only those that the board holds."""
    wanted = {name: value for gain in gains for name, value in gain.wanted.items()}
    outside = [n for n, v in wanted.items() if firmware == "px4" and not _PX4_K[0] <= v <= _PX4_K[1]]
    if outside:
        shown = ", ".join(f"{n} = {wanted[n]:.3g}" for n in outside)
        low, high = _PX4_K
        return {}, f"{shown} is outside {low:g}..{high:g}: scale P, I and D of these axes instead"
    missing = [name for gain in gains for name in gain.names if name not in gain.held]
    return wanted, f"not known on board: {', '.join(missing)}" if missing else ""
