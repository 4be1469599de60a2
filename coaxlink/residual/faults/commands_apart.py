"""A command against the others of its mixer: late, of another zero or scale from a moment on, or rounded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.resolution import resolution_of
from coaxlink.data.samples import Samples
from coaxlink.frames import Array
from coaxlink.residual.faults.mixer_demands import (
    DEMANDS,
    FEWEST,
    FIT_ROWS,
    LEAST_ROWS,
    design_of,
    independent_share,
)
from coaxlink.residual.faults.reference import SURE
from coaxlink.residual.faults.states import Finding, Mask

# priors: name = value  # unit, source
SHIFTS_S = np.linspace(-0.3, 0.3, 61)  # that are tried
LATE_S = 0.015  # three periods of an autopilot's outputs (200 Hz): its clocks and queues are apart by less
# of a command: the thrust of two propellers of one mould differs by twice that (Brandt and Selig)
SLIGHT = 0.01
USUAL = 0.2  # of the usual command, judgement
HALF = 0.5  # of what the others do not explain: so much has to be gone, judgement
MOMENTS, PARTS = 40, 8  # effort
# times the steps of the others, and of full command: 2 us of PWM's 1000, as autopilots round; judgement
COARSER, COARSE_STEP = 4.0, 2e-3


def commands_apart(log: Samples, names: Sequence[str], commands: Array, usable: Mask) -> Iterator[Finding]:
    """The one command that goes apart from what the others make of it, at rows free of limits."""
    if free := _Free.of(log, names, commands, usable):
        coarse = list(_coarse(log, names, commands, usable))
        yield from coarse or [*_late_somewhere(log, free), *_changed(log, free)][:1]


@dataclass(frozen=True)
class _Free:
    """Commands (rows, N) at rows free of limits and held columns, and each one's regressors (rows, K)."""

    names: Sequence[str]
    time: Array
    commands: Array
    rows: NDArray[np.intp]
    designs: list[Array]

    @classmethod
    def of(cls, log: Samples, names: Sequence[str], commands: Array, usable: Mask) -> _Free | None:
        rows, reach = np.flatnonzero(usable), SHIFTS_S[-1]
        if commands.shape[1] <= DEMANDS or not len(rows):
            return None
        time = log["time_s"]
        rows = rows[(time[rows] > time[rows[0]] + reach) & (time[rows] < time[rows[-1]] - reach)]
        rows = rows[:: max(1, len(rows) // FIT_ROWS)]
        if len(rows) < LEAST_ROWS:
            return None
        designs = [design_of(np.delete(commands, k, axis=1), usable)[rows] for k in range(len(names))]
        return cls(names, time, commands, rows, designs)

    def likeliest(self, ways: Callable[[int], tuple[Array, Array]]) -> tuple[str, int] | None:
        """The column and the way that leave least unexplained by the others, if that is sure: `ways`
        give of a column what is left of it as it is (rows,), and by each way (rows, ways).

        Rows count by the memory of what a way leaves: a step that it explains is no memory.
        """
        best, most = None, 0.0
        for k, name in enumerate(self.names):
            rest, by_way = ways(k)
            left = np.mean(by_way**2, axis=0)
            usual = float(np.mean(rest**2)) + FEWEST**2
            at = int(np.argmin(left))
            now, share = float(left[at]) + FEWEST**2, independent_share(by_way[:, at])
            log_evidence = 0.5 * len(rest) * share * float(np.log(usual / now)) - np.log(len(left))
            # what one column is off by, fits to the others have in part
            if log_evidence > SURE and now < HALF * usual and usual - now > most:
                best, most = (name, at), usual - now
        return best


def _rest(values: Array, design: Array) -> Array:
    """(rows, M) what a fit leaves of columns."""
    base, size, _ = np.linalg.svd(design, full_matrices=False)
    base = base[:, size > np.finfo(float).eps * len(design) * size[0]]
    return np.asarray(values - base @ (base.T @ values))


def _late_somewhere(log: Samples, free: _Free) -> Iterator[Finding]:
    """A command that is late in all of a log, or in its first or second half."""
    count = len(free.rows)
    for part in (slice(None), slice(0, count // 2), slice(count // 2, count)):
        if count // 2 < LEAST_ROWS and part != slice(None):
            return
        some = replace(free, rows=free.rows[part], designs=[d[part] for d in free.designs])
        if found := list(_late(log, some)):
            yield found[0]
            return


def _late(log: Samples, free: _Free) -> Iterator[Finding]:
    """A command that fits the others at another time."""
    known = np.flatnonzero(np.isfinite(free.commands).all(axis=1))
    none = int(np.argmin(np.abs(SHIFTS_S)))
    early = free.time[free.rows][:, None] + SHIFTS_S

    def ways(k: int) -> tuple[Array, Array]:
        moved = np.interp(early, free.time[known], free.commands[known, k])
        rest = _rest(moved, free.designs[k])
        return rest[:, none], rest

    best = free.likeliest(ways)
    if best and abs(SHIFTS_S[best[1]]) > LATE_S:
        late = float(SHIFTS_S[best[1]])
        way = "late" if late > 0.0 else "early"
        why = f"it fits the other commands {1000.0 * abs(late):.0f} ms {way}: this column's stamps are off"
        yield best[0], np.ones(log.rows, bool), why


def _changed(log: Samples, free: _Free) -> Iterator[Finding]:
    """A command that from some moment on has another zero or scale against the others."""
    total = free.commands[free.rows].sum(axis=1)
    usual = (
        np.abs(total / np.median(total) - 1.0) < USUAL
    )  # a mixer's curve is another near the ground's idle
    free = replace(free, rows=free.rows[usual], designs=[d[usual] for d in free.designs])
    time = free.time[free.rows]
    if len(time) < LEAST_ROWS:
        return
    moments = np.quantile(time, np.linspace(0.1, 0.9, MOMENTS))
    after = (time[:, None] >= moments).astype(float)

    def ways(k: int) -> tuple[Array, Array]:
        own = free.commands[free.rows, k]
        both = np.concatenate([own[:, None], after, after * (own - own.mean())[:, None]], axis=1)
        rest, x, z = np.split(_rest(both, free.designs[k]), [1, 1 + MOMENTS], axis=1)
        # least squares on two columns each, in closed form
        xx, zz, xz = (np.sum(a * b, axis=0) for a, b in ((x, x), (z, z), (x, z)))
        xy, zy = rest[:, 0] @ x, rest[:, 0] @ z
        det = np.maximum(xx * zz - xz**2, 1e-30)
        zero, scale = (xy * zz - zy * xz) / det, (zy * xx - xy * xz) / det
        gain = zero * xy + scale * zy
        fewer = np.minimum(after.sum(axis=0), len(time) - after.sum(axis=0))
        odd = (gain >= fewer * (SLIGHT * own.mean()) ** 2) & _sharp(rest[:, 0], time, moments)
        return rest[:, 0], rest - np.where(odd, x * zero + z * scale, 0.0)

    best = free.likeliest(ways)
    if best and not _mixer_changed(free, best[0], moments):
        why = f"at {moments[best[1]]:.1f} s its zero or scale changes against the other commands"
        yield best[0], np.ones(log.rows, bool), why


def _mixer_changed(free: _Free, suspect: str, moments: Array) -> bool:
    """Whether commands fit one another, a suspect left out, by one mixer before a moment and by another one
    behind it: a table that was uploaded between two flights moves them all, and then no column is off."""
    others = np.delete(free.commands[free.rows], free.names.index(suspect), axis=1)
    time, every = free.time[free.rows], np.ones(len(free.rows), bool)
    for j, own in enumerate(others.T):
        design = design_of(np.delete(others, j, axis=1), every)
        whole = float(np.mean(_rest(own, design) ** 2)) + FEWEST**2
        for moment in moments:
            first = time < moment
            if min(first.sum(), (~first).sum()) < LEAST_ROWS:
                continue
            rest = np.empty_like(own)
            for part in (first, ~first):
                rest[part] = _rest(own[part], design[part])
            now, rows = float(np.mean(rest**2)) + FEWEST**2, len(rest) * independent_share(rest)
            numbers = design.shape[1] * float(np.log(max(rows, 2.0)))  # twice as many as one mixer's (BIC)
            if 0.5 * (rows * float(np.log(whole / now)) - numbers) > SURE + np.log(len(moments)):
                return True
    return False


def _sharp(rest: Array, time: Array, moments: Array) -> Mask:
    """(moments,) near which a remainder (rows,) jumps within a second, and stays for three, by more than it
    is usually off by: a take-off, a hard turn, a pack that empties change it slowly or for a moment."""
    total, at = np.concatenate([[0.0], np.cumsum(rest)]), np.arange(len(time))
    jump = np.full(len(time), np.inf)
    for seconds in (1.0, 3.0):
        first, last = (np.searchsorted(time, time + d) for d in (-seconds, seconds))
        after = (total[last] - total[at]) / np.maximum(last - at, 1)
        before = (total[at] - total[first]) / np.maximum(at - first, 1)
        jump = np.minimum(jump, np.abs(after - before))
    near = 0.75 * float(np.max(np.diff(moments), initial=1.0))
    most = [jump[np.abs(time - m) <= near].max(initial=0.0) for m in moments]
    return np.asarray(np.array(most) > np.std(rest))


def _coarse(log: Samples, names: Sequence[str], commands: Array, flying: Mask) -> Iterator[Finding]:
    """A command that moves in far larger steps than the others, in some part of the flight."""
    for rows in np.array_split(np.flatnonzero(flying), PARTS):
        steps = np.array([resolution_of(commands[rows, k]) for k in range(len(names))])
        if len(rows) < LEAST_ROWS or not np.isfinite(steps).all():
            continue
        k = int(np.argmax(steps))
        others = float(np.max(np.delete(steps, k)))
        if steps[k] > max(COARSER * others, COARSE_STEP):
            why = f"it moves in steps of {steps[k]:.2g}, the other commands in {others:.1g}: rounded"
            yield names[k], np.ones(log.rows, bool), why
            return
