"""From scores to probabilities: what the log says of every name, over all sets that were visited.

No form is exact and no noise is white: what one hypothesis explains beyond another is believed only as far as
it hangs together with what is left over. The likelihood is tempered by the sandwich's dispersion (White 1982;
Gruenwald and van Ommen 2017, Miller and Dunson 2019 on tempering under misfit), taken over blocks.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from coaxlink.evidence.noise import Colour
from coaxlink.frames import Array
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.hypotheses import Hypothesis, form_name

CLAIMED = 0.99
RIVAL = 0.01  # of the mass: less is no rival
FEWEST = 4  # blocks


@dataclass(frozen=True)
class Posterior:
    """Visited sets, best first, and the mass of each; `best` is the one all are held against."""

    sets: tuple[Hypothesis, ...]
    mass: Array  # (S,)
    temper: Array  # (S,) of the likelihood against the best one's
    behind: Array  # (S,) nats behind it, tempered, before any odds of an explanation being there
    misfit: Array  # (S,) of these, what the rows themselves say: no width of a prior is in it

    @property
    def best(self) -> Hypothesis:
        """The set of most mass."""
        return self.sets[int(np.argmax(self.mass))]

    def of(self, name: str) -> float:
        """Probability that an explanation is there."""
        return self.any_of([name])

    def any_of(self, names: Iterable[str]) -> float:
        """Probability that one of several is there."""
        names = set(names)
        return float(sum(m for m, h in zip(self.mass, self.sets, strict=True) if h.names & names))

    def index(self, h: Hypothesis) -> int:
        """Of a set among the visited ones."""
        return next(k for k, other in enumerate(self.sets) if other is h)

    def evidence_behind(self, h: Hypothesis) -> float:
        """Tempered, odds and all."""
        return float(self.behind[self.index(h)] - h.log_prior)

    def without(self, names: Iterable[str]) -> Hypothesis | None:
        """The set of most mass that holds none of these names."""
        names = set(names)
        ranked = [
            (m, h.score, k)
            for k, (m, h) in enumerate(zip(self.mass, self.sets, strict=True))
            if not h.names & names
        ]
        return self.sets[max(ranked)[2]] if ranked else None

    @property
    def effects(self) -> dict[str, float]:
        """Probability of every effect that some set holds."""
        return {n: self.of(n) for n in sorted({n for h in self.sets for n in h.effects})}

    @property
    def forms(self) -> dict[str, float]:
        """Probability of every free form, by variable and channel."""
        return {n: self.of(n) for n in sorted({form_name(f) for h in self.sets for f in h.forms})}


def posterior(
    ch: Channels, colour: Colour, visited: Sequence[Hypothesis], *, whole: bool = False
) -> Posterior:
    """Tempered about the set of most mass: found again until it stays the same.

    Each pair is tempered by what is between the two; of sets that beat one another in a circle the one of
    most evidence leads.

    `whole`: of the evidence all counts less, not the likelihood alone: what corrections give way for hangs
    together with what is left over as the fit does.
    """
    sets = sorted(visited, key=lambda h: -h.score)
    led: list[int] = []
    lead, settled = 0, False
    while True:
        best = sets[lead]
        tempers = np.array([temper(ch, colour, best, h) for h in sets])
        if whole:
            data = np.array([best.fit.log_evidence - h.fit.log_evidence for h in sets])
        else:
            data = np.array([likelihood(colour, best, h) for h in sets])
        behind = data * tempers + (np.array([best.score - h.score for h in sets]) - data)
        now = int(np.argmin(behind))
        if now == lead or settled:
            break
        led.append(lead)
        lead, settled = (min(led[led.index(now) :]), True) if now in led else (now, False)
    behind = np.maximum(behind, 0.0)
    weight = np.exp(np.clip(behind.min() - behind, -700.0, 0.0))
    odds = np.array([sets[lead].log_prior - h.log_prior for h in sets])
    return Posterior(tuple(sets), weight / weight.sum(), tempers, behind - odds, data * tempers)


def likelihood(colour: Colour, best: Hypothesis, rival: Hypothesis) -> float:
    """Log likelihood by which one fits better than another, each with its noise."""
    return _log_density(colour, best) - _log_density(colour, rival)


def _log_density(colour: Colour, h: Hypothesis) -> float:
    left = colour.whiten(h.left) / h.fit.noise
    return float(-0.5 * np.sum(left**2) - colour.rows(len(left)) @ np.log(h.fit.noise))


def temper(ch: Channels, colour: Colour, best: Hypothesis, rival: Hypothesis) -> float:
    """Share of the likelihood that counts: one over the dispersion of what tells the two apart."""
    if best is rival:
        return 1.0
    # what is left of the worse of the two still holds what tells them apart: that is no misfit of the better
    better = best if _log_density(colour, best) >= _log_density(colour, rival) else rival
    noise = better.fit.noise
    left = colour.whiten(better.left) / noise
    apart = colour.whiten(rival.left - best.left) / noise
    product, power = left * apart, apart**2
    count = int(ch.block.max()) + 1
    if count < FEWEST or power.sum() <= 0.0:
        return 1.0
    by_block = np.array([np.bincount(ch.block, product[:, c], count) for c in range(product.shape[1])])
    dispersion = float(np.sum(by_block**2) / power.sum())
    return 1.0 / max(dispersion, 1.0)
