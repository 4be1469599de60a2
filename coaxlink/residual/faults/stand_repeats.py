"""Readings of a stand log that repeat digit by digit: a column that stands still, a limit, a copy.

A column of fine resolution does not read the same twice, a coarse one does whenever little moves: a run
counts where so many equal readings are no accident by how often the rest of the log repeats itself, and what
the column should have read moves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from coaxlink.data.resolution import is_coarse, resolution_of
from coaxlink.frames import STAND_CHANNELS, Array, StandFrame
from coaxlink.load import Load
from coaxlink.residual.channels.stand import COLUMN_OF, fitted_model
from coaxlink.residual.faults.states import Mask, runs_of

Finding = tuple[str, Mask, str]  # column, rows, why
# priors: name = value  # unit, source
BY_CHANCE = 1e-6  # logs in which so long a run is an accident
STUCK_ROWS, LONG_ROWS, LONG_SHARE = 4, 12, 0.02  # a run; one that tells where nothing should move; of the log
# of the reference load, by which it must move while a column stands still: the cell's own; what the others
# leave of it while a tachometer does; any of them while supply or current do
CELL_MOVES, SPEED_MOVES, RIG_MOVES = 0.02, 0.15, 0.1
PAUSE = 10.0  # times the usual step of time: another session begins
MARGIN = 0.02  # of the reference load: this near a limit the noise is cut off on one side
LEVELS, OFTEN = 10, 5.0  # readings of a cell with a limit; times the usual count that it reads the limit
ALIKE = 2.5  # steps of the readings: within them two cells may read the same by chance
COPIED_ROWS, FITTED_ROWS = 6, 24  # a run of copies; rows that a fit to the others wants
NO_CONTEXT = {"time_s", "log", *COLUMN_OF.values()}


def stuck_cells(frame: StandFrame) -> Iterator[Finding]:
    """Load cells at a limit, or that repeat one reading while the rotors turn."""
    rows = len(frame.time_s)
    for c in [c for c in frame.present if c < 4]:
        column, due = COLUMN_OF[STAND_CHANNELS[c]], frame.predicted[:, c]

        def moves(a: int, b: int, due: Array = due, size: float = float(frame.reference[c])) -> bool:
            # one that else never reads the same twice is stuck even where the load should stand still
            loaded = float(np.max(np.abs(due[a:b]))) > 0.05 * size
            still = b - a >= max(LONG_ROWS, LONG_SHARE * rows) and loaded
            return bool(still or np.ptp(due[a:b]) > CELL_MOVES * size)

        limit = _limited(frame, c)
        if limit is not None:
            yield column, limit[0], (
                f"the cell reads no further than {limit[1]:g}, where speeds give more: it is saturated"
            )  # fmt: skip
            continue
        stuck = _stuck(frame.measured[:, c], max(STUCK_ROWS, rows // 100), moves)
        if stuck.any():
            yield (
                column,
                stuck,
                ("one reading repeats exactly while the rotors turn and other cells do not stand still"),
            )


def stuck_tachometers(frame: StandFrame) -> Iterator[Finding]:
    """Tachometers that repeat one reading while the rotor's load goes up and down."""
    for side, column in enumerate(("upper_rpm", "lower_rpm")):
        c = next((c for c in (2 * side, 2 * side + 1) if c in frame.present), None)
        if frame.driven or c is None:
            continue
        read, least = frame.speeds[:, side], max(LONG_ROWS, int(LONG_SHARE * len(frame.time_s)))
        long = _stuck(read, least, lambda a, b: True)
        if not long.any():
            continue
        # what these rows bent to themselves tells nothing of them
        off = frame.measured[:, c] - _loads_without(frame, long, c)

        def moves(a: int, b: int, off: Array = off, size: float = float(frame.reference[c])) -> bool:
            return bool(np.ptp(np.quantile(off[a:b], [0.05, 0.95])) > SPEED_MOVES * size)

        stuck = _stuck(read, least, moves)
        if stuck.any():
            yield column, stuck, "one reading repeats exactly while the rotor's load goes up and down"


def stuck_context(frame: StandFrame) -> Iterator[Finding]:
    """Supply, current and the like that else never read the same twice, and repeat one reading.

    Not a whole session of one number, which somebody wrote down, and not a column whose steps are coarse.
    """
    rows, loads = len(frame.time_s), [c for c in frame.present if c < 4]
    step = np.diff(frame.time_s)
    begins = np.concatenate([[True], step > PAUSE * float(np.median(step)), [True]]) if rows > 1 else [True]

    def moves(a: int, b: int) -> bool:
        low, high = np.quantile(frame.measured[a:b, loads], [0.05, 0.95], axis=0)
        return bool(np.any(high - low > RIG_MOVES * frame.reference[loads]) and not (begins[a] and begins[b]))

    for name, values in frame.columns.items():
        ours = name in NO_CONTEXT or name.endswith(("_rpm", "_throttle")) or rows < 2 * LONG_ROWS
        if ours or is_coarse(values, resolution_of(values)):
            continue
        stuck = _stuck(values, max(LONG_ROWS, int(LONG_SHARE * rows)), moves)
        if stuck.any() and np.sum(~stuck) >= max(LONG_ROWS, 0.1 * rows):
            yield name, stuck, "one reading repeats exactly, which it does nowhere else, while the loads move"


def _stuck(values: Array, least: int, moves: Callable[[int, int], bool]) -> Mask:
    """(rows,) in runs of one reading which are no accident and in which something should move."""
    out = np.zeros(len(values), bool)
    same = np.concatenate([[False], np.diff(values) == 0.0])
    runs = [(a - 1, b) for a, b in runs_of(same)]
    long = [(a, b) for a, b in runs if b - a >= least and values[a] != 0.0]
    others = float(same.sum() - sum(b - a - 1 for a, b in long))
    chance = (others + 1.0) / (len(values) - sum(b - a for a, b in long) + 2.0)
    for a, b in long:
        if -(b - a - 1) * np.log(chance) > np.log(len(values) / BY_CHANCE) and moves(a, b):
            out[a:b] = True
    return out


def _loads_without(frame: StandFrame, rows: Mask, c: int) -> Array:
    """(rows,) a load at its speeds: the given model's, or what the rows outside a mask agree on."""
    model = frame.model
    if frame.free_nuisance and np.sum(~rows) > FITTED_ROWS:
        model = fitted_model(frame.speeds[~rows], frame.measured[~rows], [c], model.speed_max_rpm)
    return np.asarray(model.loads(frame.speeds[:, 0], frame.speeds[:, 1])[Load(c)])


def _limited(frame: StandFrame, c: int) -> tuple[Mask, float] | None:
    """(rows,) at a limit or so near it that it cuts the noise, and the limit; None for a cell without one."""
    values, size = frame.measured[:, c], float(frame.reference[c])
    levels, counts = np.unique(values[np.isfinite(values)], return_counts=True)
    if len(levels) < LEVELS:
        return None
    least = max(COPIED_ROWS, len(values) // 100, OFTEN * float(np.quantile(counts, 0.95)))
    for limit, count, sign in ((levels[-1], counts[-1], 1.0), (levels[0], counts[0], -1.0)):
        if limit == 0.0 or count < least:
            continue
        at = values == limit
        loads = _loads_without(frame, at, c)
        beyond = sign * (loads - limit) > -MARGIN * size
        if np.ptp(loads[at]) > 0.05 * size and np.mean(beyond[at]) > 0.8:
            return at | beyond, float(limit)
    return None


def repeated_rows(frame: StandFrame) -> Mask:
    """(rows,) whose loads, coarse ones aside, stand in the log before, all of them digit by digit."""
    measured = frame.measured
    # a coarse cell reads the same whenever the rotors turn alike
    fine = [
        c for c in frame.present if c < 4 and not is_coarse(measured[:, c], resolution_of(measured[:, c]))
    ]
    values, out = measured[:, fine], np.zeros(len(measured), bool)
    if len(fine) < 2:
        return out
    _, first, inverse = np.unique(values, axis=0, return_index=True, return_inverse=True)
    turning = np.any(np.abs(values) > 1e-9, axis=1)
    twin = (first[inverse.ravel()] != np.arange(len(values))) & turning
    for a, b in runs_of(twin):
        by_chance = (twin.sum() - (b - a)) / max(len(twin) - (b - a), 1)  # that a row has a twin
        if b - a >= 3 and len(twin) * by_chance ** (b - a) < 1e3 * BY_CHANCE:
            out[a:b] = True
    return out


def copied_columns(frame: StandFrame, usable: Mask) -> Iterator[Finding]:
    """Two columns that show the same readings, digit by digit, and should not."""
    for a, b in ((0, 2), (1, 3)):
        if {a, b} <= set(frame.present):
            same = _copied(usable, frame.measured[:, a], frame.measured[:, b])
            if same.any():
                names = ", ".join(COLUMN_OF[STAND_CHANNELS[c]] for c in (a, b))
                yield names, same, "both show the same readings, digit by digit"


def _copied(usable: Mask, a: Array, b: Array) -> Mask:
    """Runs of rows in which two cells read the same, that coarse readings do not bring by chance.

    How often two sound cells agree is told by the rows outside a run in which they read alike; where there
    are none, by how often either reads each of its values.
    """
    equal = usable & (a == b)
    out = np.zeros(len(usable), bool)
    values, counts = np.unique(np.concatenate([a[usable], b[usable]]), return_counts=True)
    meeting = float(np.sum((counts / counts.sum()) ** 2))
    alike = usable & (np.abs(a - b) < ALIKE * float(np.min(np.diff(values), initial=np.inf)))
    for first, end in runs_of(equal):
        if end - first < COPIED_ROWS or len(np.unique(a[first:end])) < 3:
            continue
        others = alike.copy()
        others[first:end] = False
        agree = max(meeting, float(np.sum(equal & others)) / max(int(others.sum()), COPIED_ROWS))
        if -(end - first) * np.log(min(agree, 1.0)) > 2.0 * np.log(len(a)) - np.log(BY_CHANCE):
            out[first:end] = True
    return out
