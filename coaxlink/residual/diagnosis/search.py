"""A beam over sets of explanations: add, swap, drop; every set that was visited keeps its score."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from coaxlink.effects.onset import COMES, gradual
from coaxlink.effects.tracing import Array, Shape, Tracing
from coaxlink.residual.diagnosis.hypotheses import Hypothesis, Scorer, begun, form_name
from coaxlink.residual.diagnosis.screening import Stack
from coaxlink.residual.regression.joint_model import Member

# effort of the search, judgement: seconds a log
BEAM = 2
TRIED = 4  # effects of a screening that are fitted
TRIED_FORMS = 2
MOST = 5
HOPELESS = 100.0  # nats behind at its first point, and a share of all that is explained
LEAST_FORM_GAIN = 5.0  # nats: a free form's odds take ten
LEAST_GAIN = 1.0  # nats in a shape of the grid; its odds take four
FAR = 30.0  # nats below the best: not worth another look
# beside what a loop answers a step shows for as long as it passes a 4 Hz low-pass: half a second
SHARP_S, MOST_TIMES = 0.4, 300
# what must act where its recorded cause moves: loads go with the air's density (blade element theory)
DUE = frozenset({"air_density"})
CONFOUNDED = 0.5  # of what an effect explains: less is no rival before its shape has moved


@dataclass
class Visited:
    """The best score of every set of names."""

    by_names: dict[frozenset[str], Hypothesis] = field(default_factory=dict)

    def add(self, h: Hypothesis) -> None:
        """Keep the better one."""
        old = self.by_names.get(h.names)
        if old is None or h.score > old.score:
            self.by_names[h.names] = h

    @property
    def best(self) -> Hypothesis:
        """Of all."""
        return max(self.by_names.values(), key=lambda h: h.score)

    def ranked(self) -> list[Hypothesis]:
        """Best first."""
        return sorted(self.by_names.values(), key=lambda h: -h.score)


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
        self.grid = Stack([(c.white, c.deviation) for c in self.candidates])
        self.forms = tuple(self.channels.forms)
        self.free = Stack([(w, b.deviation) for b, w in map(scorer.form, self.forms)])
        self.barred: set[str] = set()
        self._sharp: dict[object, tuple[list[Candidate], Stack]] = {}

    def run(self, starts: Sequence[Hypothesis] = ()) -> Visited:
        """From nothing, and from given members, until nothing better comes."""
        seen: set[frozenset[str]] = set()
        self.visited.add(self.scorer.empty)
        for h in starts:
            self.visited.add(self.scorer.score(h.members, h.forms, h.fit.noise))
        while True:
            ranked = self.visited.ranked()
            best = ranked[0].score
            front = {h.names: h for h in ranked[:BEAM] if h.score > best - FAR}
            # a free form must not keep an effect from being tried
            front |= {h.names: h for h in [h for h in ranked if not h.forms][:1]}
            # beside what must act is looked, whatever was found first to take its place
            front |= {
                h.names: h for h in ranked if h.names and h.names <= DUE and h.score > self.scorer.empty.score
            }
            front = {names: h for names, h in front.items() if names not in seen}
            if not front:
                return self.visited
            for h in front.values():
                seen.add(h.names)
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
        if len(h.names) < MOST:
            for effect, shape in self.screened(h):
                self._grown(h, effect, shape)
            for form in self.screened_forms(h):
                self._try(h.members, [*h.forms, form], h)
        if h.members and (h.names == self.visited.best.names or not h.forms):
            self._refined(h)

    def rivals(self) -> None:
        """Each effect of the best set in turn given up for every other one that could be confounded with it.

        The search climbs, and does not look back: what it would have found from another first step is looked
        for here, so that two names for the same rows are both weighed.
        """
        best = self.visited.best
        for m in best.members:
            others = [o for o in best.members if o is not m]
            without = self._try(others, best.forms, best, anew=False)
            worth = best.fit.log_evidence - without.fit.log_evidence
            for effect, candidate, gain in self._promising(without):
                if effect.name != m.name and gain > CONFOUNDED * worth:
                    new = self._try([*others, self.started(without, candidate)], best.forms, without)
                    if new.score > best.score - 2.0 * worth:
                        self._other_forms(new, len(others))

    def _other_forms(self, h: Hypothesis, k: int) -> None:
        """Every form of member k."""
        m = h.members[k]
        for shape, coefficients in m.effect.variants(self.channels.bare, m.shape, m.coefficients):
            other = begun(self.channels, m.effect, shape, np.asarray(coefficients, float))
            self._try([other if i == k else o for i, o in enumerate(h.members)], h.forms, h)

    def _try(
        self, members: Sequence[Member], forms: Sequence[str], h: Hypothesis, *, anew: bool = True
    ) -> Hypothesis:
        """The set scored; where not `anew`, as it was scored before if it was."""
        old = self.visited.by_names.get(
            frozenset([m.name for m in members]) | frozenset(map(form_name, forms))
        )
        if old is not None and not anew:
            return old
        # what betters the set that it comes from is always taken to its best
        hopeless = min(self.visited.best.score - FAR - HOPELESS, h.score) if old is None else old.score - FAR
        new = self.scorer.score(tuple(members), tuple(forms), h.fit.noise, hopeless)
        self.visited.add(new)
        return new

    def _grown(self, h: Hypothesis, effect: Tracing[Any], candidate: Candidate) -> None:
        start = self.started(h, candidate)
        self._try([*h.members, start], h.forms, h)

    def started(self, h: Hypothesis, c: Candidate) -> Member:
        """The candidate with the coefficients that fit beside a hypothesis."""
        left = self.scorer.colour.whiten(h.left)
        weight = 1.0 / h.fit.noise**2
        gram, moment = np.diag(1.0 / c.deviation**2), np.zeros(len(c.deviation))
        cross = np.zeros((len(h.fit.deviation), len(moment)))
        for k in np.flatnonzero(c.white.any(axis=(0, 2))):
            mine = c.white[:, k]
            gram += weight[k] * (mine.T @ mine)
            moment += weight[k] * (mine.T @ left[:, k])
            cross += weight[k] * (h.whitened(int(k)).T @ mine)
        # the hypothesis gives way: its numbers and the candidate's are found together
        half = solve_triangular(h.fit.factor, cross * h.fit.deviation[:, None], lower=True)
        values = np.linalg.solve(gram - half.T @ half, moment)
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
        """Other forms of each member, and other beginnings."""
        for k, m in enumerate(h.members):
            if m.effect.sudden:
                self._begun_anew(h, k)
            other_forms = [*m.effect.variants(self.channels.bare, m.shape, m.coefficients)]
            if m.effect.sudden:
                other_forms += [(s, m.coefficients) for s in gradual(self.channels.bare, m.shape)]
            for shape, coefficients in other_forms:
                other = begun(self.channels, m.effect, shape, np.asarray(coefficients, float))
                changed = [other if i == k else o for i, o in enumerate(h.members)]
                first, _ = self.scorer.linearised(changed, h.forms, h.fit.noise)
                if first.score > h.score - HOPELESS * (1.0 + 0.01 * abs(h.score - self.scorer.empty.score)):
                    self._try(changed, h.forms, h)

    def _begun_anew(self, h: Hypothesis, k: int) -> None:
        """Member k from the best of all beginnings on, beside the others: in any form, and in its own."""
        m, others = h.members[k], [m for i, m in enumerate(h.members) if i != k]
        name, form = m.name, _form_numbers(m.shape)
        mine = [c for c in self.candidates if c.effect.name == name and "onset_s" in c.shape]
        if not mine:
            return
        without = self._try(others, h.forms, h, anew=False)
        gains = dict(zip(map(id, self.candidates), self._gains(without, self.grid), strict=True))
        best = self._timed(without, max(mine, key=lambda c: gains[id(c)]))
        self._try([*others, self.started(without, best)], h.forms, h)
        sharp, stack = self._beginnings(m.effect, form)
        best = self._timed(without, sharp[int(np.argmax(self._gains(without, stack)))], SHARP_S)
        self._try([*others, self.started(without, best)], h.forms, h)

    def screened(self, h: Hypothesis) -> list[tuple[Tracing[Any], Candidate]]:
        """The most promising effects beside a hypothesis, each in its best shape of the grid."""
        return [(effect, candidate) for effect, candidate, _ in self._promising(h, TRIED)]

    def _promising(
        self, h: Hypothesis, most: int | None = None
    ) -> list[tuple[Tracing[Any], Candidate, float]]:
        """Effects beside a hypothesis in their best shapes of the grid, each with the nats that it gains."""
        gains = self._gains(h, self.grid)
        ranked = sorted(zip(gains, range(len(gains)), strict=True), reverse=True)
        out: dict[str, tuple[Tracing[Any], Candidate, float]] = {}
        for gain, k in ranked:
            c = self.candidates[k]
            if gain < LEAST_GAIN or len(out) == most:
                break
            if c.effect.name in h.names or c.effect.name in self.barred or c.effect.name in out:
                continue
            if "onset_s" in c.shape:
                c = self._timed(h, c)
            start = self.started(h, c)
            if c.effect.refuse(start.parameters(self.channels.bare)) is None:
                out[c.effect.name] = c.effect, c, gain
        return list(out.values())

    def _timed(self, h: Hypothesis, c: Candidate, reach: float | None = None) -> Candidate:
        """The candidate with its beginning found to a tenth of `reach` (s), or of the grid's distances."""
        if reach is None:
            times = sorted(
                {t.shape["onset_s"] for t in self.candidates if "onset_s" in t.shape and t.effect is c.effect}
            )
            reach = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
        for _ in range(2):
            times = [c.shape["onset_s"] + reach * x for x in np.linspace(-1.0, 1.0, 11)]
            low, high = c.effect.free(self.channels.frame, c.shape)["onset_s"]
            shapes = [{**c.shape, "onset_s": float(np.clip(t, low, high))} for t in times]
            tried = [self._candidate(c.effect, shape) for shape in shapes]
            gains = self._gains(h, Stack([(t.white, t.deviation) for t in tried]))
            c = tried[int(np.argmax(gains))]
            reach *= 0.2
        return c

    def _beginnings(self, effect: Tracing[Any], form: Shape) -> tuple[list[Candidate], Stack]:
        """One form of an effect from any moment of the log on."""
        key = (effect.name, tuple(sorted(form.items())))
        if key not in self._sharp:
            low, high = effect.free(self.channels.frame, {**form, "onset_s": 0.0})["onset_s"]
            count = int(np.clip(np.ceil((high - low) / SHARP_S), 1, MOST_TIMES))
            tried = [
                self._candidate(effect, {**form, "onset_s": float(t)})
                for t in np.linspace(low, high, count + 2)[1:-1]
            ]
            self._sharp[key] = tried, Stack([(t.white, t.deviation) for t in tried])
        return self._sharp[key]

    def _candidate(self, effect: Tracing[Any], shape: Shape) -> Candidate:
        ch = self.channels
        columns = ch.reduce(effect.columns(ch.frame, shape))
        return Candidate(effect, shape, self.scorer.colour.whiten(columns), ch.usual(columns))

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


def _form_numbers(shape: Shape) -> dict[str, float]:
    """A shape without when it began and how long that took, nor what moves with it."""
    return {k: v for k, v in shape.items() if k not in COMES}


def candidates(scorer: Scorer) -> list[Candidate]:
    """Every effect in every shape of its grid."""
    ch = scorer.channels
    if not ch.grid:  # the same for every colour
        for effect in ch.effects:
            for shape in [*effect.shapes(ch.frame), *ch.more_shapes(ch.frame, effect)]:
                columns = ch.reduce(effect.columns(ch.frame, shape))
                if columns.any() and np.all(np.isfinite(columns)):
                    ch.grid.append((effect, shape, columns))
    return [Candidate(e, shape, scorer.colour.whiten(x), ch.usual(x)) for e, shape, x in ch.grid]
