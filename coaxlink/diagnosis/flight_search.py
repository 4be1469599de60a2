"""A flight's posterior: every set is held against the others under the colour of what itself leaves."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from coaxlink.diagnosis.channels import Channels
from coaxlink.diagnosis.hypotheses import Hypothesis, Scorer, coloured
from coaxlink.diagnosis.noise import colour_of, white
from coaxlink.diagnosis.posterior import FEWEST, Posterior
from coaxlink.diagnosis.search import Search, Visited

FREE = "|0.1|0.02"  # length and size of the free forms that the first colour is taken beside
WEIGHED = 16  # sets under a colour of their own
STARTS = 4  # sets that the second round begins with


def flight_posterior(ch: Channels, progress: Callable[[str], None]) -> Posterior:
    """Search under the colour of what free forms over time leave, then of what the best effects leave.

    At last every set is weighed under the colour of what itself leaves: what wanders is noise to a set that
    does not explain it, at the price of a likelihood that the others beat where they explain it.
    """
    first = Scorer(ch, white(ch.count))
    free = [f for f in ch.forms if f.startswith("time_s|") and f.endswith(FREE)]
    beside = first.score((), free)

    def searched(left: Hypothesis, starts: Sequence[Hypothesis]) -> Visited:
        scorer = Scorer(ch, colour_of(left.left, ch.behind))
        return Search(scorer, lambda said: progress(f"weighing {said}")).run(starts)

    visited = searched(beside, ())
    plain = max((h for h in visited.by_names.values() if not h.forms), key=lambda h: h.score)
    visited = searched(plain, visited.ranked()[:STARTS])
    progress("weighing the noise")
    return _posterior(ch, [coloured(ch, h) for h in weighable(visited)])


def weighable(visited: Visited) -> list[Hypothesis]:
    """Sets that may still be the best under a colour of their own: the first, also without free forms."""
    ranked = visited.ranked()
    out = {h.names: h for h in ranked[:WEIGHED]}
    for effects in {h.effects for h in ranked[:WEIGHED]}:
        plain = visited.by_names.get(effects)
        if plain is not None:
            out[plain.names] = plain
    empty = visited.by_names[frozenset()]
    return list((out | {empty.names: empty}).values())


def _posterior(ch: Channels, visited: Sequence[Hypothesis]) -> Posterior:
    """Tempered about the set of most mass: found again until it stays the same."""
    sets = sorted(visited, key=lambda h: -h.score)
    lead = 0
    for _ in range(4):
        best = sets[lead]
        tempers = np.array([temper(ch, best, h) for h in sets])
        # all of the evidence, Occam's factor with it: a likelihood that counts less leaves wider posteriors
        evidence = np.array([best.fit.log_evidence - h.fit.log_evidence for h in sets]) * tempers
        behind = evidence + np.array([best.log_prior - h.log_prior for h in sets])
        now = int(np.argmin(behind))
        if now == lead:
            break
        lead = now
    weight = np.exp(np.clip(behind.min() - behind, -700.0, 0.0))
    misfit = np.array([_at_best(best) - _at_best(h) for h in sets]) * tempers
    return Posterior(tuple(sets), weight / weight.sum(), tempers, evidence, misfit)


def _at_best(h: Hypothesis) -> float:
    """Log density of the rows at a set's best numbers, and of these under their priors.

    Occam's factor apart: the widths of priors are good to a factor of a few. What numbers of the base would
    have to be is no matter of widths: rows that fit because six rotors are five deviations off do not fit.
    """
    return h.fit.log_evidence + float(np.sum(np.log(np.diag(h.fit.factor))))


def temper(ch: Channels, one: Hypothesis, other: Hypothesis) -> float:
    """Share of the evidence that counts: one over the dispersion of what tells two sets apart.

    About the one that fits better: what the other one leaves holds what tells them apart itself.
    """
    if one is other:
        return 1.0
    better, worse = (one, other) if _log_density(one) >= _log_density(other) else (other, one)
    noise, colour = better.fit.noise, better.colour
    left = colour.whiten(better.left) / noise
    apart = colour.whiten(worse.left - better.left) / noise
    product, power = left * apart, apart**2
    count = int(ch.block.max()) + 1
    if count < FEWEST or power.sum() <= 0.0:
        return 1.0
    by_block = np.array([np.bincount(ch.block, product[:, c], count) for c in range(product.shape[1])])
    return 1.0 / max(float(np.sum(by_block**2) / power.sum()), 1.0)


def _log_density(h: Hypothesis) -> float:
    left = h.colour.whiten(h.left) / h.fit.noise
    return float(-0.5 * np.sum(left**2) - len(left) * np.sum(np.log(h.fit.noise)))
