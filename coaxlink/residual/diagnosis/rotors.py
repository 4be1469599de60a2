"""Which rotor it is: every rotor, and every way of it to lose, a hypothesis of the same evidence.

Two rotors of a pair push at one place. What tells them apart is their spin, and what a lost thrust does to
the drag torque; where that is not known well, one of them with less thrust and more drag is the other one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coaxlink.evidence.noise import COLOUR_ROUNDS, colour_of, white
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.hypotheses import ROTOR, Hypothesis, Scorer, begun
from coaxlink.residual.diagnosis.posterior import CLAIMED, posterior
from coaxlink.residual.members import Member

# a blade that lifts less, a motor that turns slower: where the fit begins
WAYS = ({"thrust_loss": 0.1, "torque_loss": 0.1}, {"speed_loss": 0.05})
NEAR = 0.8  # of what the best place explains: less is no rival (judgement)


@dataclass(frozen=True)
class Place:
    """A rotor that it may be: how probable, and the member in its best form there."""

    rotor: int
    probability: float
    member: Member


def places(ch: Channels, members: Sequence[Member]) -> list[Place]:
    """The rotors that the member with a place among these may be at, the most probable first.

    Probabilities are of all that were weighed, tempered by what is left over (`posterior`).
    """
    members = [begun(ch, m.effect, m.shape, m.coefficients) for m in members]  # each pays for all its numbers
    mine = next(m for m in members if ROTOR in m.shape)
    others = [m for m in members if m is not mine]
    tried: list[Member] = _everywhere(ch, mine)
    scorer = Scorer(ch, white(ch.count))
    found: list[Hypothesis] = []
    for _ in range(COLOUR_ROUNDS):
        found = _scored(scorer, others, tried)
        best = max(found, key=lambda h: h.score)
        scorer = Scorer(ch, colour_of(best.left))
        tried = [_placed(h) for h in found]
    found = _scored(scorer, others, tried)
    weighed = posterior(ch, scorer.colour, found)
    mass: dict[int, float] = {}
    best_of: dict[int, Member] = {}
    # rotors have the same numbers under the same priors: what corrections give way for hangs together with
    # what is left over as the fit does, so the whole evidence is tempered
    lead = weighed.best
    ahead = [
        t * (h.fit.log_evidence - lead.fit.log_evidence) + h.log_prior - lead.log_prior
        for t, h in zip(weighed.temper, weighed.sets, strict=True)
    ]
    odds = np.exp(np.array(ahead) - max(ahead))
    shares = odds / odds.sum()
    for share, h in sorted(zip(shares, weighed.sets, strict=True), key=lambda pair: -pair[0]):
        m = _placed(h)
        rotor = int(m.shape[ROTOR])
        mass[rotor] = mass.get(rotor, 0.0) + float(share)
        best_of.setdefault(rotor, m)
    return sorted((Place(r, p, best_of[r]) for r, p in mass.items()), key=lambda p: -p.probability)


def undecided(found: Sequence[Place]) -> list[Place]:
    """The places between which nothing decides; none where the first is sure enough to be claimed."""
    near = [p for p in found if p.probability >= 1.0 - CLAIMED]
    return near if found[0].probability < CLAIMED and len(near) > 1 else []


def _placed(h: Hypothesis) -> Member:
    return next(m for m in h.members if ROTOR in m.shape)


def _everywhere(ch: Channels, mine: Member) -> list[Member]:
    """The member at every rotor in every form, since when it was found."""
    plain = {k: v for k, v in mine.shape.items() if not any(k in way for way in WAYS)}
    out = []
    for number in (r.number for r in ch.bare.airframe.rotors):
        for way in WAYS:
            shape, start = mine.effect.inverse(ch.bare, {**plain, ROTOR: float(number), **way})
            out.append(mine if shape == dict(mine.shape) else begun(ch, mine.effect, shape, start))
    return out


def _scored(scorer: Scorer, others: Sequence[Member], tried: Sequence[Member]) -> list[Hypothesis]:
    """Those that come near the best, at their best."""
    without = scorer.score(others, ()).fit.log_evidence
    first = []
    for m in tried:
        h, values = scorer.linearised([*others, m], (), None)
        count = len(h.members[-1].coefficients)
        at = h.members[-1].point
        at[:count] = values[-len(at) :][:count]
        first.append(scorer.linearised([*others, m.at(at)], (), h.fit.noise)[0])
    most = max(h.fit.log_evidence for h in first)
    # where no place is as good as none, all that is near is as near as the best
    least = most - (1.0 - NEAR) * abs(most - without)
    near = [h for h in first if h.fit.log_evidence >= least]
    return [scorer.score(h.members, (), h.fit.noise) for h in near]
