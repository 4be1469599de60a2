"""What the live loop counts, in memory that does not grow: counters, running errors, a latency histogram."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

LOWEST_S = 1e-6
PER_DECADE = 48  # bins 4.9 % wide
DECADES = 7


@dataclass
class Histogram:
    """Times from 1 us to 10 s on a logarithmic scale; percentiles to within a bin (5 %)."""

    bins: list[int] = field(default_factory=lambda: [0] * (PER_DECADE * DECADES + 1))
    total: int = 0
    largest_s: float = 0.0

    def add(self, seconds: float) -> None:
        """Count one time; what is outside goes into the end bins."""
        index = int(PER_DECADE * math.log10(seconds / LOWEST_S)) if seconds > LOWEST_S else 0
        self.bins[min(index, len(self.bins) - 1)] += 1
        self.total += 1
        if seconds > self.largest_s:
            self.largest_s = seconds

    def percentile(self, percent: float) -> float:
        """The time (s) below which `percent` of all lie; 0 when nothing was counted."""
        wanted, cumulative = self.total * percent / 100.0, 0
        for index, count in enumerate(self.bins):
            cumulative += count
            if count and cumulative >= wanted:
                return min(LOWEST_S * 10.0 ** ((index + 0.5) / PER_DECADE), self.largest_s)
        return self.largest_s


@dataclass
class Counters:
    """What the loop did, from the start of it."""

    cycles: int = 0  # demands answered (or, in a dry run, that would have been)
    clamped: int = 0  # of them, demands a little over the message's range
    dropped: int = 0  # of them, demands for which the law gave an axis up
    not_finite: int = 0
    absurd: int = 0
    other_group: int = 0
    late: int = 0  # not newer than the last
    stale: int = 0  # may be too old, by the vehicle's own clock
    clock_jumps: int = 0
    superseded: int = 0
    settling: int = 0
    foreign: int = 0
    refused_outputs: int = 0
    failures: int = 0
    hand_overs: int = 0
    reduced_flown: int = 0  # answers of the reduced mixer, where the exact law's would have missed more
    latency: Histogram = field(default_factory=Histogram)
    # |delivered - demand|, by the rotor model
    error_sum: list[float] = field(default_factory=lambda: [0.0] * 4)
    error_max: list[float] = field(default_factory=lambda: [0.0] * 4)

    def answered(self, latency_s: float, error: Sequence[float], gave_up: bool) -> None:
        """Count an answer, its allocation error (4,) in N and N m, and whether the law gave an axis up."""
        self.cycles += 1
        self.dropped += gave_up
        self.latency.add(latency_s)
        for k, e in enumerate(error):
            self.error_sum[k] += abs(e)
            self.error_max[k] = max(self.error_max[k], abs(e))

    def account(self, seconds: float) -> dict[str, Any]:
        """All of it as `coaxlink mix --json` writes it, after so many seconds."""
        n = max(self.cycles, 1)
        return {
            "cycles": self.cycles,
            "seconds": seconds,
            "rate_hz": self.cycles / seconds if seconds > 0 else 0.0,
            "latency_us": {
                "p50": self.latency.percentile(50) * 1e6,
                "p99": self.latency.percentile(99) * 1e6,
                "max": self.latency.largest_s * 1e6,
            },
            "allocation_error": {"mean": [e / n for e in self.error_sum], "max": list(self.error_max)},
            "clamped_demands": self.clamped,
            "axes_given_up": self.dropped,
            "hand_overs": self.hand_overs,
            "reduced_mixer_flown": self.reduced_flown,
            "unanswered": self.unanswered(),
        }

    def unanswered(self) -> dict[str, int]:
        """Demands that got no answer, by reason."""
        names = (
            "not_finite", "absurd", "late", "stale", "clock_jumps", "other_group", "superseded", "settling",
            "foreign", "refused_outputs", "failures",
        )  # fmt: skip
        return {name: getattr(self, name) for name in names}
