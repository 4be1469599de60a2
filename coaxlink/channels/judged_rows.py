"""Which rows of a stand log a load is judged in, once their speeds are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.samples import Samples
from coaxlink.errors import InputError
from coaxlink.frames import STAND_CHANNELS, Array
from coaxlink.load import Load
from coaxlink.rotor import RotorModel
from coaxlink.rotor.drive import TURNS
from coaxlink.rotor.drive_fit import driven
from coaxlink.rotor.physics import WAKE_TURNS

LEAST_ROWS = 16  # judgement: one load over one speed (12 rows) and a few to be held out
FEW_ROWS = 8  # enough to hold a given model against, not to find anything
SETTINGS = 0.2  # of the rows: more different speeds than that are not set-points
# of a speed's range, and how often (judgement): who sets a speed does not take it up, down and up by little
TREMBLES, OFTEN = 0.02, 3
IDLE = 0.04  # of full speed
MOST_TURNED = 0.4  # of the rows, judgement: more is a torque that reads something else


def set_points(u: Array) -> bool:
    """Whether speeds (rows, 2) are what somebody asked for: tachometers do not repeat to the last digit, and
    a coarse one, which does, trembles between its steps.
    """
    for column in u.T:
        turning = column[column > 0.0]
        if len(np.unique(turning)) > SETTINGS * len(turning):
            return False
        moves = np.diff(column)
        small = np.abs(moves) < TREMBLES * np.ptp(column)
        turns = (moves[1:] * moves[:-1] < 0.0) & small[1:] & small[:-1]
        if np.sum(turns[1:] & turns[:-1]) >= OFTEN:
            return False
    return len(u) > LEAST_ROWS


def turned_by_throttle(
    u: Array, throttle: Array, torque: Array, keep: NDArray[np.intp], notes: list[str]
) -> NDArray[np.intp]:
    """Rows without those in which the upper rotor's wake helps to turn the lower one: no drive is fitted to
    such rows, and none is held against them.
    """
    drives = driven(u[:, 1], torque) & (throttle > TURNS)
    wake = ~drives & (u[:, 0] > WAKE_TURNS * u[:, 0].max()) & (u[:, 1] > TURNS)
    if not wake[keep].any() or np.mean(wake[keep]) > MOST_TURNED:
        return keep
    notes.append(
        f"{wake[keep].sum()} rows in which the wake turns the lower rotor, not its throttle: not judged"
    )
    return keep[~wake[keep]]


def where_measured(
    model: RotorModel,
    samples: Samples,
    u: Array,
    present: list[int],
    keep: NDArray[np.intp],
    notes: list[str],
) -> tuple[list[int], NDArray[np.intp]]:
    """Channels and rows whose loads the model's own stand measured: elsewhere it is an extrapolation, and
    what is left of it tells nothing. InputError where no load is left.
    """
    at = model.measured_at(u)[keep]
    upper_feels = any(
        powers[1] for load in Load if load.rotor == 0 for powers in model.surface(load).exponents
    )
    rows = {c: at.all(axis=1) if c in (2, 3) or upper_feels else at[:, 0] for c in present if c < 4}
    unknown = [c for c, known in rows.items() if np.sum(known) < min(FEW_ROWS, len(keep))]
    if unknown:
        names = ", ".join(STAND_CHANNELS[c] for c in unknown)
        notes.append(f"{names}: not judged, the model's stand did not run the rotors at these speeds")
        present = [c for c in present if c not in unknown]
    if not rows.keys() - unknown:
        need = "loads where the model's stand measured them are needed, or a model of this log (`identify`)"
        raise InputError(samples.source, "", f"the rotors turn as they did not on the model's stand; {need}")
    known = np.logical_and.reduce([rows[c] for c in rows if c not in unknown])
    if not known.all():
        notes.append(f"{np.sum(~known)} rows: not judged, the model's stand did not run the rotors so")
    return present, keep[known]


def idle(u: Array) -> NDArray[np.bool_]:
    """(rows,) where the lower rotor barely turns in a wake: it stalls and windmills.

    At rest for longer than a row it is not idle: what the upper rotor does alone is seen there.
    """
    rest = u[:, 1] <= 0.0
    lasting = rest & np.roll(rest, 1) & np.roll(rest, -1)
    return np.asarray((u[:, 0] > IDLE) & (u[:, 1] < IDLE) & ~lasting)
