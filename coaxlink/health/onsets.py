"""When a fault may have set in: before the flight, at once within it, or gradually.

A grid of times stands for all: a hypothesis' prior is shared among them, so a time that was looked for costs
its logarithm (the Occam factor of a change point; MacKay 2003, chapter 28).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from coaxlink.effects.onset import MARGIN_S
from coaxlink.frames import Array
from coaxlink.signals import low_pass

STEPS = 24  # times of a sudden onset, evenly over the flight but for MARGIN_S on either side
# parts of a step of that grid where it matters, and how often: some hundredths of a second of a minute, less
# than what moves an edge by its noise
VARIANTS, ONSET_ROUNDS = 5, 3
PERIODS, FINE = 4.0, 64.0  # of the cutoff: an edge's half width, points in each
VARIANTS_LENGTHS = 3  # likewise of a gradual one's length
RAMPS = ((1.0, 1), (0.5, 5), (0.25, 7))  # shares of the flight that a gradual one takes, starts of each
# of faults in a flight: set in within it and not before (one flight of some ten since somebody last looked
# at the propellers); of these: not at once, for which there is no source
WITHIN, GRADUAL = 0.1, 0.5


@cache
def _edge() -> tuple[Array, Array]:
    """Times in periods of the cutoff, and what `low_pass` makes of a step at 0."""
    periods = np.arange(-PERIODS, PERIODS, 1.0 / FINE)
    return periods, low_pass((periods >= 0.0).astype(float), FINE, 1.0)


@dataclass(frozen=True)
class Onset:
    """A fault's time profile in its flight; `start_s` None: it was there from the first row."""

    start_s: float | None
    over_s: float
    prior: float  # of all onsets of one flight
    width_s: float = 0.0  # of the starts that it stands for
    octaves: float = 0.0  # of the lengths that it stands for

    @property
    def sudden(self) -> bool:
        """Whether it sets in at once within the flight."""
        return self.start_s is not None and self.over_s == 0.0

    @property
    def middle_s(self) -> float:
        """When half of it is there; minus infinity where it always was."""
        return -np.inf if self.start_s is None else self.start_s + 0.5 * self.over_s

    def time_profile(self, time_s: Array, cutoff_hz: float) -> Array:
        """(n,) 0 before it, 1 with all of it there; an edge as the rows' low-pass leaves it.

        >>> Onset(2.0, 4.0, 1.0).time_profile(np.array([0.0, 2.0, 4.0, 6.0, 8.0]), 4.0).tolist()
        [0.0, 0.0, 0.5, 1.0, 1.0]
        """
        if self.start_s is None:
            return np.ones(len(time_s))
        if self.over_s == 0.0:
            return np.interp((time_s - self.start_s) * cutoff_hz, *_edge())
        return np.asarray(np.clip((time_s - self.start_s) / self.over_s, 0.0, 1.0))


def onsets(time_s: Array) -> tuple[Onset, ...]:
    """All onsets of a flight with rows at these times, s; their priors add up to 1.

    >>> found = onsets(np.arange(600) / 10.0)
    >>> len(found), round(sum(o.prior for o in found), 9)
    (38, 1.0)
    """
    first, last = float(np.min(time_s)), float(np.max(time_s))
    span = last - first
    margin = min(MARGIN_S, span / 4.0)
    width = (span - 2.0 * margin) / STEPS
    steps = first + margin + width * (np.arange(STEPS) + 0.5)
    ramps = [
        (first + s, part * span) for part, many in RAMPS for s in np.linspace(0, (1 - part) * span, many)
    ]
    sudden = WITHIN * (1 - GRADUAL) / len(steps)
    slow = WITHIN * GRADUAL / len(ramps)
    return (
        Onset(None, 0.0, 1 - WITHIN),
        *(Onset(float(s), 0.0, sudden, width) for s in steps),
        # starts and lengths of the grid are no finer than half of a length
        *(Onset(float(s), float(over), slow, float(over) / 2.0, 1.0) for s, over in ramps),
    )


def variants(known: Sequence[Onset], at: Onset) -> tuple[Onset, ...]:
    """`at` split into parts with its prior: a sudden one with those beside it in time, a gradual one alone.

    >>> three = [Onset(s, 0.0, 0.3, 1.0) for s in (0.5, 1.5, 2.5)]
    >>> [round(o.middle_s, 1) for o in variants(three, three[0])][:6]
    [0.1, 0.3, 0.5, 0.7, 0.9, 1.1]
    """
    out: list[Onset] = []
    for o in known:
        near = o.sudden and at.sudden and abs(o.middle_s - at.middle_s) < 0.51 * (o.width_s + at.width_s)
        if o.start_s is None or not (near or o == at):
            out.append(o)
            continue
        lengths = (0.0,) if o.sudden else tuple(o.octaves * k / VARIANTS_LENGTHS for k in (-1, 0, 1))
        part = VARIANTS * len(lengths)
        for octaves in lengths:
            over = o.over_s * 2.0**octaves
            for k in range(VARIANTS):
                middle = o.middle_s + o.width_s * ((k + 0.5) / VARIANTS - 0.5)
                width = o.width_s / VARIANTS
                out.append(
                    Onset(middle - over / 2.0, over, o.prior / part, width, o.octaves / VARIANTS_LENGTHS)
                )
    return tuple(out)
