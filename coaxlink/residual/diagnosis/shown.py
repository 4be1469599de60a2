"""What a log would have shown: of every effect the smallest size, and which other it would have passed for.

Read from the columns alone, beside what the best set has taken up already: expected nats grow with the square
of an effect's size, and another effect takes away the part that its own columns can draw.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from coaxlink.effects.parameter import Linear
from coaxlink.frames import Array
from coaxlink.residual.diagnosis.hypotheses import begun
from coaxlink.residual.diagnosis.posterior import RIVAL
from coaxlink.residual.diagnosis.search import Candidate, Search
from coaxlink.residual.members import Member


@dataclass(frozen=True)
class Shown:
    """The smallest size of an effect that would have been named."""

    share: float  # of the reference load, 95th percentile over the rows
    channel: str
    member: Member  # of that size
    alike: tuple[str, ...]  # effects that this log would not tell it from, the likest first


def would_show(search: Search, log_evidence: float, *, limited: bool = False) -> dict[str, Shown]:
    """Of every effect, how large it had to be to gain so many nats beside the best set, and where.

    Of an effect's plain shapes the middle one counts, and of what physics allows as a whole alone, as a lag,
    no part. It passes for another effect that leaves it no more than the odds of one in a hundred. `limited`:
    corrections go no further than two deviations, and what they cannot take shows.
    """
    best, ch = search.visited.best, search.channels
    every = None if limited else _Together.of(search)
    sizes: dict[str, list[tuple[float, float, int, Candidate]]] = {}
    for c, (_, _, columns) in zip(search.candidates, ch.grid, strict=True):
        information = every.of_some(c) if every else search.beside(best, c)[0]
        size = float(np.sqrt(2.0 * log_evidence * _spread(information)))
        if limited:
            mine = c.white[..., 0] / best.fit.noise**2
            along = np.einsum("rcp,rc->p", search.scorer.white, mine) / np.sum(mine * c.white[..., 0])
            taken = float(np.abs(along) @ (2.0 * search.scorer.deviation))
            size = min(size, taken + float(np.sqrt(2.0 * log_evidence * _spread(search.alone(best, c)))))
        size = max(size, _least(c))
        share = np.quantile(np.abs(columns[..., 0]), 0.95, axis=0) / ch.reference
        k = int(np.argmax(share))
        sizes.setdefault(c.effect.name, []).append((float(share[k]) * size, size, k, c))
    middle = {n: sorted(mine, key=lambda s: s[0])[len(mine) // 2] for n, mine in sizes.items()}
    alike = every.alike([c for *_, c in middle.values()], log_evidence) if every else {}
    return {
        name: Shown(share, ch.names[k], _of_size(search, c, size), alike.get(name, ()))
        for name, (share, size, k, c) in middle.items()
    }


@dataclass(frozen=True)
class _Together:
    """All candidates side by side beside the best set, each free to take from the others."""

    candidates: Sequence[Candidate]
    information: Array  # (K, K) of all coefficients
    places: Mapping[int, Array]  # of each, by identity

    @classmethod
    def of(cls, search: Search) -> _Together:
        """Of a search."""
        every = search.candidates
        white = np.concatenate([c.white for c in every], axis=-1)
        deviation = np.concatenate([c.deviation for c in every])
        one = Candidate(every[0].effect, every[0].shape, white, deviation)
        ends = np.cumsum([0, *(len(c.deviation) for c in every)])
        places = {id(c): np.arange(a, b) for c, (a, b) in zip(every, pairwise(ends), strict=True)}
        return cls(every, search.beside(search.visited.best, one)[0], places)

    def of_some(self, *some: Candidate) -> Array:
        """(K, K) of some of them, the others left out."""
        at = np.concatenate([self.places[id(c)] for c in some])
        return self.information[np.ix_(at, at)]

    def alike(self, several: Sequence[Candidate], log_evidence: float) -> dict[str, tuple[str, ...]]:
        """Of each, the effects that in one of their shapes take all but a rival's odds of its nats."""
        out: dict[str, tuple[str, ...]] = {}
        for c in several:
            alone = _spread(self.of_some(c))
            left: dict[str, float] = {}
            for other in (o for o in self.candidates if o.effect.name != c.effect.name):
                determined = log_evidence * alone / _spread(self.of_some(c, other))
                left[other.effect.name] = min(determined, left.get(other.effect.name, np.inf))
            likest = sorted(left, key=lambda name: left[name])
            out[c.effect.name] = tuple(name for name in likest if left[name] < -np.log(RIVAL))
        return out


def _least(c: Candidate) -> float:
    """The least that physics has of the first amount, where there is any: a lag has all motors late."""
    first = next(p for p in c.effect.effect.amounts if p.name in c.shape)
    return 0.0 if isinstance(first.amount, Linear) else max(first.low, 0.0)


def _spread(information: Array) -> float:
    """Variance of the first of coefficients."""
    rest = information[1:, 1:]
    factor, info = dpotrf(rest, lower=1) if rest.size else (rest, 0)
    if info:  # some of them are others' sums, but for rounding
        return max(float(np.linalg.pinv(information, hermitian=True)[0, 0]), 1e-300)
    taken = dtrtrs(factor, information[1:, :1], lower=1)[0] if rest.size else rest
    return 1.0 / max(float(information[0, 0] - np.sum(taken**2)), 1e-300)


def _of_size(search: Search, c: Candidate, size: float) -> Member:
    """The candidate with its first coefficient that large, of the sign that physics allows."""
    ch = search.channels
    both = [
        begun(ch, c.effect, c.shape, np.r_[sign * size, np.zeros(len(c.deviation) - 1)]) for sign in (1, -1)
    ]
    allowed = [m for m in both if c.effect.refuse(m.parameters(ch.bare)) is None]
    return [*allowed, *both][0]
