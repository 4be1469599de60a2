"""Columns that follow from others: the one that does so at another time, with another zero or scale from some
moment on, or in far larger steps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.resolution import resolution_of
from coaxlink.frames import Array
from coaxlink.instruments.chain import SURE
from coaxlink.instruments.findings import Mask
from coaxlink.instruments.flight.still import FEWEST, FIT_ROWS, LEAST_ROWS, independent_share

# priors: name = value  # unit, source
SHIFTS_S = np.linspace(-0.3, 0.3, 61)  # that are tried
PERIOD_S = 0.005  # of an autopilot's outputs, 200 Hz: what leaves in one turn of its loop has one stamp
LATE_S = 3.0 * PERIOD_S  # clocks and queues of one autopilot are apart by less, judgement
# of a column: the thrust of two propellers of one mould differs by twice that (Brandt and Selig)
SLIGHT = 0.01
HALF = 0.5  # of what the others do not explain: so much has to be gone, judgement
MOMENTS, PARTS = 40, 8  # effort
# times the steps of the others, and of full command or speed: 2 us of PWM's 1000, as they round; judgement
COARSER, COARSE_STEP = 4.0, 2e-3


@dataclass(frozen=True)
class Columns:
    """Columns of one kind (rows, N), some rows of them, and each one's regressors at these (K,)."""

    names: Sequence[str]
    time: Array
    values: Array
    rows: NDArray[np.intp]
    designs: list[Array]

    @classmethod
    def at(cls, names: Sequence[str], time: Array, values: Array, usable: Mask) -> Columns | None:
        """At usable rows, so far from their ends that a shift leaves none; without regressors.

        None where there are too few rows.
        """
        rows, reach = np.flatnonzero(usable), SHIFTS_S[-1]
        if not len(rows):
            return None
        rows = rows[(time[rows] > time[rows[0]] + reach) & (time[rows] < time[rows[-1]] - reach)]
        rows = rows[:: max(1, len(rows) // FIT_ROWS)]
        return cls(names, time, values, rows, []) if len(rows) >= LEAST_ROWS else None

    def take(self, some: Mask | slice) -> Columns:
        """Some of the rows."""
        return replace(self, rows=self.rows[some], designs=[d[some] for d in self.designs])

    def shifted(self, k: int) -> Array:
        """(kept, SHIFTS_S) of a column, so much later."""
        known = np.flatnonzero(np.isfinite(self.values).all(axis=1))
        return np.interp(self.time[self.rows][:, None] + SHIFTS_S, self.time[known], self.values[known, k])

    def off_by(self) -> list[float]:
        """(N,) mean squares of what the others leave of each."""
        own = self.values[self.rows].T
        return [float(np.mean(left(x, design) ** 2)) for x, design in zip(own, self.designs, strict=True)]

    def likeliest(
        self, ways: Callable[[int], tuple[Array, Array]], gone: float = HALF
    ) -> tuple[str, int] | None:
        """The column and the way that leave least unexplained by the others, if that is sure and so much of
        it is gone: `ways` give of a column what is left of it as it is (rows,), and by each (rows, ways).

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
            if log_evidence > SURE and now < (1.0 - gone) * usual and usual - now > most:
                best, most = (name, at), usual - now
        return best

    def halves(self) -> Iterator[Columns]:
        """All of it, then its first and its second half, where those have rows enough."""
        yield self
        if (count := len(self.rows) // 2) >= LEAST_ROWS:
            yield from (self.take(part) for part in (slice(0, count), slice(count, None)))

    def late(self, gone: float = HALF) -> tuple[str, float] | None:
        """The column that fits the others at another time, and by how much it comes later, s; so much of what
        it is off by has to be gone there."""
        none = int(np.argmin(np.abs(SHIFTS_S)))

        def ways(k: int) -> tuple[Array, Array]:
            rest = left(self.shifted(k), self.designs[k])
            return rest[:, none], rest

        best = self.likeliest(ways, gone)
        return (best[0], float(SHIFTS_S[best[1]])) if best else None

    def changed(self) -> tuple[str, float] | None:
        """The column whose zero or scale is another from a moment on, and when, s."""
        time = self.time[self.rows]
        moments = np.quantile(time, np.linspace(0.1, 0.9, MOMENTS))
        after = (time[:, None] >= moments).astype(float)

        def ways(k: int) -> tuple[Array, Array]:
            own = self.values[self.rows, k]
            both = np.concatenate([own[:, None], after, after * (own - own.mean())[:, None]], axis=1)
            rest, x, z = np.split(left(both, self.designs[k]), [1, 1 + MOMENTS], axis=1)
            # least squares on two columns each, in closed form
            xx, zz, xz = (np.sum(a * b, axis=0) for a, b in ((x, x), (z, z), (x, z)))
            xy, zy = rest[:, 0] @ x, rest[:, 0] @ z
            det = np.maximum(xx * zz - xz**2, 1e-30)
            zero, scale = (xy * zz - zy * xz) / det, (zy * xx - xy * xz) / det
            gain = zero * xy + scale * zy
            fewer = np.minimum(after.sum(axis=0), len(time) - after.sum(axis=0))
            odd = (gain >= fewer * (SLIGHT * own.mean()) ** 2) & _sharp(rest[:, 0], time, moments)
            return rest[:, 0], rest - np.where(odd, x * zero + z * scale, 0.0)

        best = self.likeliest(ways)
        return (best[0], float(moments[best[1]])) if best else None


def left(values: Array, design: Array) -> Array:
    """(rows, M) what a fit leaves of columns."""
    base, size, _ = np.linalg.svd(design, full_matrices=False)
    base = base[:, size > np.finfo(float).eps * len(design) * size[0]]
    return np.asarray(values - base @ (base.T @ values))


def rounded(
    names: Sequence[str], values: Array, flying: Mask, matters: float = COARSE_STEP
) -> tuple[str, float, float] | None:
    """The column (rows, N) that moves in far larger steps than the others, in some part of the flight; its
    steps, and theirs. Steps that are no larger than what matters are none."""
    for rows in np.array_split(np.flatnonzero(flying), PARTS):
        steps = np.array([resolution_of(values[rows, k]) for k in range(len(names))])
        if len(rows) < LEAST_ROWS or not np.isfinite(steps).all():
            continue
        k = int(np.argmax(steps))
        others = float(np.max(np.delete(steps, k)))
        if steps[k] > max(COARSER * others, matters):
            return names[k], float(steps[k]), others
    return None


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
