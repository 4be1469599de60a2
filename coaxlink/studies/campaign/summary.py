"""What a campaign's rows say: each law's figures, and laws against each other on a seed.

Intervals are 95 % percentile bootstrap intervals of the mean over draws (Efron 1979), from a fixed seed;
beyond BOOT_ROWS rows the normal ones, which are then the same.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.errors import InputError
from coaxlink.studies.campaign.spec import Spec

Array = NDArray[np.float64]
FIGURES: dict[str, str] = {  # what is compared, and its unit; smaller is better in all of them
    "height_rms_m": "m", "height_max_m": "m", "level_rms_m": "m", "tilt_rms_deg": "deg", "yaw_rms_deg": "deg",
    "roll_rate_rms_deg_s": "deg/s", "pitch_rate_rms_deg_s": "deg/s", "yaw_rate_rms_deg_s": "deg/s",
    "thrust_error_N": "N", "roll_error_Nm": "N m", "pitch_error_Nm": "N m", "yaw_error_Nm": "N m",
    "saturated": "1", "energy_Wh": "Wh",
}  # fmt: skip
RESAMPLES, BOOT_ROWS = 1000, 2000
WORST = 5  # cells of each law
Z95 = 1.959963984540054  # of a normal distribution, to the last digit: runs must agree


@dataclass(frozen=True)
class Spread:
    """One figure of one law over all flights that ended as planned."""

    mean: float
    ci: tuple[float, float]
    p5: float
    median: float
    p95: float


@dataclass(frozen=True)
class Paired:
    """One figure of a law less that of the reference, draw by draw."""

    difference: float  # mean
    ci: tuple[float, float]
    share: float  # of the reference's mean
    better: float  # share of draws in which it is the smaller
    p_value: float  # Wilcoxon's signed ranks, both ways


@dataclass(frozen=True)
class Worst:
    """One of a law's worst flights."""

    cell: int
    law: str
    value: float
    failsafe: str
    replay: str  # the command


@dataclass(frozen=True)
class LawCount:
    """How a law's flights ended."""

    flown: int
    failsafe: Mapping[str, int]
    problem: Mapping[str, int]


@dataclass(frozen=True)
class Summary:
    """The whole answer."""

    name: str
    rows: int
    laws: tuple[str, ...]
    counts: Mapping[str, LawCount]
    figures: Mapping[str, Mapping[str, Spread]]  # law, figure
    paired: Mapping[str, Mapping[str, Paired]]  # law, figure; against the first law
    worst: tuple[Worst, ...]
    judge: str
    manifest: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """As `campaign --json` writes it."""
        return {
            "campaign": self.name,
            "rows": self.rows,
            "laws": {
                law: {
                    "flown": c.flown, "failsafe": dict(c.failsafe), "problem": dict(c.problem),
                    "figures": {n: _plain(s) for n, s in self.figures[law].items()},
                    "against_first": {n: _plain(p) for n, p in self.paired.get(law, {}).items()},
                }
                for law, c in self.counts.items()
            },
            "judge": self.judge,
            "worst": [_plain(w) for w in self.worst],
            "manifest": dict(self.manifest),
        }  # fmt: skip


def _plain(thing: Any) -> dict[str, Any]:
    def safe(x: Any) -> Any:
        if isinstance(x, float):
            return x if math.isfinite(x) else None
        if isinstance(x, (tuple, list)):
            return [safe(v) for v in x]
        return {k: safe(v) for k, v in x.items()} if isinstance(x, Mapping) else x

    return {k: safe(v) for k, v in vars(thing).items()}


def summarise(
    spec: Spec, columns: Mapping[str, Any], replay: str, manifest: Mapping[str, Any] | None = None
) -> Summary:
    """Of columns (rows,) by name; `replay` is the command up to the cell's number. Raises InputError."""
    if spec.judge not in FIGURES:
        raise InputError("judge", spec.judge, f"one of {', '.join(FIGURES)} is expected")
    law = np.asarray(columns["law"])
    failsafe, problem = (np.asarray(columns[k]) for k in ("failsafe", "problem"))
    good = (failsafe == "") & (problem == "")
    counts, figures = {}, {}
    for name in spec.laws:
        mine = law == name
        counts[name] = LawCount(
            int((mine & (problem == "")).sum()), _tally(failsafe[mine]), _tally(problem[mine])
        )
        chosen = mine & good
        figures[name] = {f: _spread(np.asarray(columns[f], float)[chosen]) for f in FIGURES}
    return Summary(
        spec.name, len(law), spec.laws, counts, figures, _pairs(spec, columns, law, good),
        _worst(spec, columns, law, replay), spec.judge, manifest or {},
    )  # fmt: skip


def _tally(names: Any) -> dict[str, int]:
    found, counts = np.unique(names[names != ""].astype(str), return_counts=True)
    return dict(zip(found.tolist(), counts.tolist(), strict=True))


def mean_interval(x: Array, seed: int = 0) -> tuple[float, float]:
    """95 % interval of the mean of x (n,); (NaN, NaN) for fewer than 2."""
    if len(x) < 2:
        return math.nan, math.nan
    if len(x) > BOOT_ROWS:
        half = Z95 * float(x.std(ddof=1)) / math.sqrt(len(x))
        return float(x.mean()) - half, float(x.mean()) + half
    random = np.random.default_rng([seed, 0xB007])
    means = x[random.integers(len(x), size=(RESAMPLES, len(x)))].mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)


def _spread(x: Array) -> Spread:
    x = x[np.isfinite(x)]
    if not len(x):
        return Spread(math.nan, (math.nan, math.nan), math.nan, math.nan, math.nan)
    p5, median, p95 = np.quantile(x, [0.05, 0.5, 0.95])
    return Spread(float(x.mean()), mean_interval(x), float(p5), float(median), float(p95))


def _pairs(spec: Spec, columns: Mapping[str, Any], law: Any, good: Any) -> dict[str, dict[str, Paired]]:
    from scipy.stats import wilcoxon

    draw, first = np.asarray(columns["draw"]), spec.laws[0]
    found: dict[str, dict[str, Paired]] = {}
    for name in spec.laws[1:]:
        a, b = (np.flatnonzero((law == x) & good) for x in (first, name))
        _, i, j = np.intersect1d(draw[a], draw[b], return_indices=True)
        if len(i) < 2:
            continue
        found[name] = {}
        for figure in FIGURES:
            values = np.asarray(columns[figure], float)
            base, other = values[a[i]], values[b[j]]
            off = other - base
            p = float(wilcoxon(off).pvalue) if np.any(off != 0.0) else 1.0
            mean = float(base.mean())
            share = float(off.mean() / mean) if mean else math.nan
            found[name][figure] = Paired(
                float(off.mean()), mean_interval(off), share, float((off < 0.0).mean()), p
            )
    return found


def _worst(spec: Spec, columns: Mapping[str, Any], law: Any, replay: str) -> tuple[Worst, ...]:
    values = np.asarray(columns[spec.judge], float)
    failsafe, cell = np.asarray(columns["failsafe"]), np.asarray(columns["cell"])
    badness = np.where(failsafe != "", np.inf, np.nan_to_num(values, nan=-np.inf))
    found = []
    for name in spec.laws:
        mine = np.flatnonzero((law == name) & (badness > -np.inf))
        for k in mine[np.argsort(-badness[mine], kind="stable")][:WORST].tolist():
            number = int(cell[k])
            found.append(Worst(number, name, float(values[k]), str(failsafe[k]), f"{replay} {number}"))
    return tuple(found)
