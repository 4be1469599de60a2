"""What a campaign's rows say: each law's figures, laws against each other on a seed, what errors follow.

Intervals are 95 % percentile bootstrap intervals of the mean over draws (Efron 1979), from a fixed seed;
beyond BOOT_ROWS rows the normal ones, which are then the same. Sensitivity is Spearman's rank correlation
with Fisher's interval; for a quantity of names, the share of the ranks' variance between its groups.
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
LEAST_FLIGHTS = 10  # of a law, for what its errors follow
WORST = 5  # cells of each law
Z95 = 1.959963984540054
CHANCE = 1e-3  # of one false word among all sensitivities that are looked at


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
class Sensitivity:
    """How a law's figure follows a varied quantity."""

    law: str
    figure: str
    quantity: str
    strength: float  # rank correlation -1..1; of names: share of the ranks' variance, 0..1
    ci: tuple[float, float] | None
    p_value: float


@dataclass(frozen=True)
class LawCount:
    """How a law's flights ended."""

    flown: int
    failsafe: Mapping[str, int]
    problem: Mapping[str, int]


@dataclass(frozen=True)
class Refined:
    """What refine said of the logs, against what was true."""

    logs: int
    right: int  # named all of what was true and nothing else
    clean: int  # logs with nothing in them
    clean_named: int  # of these, with something named
    missed: Mapping[str, tuple[int, int]]  # effect: not named, logs that had it


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
    sensitivities: tuple[Sensitivity, ...]  # all that were looked at
    judge: str
    refined: Refined | None = None
    manifest: Mapping[str, Any] = field(default_factory=dict)

    @property
    def clear(self) -> tuple[Sensitivity, ...]:
        """Sensitivities beyond chance over all that were looked at, the strongest first."""
        limit = CHANCE / max(len(self.sensitivities), 1)
        return tuple(
            sorted((d for d in self.sensitivities if d.p_value < limit), key=lambda d: -abs(d.strength))
        )

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
            "sensitivity": [_plain(d) for d in self.sensitivities],
            "refined": None if self.refined is None else _plain(self.refined),
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
        _worst(spec, columns, law, replay), _sensitivities(spec, columns, law, good), spec.judge,
        _refined(columns) if spec.refine else None, manifest or {},
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


def _sensitivities(spec: Spec, columns: Mapping[str, Any], law: Any, good: Any) -> tuple[Sensitivity, ...]:
    varied = [n for n in columns if n in spec.quantities and len(set(columns[n].tolist())) > 1]
    found = []
    for name in spec.laws:
        chosen = np.flatnonzero((law == name) & good)
        if len(chosen) < LEAST_FLIGHTS:
            continue
        for quantity in varied:
            of = np.asarray(columns[quantity])[chosen]
            for figure in FIGURES:
                y = np.asarray(columns[figure], float)[chosen]
                if spec.quantities[quantity].text:
                    found.append(Sensitivity(name, figure, quantity, *_by_groups(of.astype(str), y)))
                    continue
                x = of.astype(float)
                x = np.abs(x) if quantity.endswith(".size") else x
                if np.ptp(x) > 0.0 and np.ptp(y) > 0.0:
                    found.append(Sensitivity(name, figure, quantity, *_by_rank(x, y)))
    return tuple(found)


def _by_rank(x: Array, y: Array) -> tuple[float, tuple[float, float], float]:
    """Spearman's rank correlation, its interval (Bonett and Wright 2000) and its chance."""
    from scipy.stats import spearmanr

    rho, p_value = (float(v) for v in spearmanr(x, y))
    half = Z95 * math.sqrt((1.0 + rho * rho / 2.0) / (len(x) - 3))
    middle = math.atanh(min(max(rho, -1 + 1e-12), 1 - 1e-12))
    return rho, (math.tanh(middle - half), math.tanh(middle + half)), p_value


def _by_groups(of: Any, y: Array) -> tuple[float, None, float]:
    """Share of the ranks' variance between groups (Kruskal and Wallis), and its chance."""
    from scipy.stats import kruskal

    groups = [y[of == g] for g in np.unique(of)]
    if np.ptp(y) == 0.0 or len(groups) < 2:
        return 0.0, None, 1.0
    h, p_value = kruskal(*groups)
    return float(h) / (len(y) - 1), None, float(p_value)


def _refined(columns: Mapping[str, Any]) -> Refined:
    pairs = [(str(t or ""), str(f or "")) for t, f in zip(columns["truth"], columns["found"], strict=True)]
    missed: dict[str, list[int]] = {}
    for truth, found in pairs:
        for name in filter(None, truth.split(",")):
            count = missed.setdefault(name, [0, 0])
            count[0] += name not in found.split(",")
            count[1] += 1
    clean = [found for truth, found in pairs if not truth]
    return Refined(
        len(pairs), sum(t == f for t, f in pairs), len(clean), sum(bool(f) for f in clean),
        {name: (a, b) for name, (a, b) in sorted(missed.items())},
    )  # fmt: skip
