"""A beam over sets of explanations: add, swap, drop; every set that was visited keeps its score."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from coaxlink.effects.tracing import Array, Shape, Tracing
from coaxlink.residual.diagnosis.hypotheses import Hypothesis, Scorer, begun, form_name, is_whole, key_of
from coaxlink.residual.diagnosis.screening import Stack
from coaxlink.residual.members import Member

# effort of the search, judgement: seconds a log
BEAM = 2
TRIED = 4  # effects of a screening that are fitted
TRIED_FORMS = 2
NAMED = 3  # effects that are tried in the place of free forms
MOST_NAMES = 5
HOPELESS = 100.0  # nats behind at its first point, and a share of all that is explained
LEAST_FORM_GAIN = 5.0  # nats: a free form's odds take ten
LEAST_GAIN = 1.0  # nats in a shape of the grid; its odds take four
FAR = 30.0  # nats below the best: not worth another look
# what must act where its recorded cause moves: loads go with the air's density (blade element theory)
DUE = frozenset({"air_density"})


@dataclass
class Visited:
    """The best score of every set of names and places."""

    by_key: dict[frozenset[str], Hypothesis] = field(default_factory=dict)

    def add(self, h: Hypothesis) -> None:
        """Keep the better one."""
        old = self.by_key.get(h.key)
        if old is None or h.score > old.score:
            self.by_key[h.key] = h

    @property
    def best(self) -> Hypothesis:
        """Of all."""
        return max(self.by_key.values(), key=lambda h: h.score)

    def ranked(self) -> list[Hypothesis]:
        """Best first."""
        return sorted(self.by_key.values(), key=lambda h: -h.score)


@dataclass(frozen=True)
class Candidate:
    """An effect in a shape of its grid, whitened."""

    effect: Tracing[Any]
    shape: Shape
    white: Array  # (rows, C, K)
    deviation: Array


class Search:
    """Of one log under one colour."""

    def __init__(self, scorer: Scorer, progress: Callable[[str], None] = lambda _: None) -> None:
        self.scorer, self.channels = scorer, scorer.channels
        self.progress = progress
        self.visited = Visited()
        self.candidates = candidates(scorer)
        self.grid = Stack((c.white, c.deviation) for c in self.candidates)
        self.forms = tuple(self.channels.forms)
        self.free = Stack((w, b.deviation) for b, w in map(scorer.made, self.forms))

    def run(self, starts: Sequence[Hypothesis] = ()) -> Visited:
        """From nothing, and from given members, until nothing better comes."""
        seen: set[frozenset[str]] = set()
        self.visited.add(self.scorer.empty)
        for h in starts:
            self.visited.add(self.scorer.score(h.members, h.forms, h.fit.noise))
        while True:
            ranked = self.visited.ranked()
            best = ranked[0].score
            front = {h.key: h for h in ranked[:BEAM] if h.score > best - FAR}
            # a free form must not keep an effect from being tried
            front |= {h.key: h for h in [h for h in ranked if not h.forms][:1]}
            # beside what must act is looked, whatever was found first to take its place
            front |= {
                h.key: h for h in ranked if h.names and h.names <= DUE and h.score > self.scorer.empty.score
            }
            front = {key: h for key, h in front.items() if key not in seen}
            if not front:
                return self.visited
            for h in front.values():
                seen.add(h.key)
                self.progress(" + ".join(sorted(h.names)) or "nothing")
                self._around(h)

    def _around(self, h: Hypothesis) -> None:
        if len(h.names) > 1:
            for name in h.names:
                self._try(
                    [m for m in h.members if m.name != name],
                    [f for f in h.forms if form_name(f) != name],
                    h,
                    anew=False,
                )
        if len(h.names) < MOST_NAMES:
            for effect, shape in self.screened(h):
                self._grown(h, effect, shape)
            for form in self.screened_forms(h):
                self._try(h.members, [*h.forms, form], h)
        if h.members and (h.key == self.visited.best.key or not h.forms):
            self._refined(h)
        if h.forms and h.key == self.visited.best.key:
            self._named(h)

    def _named(self, h: Hypothesis) -> None:
        """Effects in the place of all free forms over one variable: what has no name was found first."""
        for variable in dict.fromkeys(f.split("|")[0] for f in h.forms):
            forms = [f for f in h.forms if f.split("|")[0] != variable]
            without = self._try(h.members, forms, h, anew=False)
            found = self.screened(without)
            names = list(dict.fromkeys(effect.name for effect, _ in found))[:NAMED]
            for effect, candidate in found:
                if effect.name in names:
                    self._grown(without, effect, candidate)

    def _try(
        self, members: Sequence[Member], forms: Sequence[str], h: Hypothesis, *, anew: bool = True
    ) -> Hypothesis:
        """The set scored; where not `anew`, as it was scored before if it was."""
        old = self.visited.by_key.get(key_of(members, forms))
        if old is not None and not anew:
            return old
        # what betters the set that it comes from is always taken to its best
        hopeless = min(self.visited.best.score - FAR - HOPELESS, h.score) if old is None else old.score - FAR
        try:
            new = self.scorer.score(tuple(members), tuple(forms), h.fit.noise, hopeless)
        except np.linalg.LinAlgError:  # its numbers went where nothing can be worked out: no set of this log
            return h
        self.visited.add(new)
        return new

    def _grown(self, h: Hypothesis, effect: Tracing[Any], candidate: Candidate) -> None:
        start = self.started(h, candidate)
        self._try([*h.members, start], h.forms, h)

    def beside(self, h: Hypothesis, c: Candidate) -> tuple[Array, Array]:
        """(K, K) what the log tells of a candidate's coefficients beside a hypothesis that gives way, (K,)
        moments.
        """
        left = self.scorer.colour.whiten(h.left)
        weight = 1.0 / h.fit.noise**2
        gram, moment = self.alone(h, c), np.zeros(len(c.deviation))
        cross = np.zeros((len(h.fit.deviation), len(moment)))
        for k in np.flatnonzero(c.white.any(axis=(0, 2))):
            mine = c.white[:, k]
            moment += weight[k] * (mine.T @ left[:, k])
            cross += weight[k] * (h.whitened(int(k)).T @ mine)
        half = h.fit.half(cross)
        return gram - half.T @ half, moment

    def alone(self, h: Hypothesis, c: Candidate) -> Array:
        """(K, K) what the log tells of a candidate's coefficients where nothing gives way."""
        mine = c.white / h.fit.noise[:, None]
        return np.asarray(np.diag(1.0 / c.deviation**2) + np.einsum("rca,rcb->ab", mine, mine, optimize=True))

    def started(self, h: Hypothesis, c: Candidate) -> Member:
        """The candidate with the coefficients that fit beside a hypothesis."""
        values = np.asarray(np.linalg.solve(*self.beside(h, c)), float)
        first = begun(self.channels, c.effect, c.shape, values)
        if (
            len(values) == 1
            and c.effect.refuse(first.parameters(self.channels.bare))
            and "share" in c.effect.units
        ):
            return begun(
                self.channels, c.effect, c.shape, np.ones(1)
            )  # all of it: its shape is not right yet
        return begun(self.channels, c.effect, c.shape, values)

    def _refined(self, h: Hypothesis) -> None:
        """Other forms of each member."""
        for k, m in enumerate(h.members):
            for shape, coefficients in m.effect.variants(self.channels.bare, m.shape, m.coefficients):
                other = begun(self.channels, m.effect, shape, np.asarray(coefficients, float))
                changed = [other if i == k else o for i, o in enumerate(h.members)]
                first, _ = self.scorer.linearised(changed, h.forms, h.fit.noise, share=h.share)
                if first.score > h.score - HOPELESS * (1.0 + 0.01 * abs(h.score - self.scorer.empty.score)):
                    self._try(changed, h.forms, h)

    def screened(self, h: Hypothesis) -> list[tuple[Tracing[Any], Candidate]]:
        """The most promising effects beside a hypothesis, each in its best shapes of the grid."""
        return [(effect, candidate) for effect, candidate, _ in self._promising(h, TRIED)]

    def _promising(
        self, h: Hypothesis, most: int | None = None, least: float = LEAST_GAIN
    ) -> list[tuple[Tracing[Any], Candidate, float]]:
        """Effects beside a hypothesis in their best shapes of the grid, each with the nats that it gains: of
        every form of an effect that is there as a whole the best, for a part of one form passes for another.
        """
        gains = self._gains(h, self.grid)
        ranked = sorted(zip(gains, range(len(gains)), strict=True), reverse=True)
        out: dict[tuple[str, frozenset[str]], tuple[Tracing[Any], Candidate, float]] = {}
        for gain, k in ranked:
            c = self.candidates[k]
            name, form = (
                c.effect.name,
                frozenset(c.shape if is_whole(c.effect.name, len(c.deviation)) else ()),
            )
            if gain < least:
                break
            if name in h.names or (name, form) in out:
                continue
            if most is not None and len({n for n, _ in out} | {name}) > most:
                continue
            start = self.started(h, c)
            if c.effect.refuse(start.parameters(self.channels.bare)) is None:
                out[name, form] = c.effect, c, gain
        return list(out.values())

    def screened_forms(self, h: Hypothesis) -> list[str]:
        """The most promising free forms beside a hypothesis."""
        ranked = sorted(zip(self._gains(h, self.free), self.forms, strict=True), reverse=True)
        out, had = [], set(h.names)
        for gain, name in ranked:
            if gain > LEAST_FORM_GAIN and form_name(name) not in had:
                had.add(form_name(name))
                out.append(name)
            if len(out) == TRIED_FORMS:
                break
        return out

    def _gains(self, h: Hypothesis, stack: Stack) -> list[float]:
        """Log evidence that each piece of a stack would add beside a hypothesis."""
        return stack.gains(h, self.scorer.colour.whiten(h.left))


def candidates(scorer: Scorer) -> list[Candidate]:
    """Every effect in every shape of its grid."""
    ch = scorer.channels
    if not ch.grid:  # the same for every colour
        for effect in ch.effects:
            for shape in effect.shapes(ch.frame):
                columns = ch.reduce(effect.columns(ch.frame, shape))
                if columns.any() and np.all(np.isfinite(columns)):
                    ch.grid.append((effect, shape, columns))
    return [Candidate(e, shape, scorer.colour.whiten(x), ch.usual(x)) for e, shape, x in ch.grid]
