"""What of a stand log repeats digit by digit (`repeats`), held against what it should have read."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from coaxlink.channels.stand import COLUMN_OF, fitted_model
from coaxlink.frames import STAND_CHANNELS, Array, StandFrame
from coaxlink.instruments.findings import Mask
from coaxlink.instruments.repeats import alike_rows, copied_rows, held_runs, is_fine, limits_of
from coaxlink.instruments.stand.states import RPM
from coaxlink.load import Load

Finding = tuple[str, Mask, str]  # column, rows, why
# priors: name = value  # unit, source
LONG_ROWS, LONG_SHARE = 12, 0.02  # a run that tells where nothing should move; of the log
# of the reference load, by which it must move while a column stands still: the cell's own; what the others
# leave of it while a tachometer does; any of them while supply or current do
CELL_MOVES, SPEED_MOVES, RIG_MOVES = 0.02, 0.15, 0.1
PAUSE = 10.0  # times the usual step of time: another session begins
MARGIN = 0.02  # of the reference load: this near a limit the noise is cut off on one side
FITTED_ROWS = 24  # rows that a fit to the others wants
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
            why = f"the cell reads no further than {limit[1]:g}, where speeds give more: it is saturated"
            yield column, limit[0], why
            continue
        stuck = _stuck(frame.measured[:, c], rows // 100, moves)
        if stuck.any():
            why = "one reading repeats exactly while the rotors turn and other cells do not stand still"
            yield column, stuck, why


def stuck_tachometers(frame: StandFrame) -> Iterator[Finding]:
    """Tachometers that repeat one reading while the rotor's load goes up and down."""
    for side, column in enumerate(RPM):
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
        if ours or not is_fine(values):
            continue
        stuck = _stuck(values, max(LONG_ROWS, int(LONG_SHARE * rows)), moves)
        if stuck.any() and np.sum(~stuck) >= max(LONG_ROWS, 0.1 * rows):
            yield name, stuck, "one reading repeats exactly, which it does nowhere else, while the loads move"


def _stuck(values: Array, least: int, moves: Callable[[int, int], bool]) -> Mask:
    """(rows,) in runs of one reading other than zero in which something should move."""
    out = np.zeros(len(values), bool)
    for a, b in held_runs(values, least):
        out[a:b] = values[a] != 0.0 and moves(a, b)
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
    for limit, sign in limits_of(values):
        at = values == limit
        loads = _loads_without(frame, at, c)
        beyond = sign * (loads - limit) > -MARGIN * size
        if np.ptp(loads[at]) > 0.05 * size and np.mean(beyond[at]) > 0.8:
            return at | beyond, limit
    return None


def repeated_rows(frame: StandFrame) -> Mask:
    """(rows,) whose loads, coarse ones aside, stand in the log before, all of them digit by digit."""
    values = frame.measured
    # a coarse cell reads the same whenever the rotors turn alike
    fine = [c for c in frame.present if c < 4 and is_fine(values[:, c])]
    turning = np.any(np.abs(values[:, fine]) > 1e-9, axis=1)
    return copied_rows(values[:, fine]) & turning if len(fine) > 1 else np.zeros(len(values), bool)


def copied_columns(frame: StandFrame, usable: Mask) -> Iterator[Finding]:
    """Two columns that show the same readings, digit by digit, and should not."""
    for a, b in ((0, 2), (1, 3)):
        if {a, b} <= set(frame.present):
            same = alike_rows(usable, frame.measured[:, a], frame.measured[:, b])
            if same.any():
                names = ", ".join(COLUMN_OF[STAND_CHANNELS[c]] for c in (a, b))
                yield names, same, "both show the same readings, digit by digit"
