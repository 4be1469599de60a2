"""Long logs made short, and logs in time made a map: a row a condition."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.aliases import SIDES
from coaxlink.data.samples import Samples
from coaxlink.data.tare import at_rest

MOST_ROWS = 5_000  # rows: more only repeat what the stand has reported
STEADY = 0.02  # of the fastest speed: spread within which rows show one condition
DRIFT = 0.75 * STEADY  # of the fastest speed, from end to end of a stretch: a ramp fills all of STEADY
TELLING = 3  # rows: fewer tell no drift
TAILS = 0.25  # of a stretch's readings on either side: spikes, and what a step still had to go
GRID = 1.5  # grid steps of a map: rest this near to its rows is one of them, not an extrapolation


def thinned(samples: Samples, most: int = MOST_ROWS) -> Samples:
    """Every so manieth row, at most about `most`: enough to tell rotors, signs and units by."""
    step = max(1, samples.rows // most)
    return samples if step == 1 else samples.take(np.arange(0, samples.rows, step))


def conditions(samples: Samples, most: int = MOST_ROWS) -> Samples:
    """A row a condition: stretches of steady speed averaged, without rest and what lies between steps.

    Rows of one stretch are one measurement, however many they are: what a smooth model misses there does not
    average out. Where speeds hold still for most of the time, rows on the way from one level to the next are
    left out (load cells and inertia lag behind); where they go slowly, the ones in haste. Rest has told its
    tare (`tare`); as a row it would be an extrapolation, and stays only where the map comes down to it.
    Logs of a row a condition stay as they are. The notes say what was done.
    """
    speeds = _speeds(samples)
    if samples.rows < TELLING or not np.any(speeds > 0):
        return samples
    ends = _stretches(speeds)
    size = np.diff(ends)
    rest = 2 * np.add.reduceat(at_rest(samples).astype(int), ends[:-1]) > size
    still = np.array([_drift(speeds[a:b]) <= DRIFT for a, b in pairwise(ends)])
    slow = size >= TELLING
    kept = rest | next((k for k in (slow & still, slow) if _most(size, k, ~rest)), ~rest)
    means = _means(samples, ends, kept)
    if rest.any() and not _on_the_map(_speeds(means), rest[kept]):
        means = means.take(~rest[kept])
    if means.rows == samples.rows:
        return samples
    parts = ("on the way between them", int(size[~kept].sum())), ("at rest", int(size[rest].sum()))
    left = " and ".join(f"{count} {what}" for what, count in parts if count)
    note = f"{samples.rows} rows as {means.rows} steady stretches{f', {left} apart' if left else ''}"
    return thinned(means.with_notes(note), most)


def _speeds(samples: Samples) -> NDArray[np.float64]:
    """(rows, columns) of what rotors turn and are told to, each of its fastest."""
    names = [f"{side}_{what}" for what in ("rpm", "throttle") for side in SIDES]
    columns = [samples[name] for name in names if samples.has(name)]
    full = [max(float(np.abs(c).max(initial=0.0)), 1e-300) for c in columns]
    return np.stack(columns, axis=1) / full if columns else np.zeros((samples.rows, 0))


def _stretches(speeds: NDArray[np.float64]) -> NDArray[np.int64]:
    """(stretches + 1,) first rows of runs in which no speed (rows, columns) spreads by more than STEADY.

    Found from the end on: a step is settled at its end.
    """
    first = [len(speeds)]
    low = high = speeds[-1].tolist()
    for row, now in zip(range(len(speeds) - 1, -1, -1), speeds[::-1].tolist(), strict=True):
        wide_low, wide_high = list(map(min, low, now)), list(map(max, high, now))
        if any(b - a > STEADY for a, b in zip(wide_low, wide_high, strict=True)):
            first.append(row + 1)
            low = high = now
        else:
            low, high = wide_low, wide_high
    return np.array([0, *first[::-1]])


def _most(size: NDArray[np.int64], kept: NDArray[np.bool_], among: NDArray[np.bool_]) -> bool:
    """Whether the stretches (stretches,) that are kept hold most of the rows among which they are."""
    return 2 * int(size[kept & among].sum()) > int(size[among].sum())


def _drift(speeds: NDArray[np.float64]) -> float:
    """How far the speeds (rows, columns) of a stretch go from end to end, by medians of its outer thirds."""
    third = max(1, len(speeds) // 3)
    change = np.median(speeds[-third:], axis=0) - np.median(speeds[:third], axis=0)
    return float(np.abs(change).max()) * (len(speeds) - 1) / max(len(speeds) - third, 1)


def _means(samples: Samples, ends: NDArray[np.int64], kept: NDArray[np.bool_]) -> Samples:
    """The stretches that are kept, a row each: means of their readings without the tails."""
    spans = [(a, b) for (a, b), keep in zip(pairwise(ends), kept, strict=True) if keep]
    columns = {n: np.array([_middle(c[a:b]) for a, b in spans]) for n, c in samples.columns.items()}
    lines = None if samples.lines is None else samples.lines[[a for a, _ in spans]]
    return replace(samples, columns=columns, lines=lines)


def _middle(values: NDArray[np.float64]) -> float:
    """Mean of the middle half of the readings that are there; of all of them where they are few."""
    known = np.sort(values[np.isfinite(values)])
    cut = int(TAILS * len(known))
    return float(known[cut : len(known) - cut].mean()) if len(known) else float("nan")


def _on_the_map(speeds: NDArray[np.float64], rest: NDArray[np.bool_]) -> bool:
    """Whether rest is as near to a row (rows, columns) that turns as such rows are to one another."""
    from scipy.spatial import cKDTree

    turning = speeds[~rest]
    if len(turning) < TELLING:
        return True
    step = float(np.median(cKDTree(turning).query(turning, k=2)[0][:, 1]))
    return float(np.linalg.norm(turning, axis=1).min()) <= GRID * step
