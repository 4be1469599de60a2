"""A command against the others of its mixer: late, of another zero or scale from a moment on, or rounded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from coaxlink.data.samples import Samples
from coaxlink.frames import Array
from coaxlink.residual.faults.apart import MOMENTS, Columns, left, rounded
from coaxlink.residual.faults.mixer_demands import DEMANDS, FEWEST, LEAST_ROWS, design_of, independent_share
from coaxlink.residual.faults.reference import SURE
from coaxlink.residual.faults.states import Finding, Mask

# priors: name = value  # unit, source
PERIOD_S = 0.005  # of an autopilot's outputs, 200 Hz: what leaves in one turn of its loop has one stamp
LATE_S = 3.0 * PERIOD_S  # clocks and queues of one autopilot are apart by less, judgement
USUAL = 0.2  # of the usual command, judgement


def commands_apart(log: Samples, names: Sequence[str], commands: Array, usable: Mask) -> Iterator[Finding]:
    """The one command that goes apart from what the others make of it, at rows free of limits."""
    free = Columns.at(names, log["time_s"], commands, usable)
    if free is None or commands.shape[1] <= DEMANDS:
        return
    every = np.ones(log.rows, bool)
    if coarse := rounded(names, commands, usable):
        name, step, others = coarse
        why = f"it moves in steps of {step:.2g}, the other commands in {others:.1g}: rounded"
        yield name, every, why
        return
    designs = [design_of(np.delete(commands, k, axis=1), usable)[free.rows] for k in range(len(names))]
    free = replace(free, designs=designs)
    for some in free.halves():
        if (late := some.late()) and abs(late[1]) > PERIOD_S:
            ms, way = 1000.0 * abs(late[1]), "late" if late[1] > 0.0 else "early"
            yield (
                late[0],
                every,
                f"it fits the other commands {ms:.0f} ms {way}: this column's stamps are off",
            )
            return
    total = commands[free.rows].sum(axis=1)  # a mixer's curve is another near the ground's idle
    free = free.take(np.abs(total / np.median(total) - 1.0) < USUAL)
    changed = free.changed() if len(free.rows) >= LEAST_ROWS else None
    if changed and not _mixer_changed(free, changed[0]):
        why = f"at {changed[1]:.1f} s its zero or scale changes against the other commands"
        yield changed[0], every, why


def _mixer_changed(free: Columns, suspect: str) -> bool:
    """Whether commands fit one another, a suspect left out, by one mixer before a moment and by another one
    behind it: a table that was uploaded between two flights moves them all, and then no column is off."""
    others = np.delete(free.values[free.rows], free.names.index(suspect), axis=1)
    time, every = free.time[free.rows], np.ones(len(free.rows), bool)
    moments = np.quantile(time, np.linspace(0.1, 0.9, MOMENTS))
    for j, own in enumerate(others.T):
        design = design_of(np.delete(others, j, axis=1), every)
        whole = float(np.mean(left(own, design) ** 2)) + FEWEST**2
        for moment in moments:
            first = time < moment
            if min(first.sum(), (~first).sum()) < LEAST_ROWS:
                continue
            rest = np.empty_like(own)
            for part in (first, ~first):
                rest[part] = left(own[part], design[part])
            now, rows = float(np.mean(rest**2)) + FEWEST**2, len(rest) * independent_share(rest)
            numbers = design.shape[1] * float(np.log(max(rows, 2.0)))  # twice as many as one mixer's (BIC)
            if 0.5 * (rows * float(np.log(whole / now)) - numbers) > SURE + np.log(len(moments)):
                return True
    return False
