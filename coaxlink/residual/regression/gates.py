"""Tests that a trial effect must pass: other loads agree with it, and no few levels of speed carry it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

Array = NDArray[np.float64]
Index = NDArray[np.intp]

GAIN = 0.15  # of the squared error of the channel that gains most
# beside a nuisance fitted to the log: what the other loads must be due to be added, and how much they must
# show
SHOWN, BORNE_OUT = 9.0, 0.3
BY_FEW = 1e-3  # chance that levels which err together carry it
FEW_LEVELS = "a few levels carry it, where the fitted base may miss as much"


def autocorrelation_time(residual: Array, block: Index) -> Array:
    """(C,) variance inflation of sums of residuals (rows, C): 1 + 2 sum rho, summed while rho is positive."""
    same = [block[k:] == block[:-k] for k in range(1, 60) if k < len(block)]
    out = np.ones(residual.shape[1])
    for c in range(residual.shape[1]):
        r = residual[:, c]
        power = float(np.mean(r * r)) or 1.0
        for k, inside in enumerate(same, start=1):
            if inside.sum() < 30:
                break
            rho = float(np.mean(r[k:][inside] * r[:-k][inside])) / power
            if rho < 0.05:
                break
            out[c] += 2.0 * rho
    return out


def witnesses(channels: tuple[str, ...], shares: Array) -> str | None:
    """An instrument is flagged only by two witnesses: the loads and the throttle must contradict it alike."""
    gains = dict(zip(channels, shares, strict=True))
    loads = max((g for c, g in gains.items() if not c.endswith("_speed")), default=0.0)
    speeds = max((g for c, g in gains.items() if c.endswith("_speed")), default=1.0)
    return None if min(loads, speeds) > GAIN else "the loads and the throttle do not both contradict it"


def alone(drops: Array, added: Array, touched: NDArray[np.bool_]) -> str | None:
    """An effect that one load alone demands, while the others, which it must change as well, deny it.

    Falls of the square sums (C,) and what the effect as fitted adds to each channel, both in its variances;
    `touched` (C,) are the channels it acts on: another changes only as what is fitted beside it gives way. A
    base fitted to the log follows some loads worse than others, and a misfit of one is no cause of it.
    """
    others = touched & (np.arange(len(drops)) != int(np.argmax(drops)))
    due, had = float(added[others].sum()), float(drops[others].sum())
    if due < SHOWN or had >= BORNE_OUT * due:
        return None
    return "one load demands it, and the others, which must show it, do not"


def carried_by_few(change: Array, left: Array, variance: Array, clusters: Index) -> str | None:
    """Refuse an effect whose size is within chance when correlated errors count once (cluster-robust t test).

    What it adds (rows, C), what is left beside it, both with `variance` (C,): the sandwich variance of its
    size over `clusters` (Liang and Zeger 1986), and Student's t of as many degrees of freedom.
    """
    number = clusters.ravel()
    score = np.bincount(number, (change * left / variance).ravel())
    weight = np.bincount(number, (change**2 / variance).ravel())
    whole = float(weight.sum())
    used = weight > 1e-6 * whole
    count = int(used.sum())
    if whole <= 0.0 or count < 2:
        return FEW_LEVELS
    score = score - weight * float(score.sum()) / whole
    spread = np.sqrt(float(np.sum(score[used] ** 2)) * count / (count - 1))
    freedom = max(1.0, whole**2 / float(np.sum(weight**2)) - 1.0)
    if 2.0 * float(student.sf(whole / max(spread, 1e-12), freedom)) > BY_FEW:
        return FEW_LEVELS
    return None
