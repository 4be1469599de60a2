"""Sets of explanations of a flight: the stands' search, with beginnings in mid-flight, under tempered noise.

What gusts say of a constant is their spectral density at no frequency: so many rows count as one as the
noise hangs together for (`noise.tempered`). How many, what all candidates together leave says: were it what
one set leaves, a slow effect that is not in it would be noise, and lose against that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.effects.onset import COMES, MARGIN_S
from coaxlink.effects.tracing import Array, Tracing
from coaxlink.evidence.likelihood import Base, fitted
from coaxlink.evidence.noise import autocorrelation_time, tempered, white
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.hypotheses import Hypothesis, Scorer, begun
from coaxlink.residual.diagnosis.posterior import Posterior, posterior
from coaxlink.residual.diagnosis.search import TRIED, Candidate, Search, candidates
from coaxlink.residual.members import Member

SHORT_ROWS = 15_000  # of a frame: of a longer one only what is promising is fitted (seconds)
SETTLES = 20  # rounds of a noise level (effort)
NOISE_ROUNDS, STARTS = 3, 4  # effort, judgement: of the noise, and sets that the next one begins with
LESS = 2.0  # times: noise that hangs together so much less long is another (judgement)
# rows a column of what all candidates leave, each as many as hang together (judgement: fewer fit the noise)
LEAST_INDEPENDENT = 3.0
ROUNDED = 1e-12  # of the most power: less is rounding
STRETCHES = 6  # of a flight: what begins in it is told from noise to a sixth (judgement)
EDGE_BLOCKS = 3  # on either side of a beginning
MORE = 5.0  # nats that a beginning must gain over none: as a free form's odds
OVER = (0.15, 0.4, 0.8)  # of the flight: starts of what comes gradually
# the wind's drag is the rotors': both would count it twice
APART = {"wind": "rotor_drag", "rotor_drag": "wind"}
AS_A_SAG = "mass_change"  # what changes the lift slowly is a supply as well, where no voltage was logged

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Flown:
    """What was found in a flight."""

    posterior: Posterior
    search: Search  # the last one
    channels: Channels


def searched(ch: Channels, progress: Progress) -> Flown:
    """Sets are looked for, and held against one another, under the noise that all candidates together leave;
    again where the best set bends as no candidate's first shape does and leaves much less.
    """
    search, starts = None, list[Hypothesis]()
    times, beside = np.full(ch.count, np.inf), Scorer(ch, white(ch.count)).empty
    for _ in range(NOISE_ROUNDS):
        now = np.minimum(left_by_all(ch, beside), times)
        if search is not None and np.all(now > times / LESS):
            break
        times, starts = now, search.visited.ranked()[:STARTS] if search else []
        search = FlightSearch(Scorer(ch, tempered(times)), lambda reported: progress(f"weighing {reported}"))
        search.run([h for h in starts if h.members])
        beside = search.visited.best
    assert search is not None
    return Flown(posterior(ch, search.scorer.colour, search.visited.ranked(), whole=True), search, ch)


def left_by_all(ch: Channels, beside: Hypothesis) -> Array:
    """(C,) autocorrelation times of what all candidates together leave beside a set, ridged by their priors.

    Of an effect that may begin in mid-flight every stretch of the flight has columns of its own.
    """
    scorer = Scorer(ch, white(ch.count))
    part = ch.block * STRETCHES // (int(ch.block.max()) + 1)
    pieces, deviations = list[Array](), list[Array]()
    if beside.members:
        pieces.append(beside.slopes.columns)
        deviations.append(ch.usual(beside.slopes.columns))
    for c in candidates(scorer):
        late = range(1, STRETCHES) if c.effect.sudden else ()
        mine = [c.white, *(c.white * (part == k)[:, None, None] for k in late)]
        pieces += mine
        deviations += [c.deviation] * len(mine)
    if not pieces:  # this flight can show nothing
        return autocorrelation_time(beside.left, ch.block)
    columns = np.concatenate(pieces, axis=-1) * np.concatenate(deviations)
    most = len(ch.target) / (LEAST_INDEPENDENT * autocorrelation_time(beside.left, ch.block))
    few, deviation = principal(columns, most.astype(int))
    width, rows = len(scorer.deviation), np.full(ch.count, float(len(ch.target)))
    every = np.concatenate([scorer.deviation, deviation])
    channels = Base(np.concatenate([scorer.columns, few], axis=-1), every).beside([], beside.left, rows)
    # from the least noise upwards: from above, corrections that strain may hold it where they are
    fit = fitted(channels, every, ch.least_noise, ch.least_noise, SETTLES)
    left = beside.left - scorer.columns @ fit.values[:width] - few @ fit.values[width:]
    return autocorrelation_time(left, ch.block)


def principal(columns: Array, most: NDArray[np.intp]) -> tuple[Array, Array]:
    """Of columns (rows, C, P) of prior deviation one those (rows, C, K) of unit length, each in one channel,
    that hold the most of them, at most so many (C,) of a channel; with their deviations (K,).
    """
    out, deviations = [], []
    for c, count in enumerate(most):
        mine = columns[:, c, columns[:, c].any(axis=0)]
        power, ways = np.linalg.eigh(mine.T @ mine)
        power, ways = power[::-1][:count], ways[:, ::-1][:, :count]
        held = power > ROUNDED * np.max(power, initial=0.0)
        block = np.zeros((len(columns), len(most), int(held.sum())))
        block[:, c] = mine @ (ways[:, held] / np.sqrt(power[held]))
        out.append(block)
        deviations.append(np.sqrt(power[held]))
    return np.concatenate(out, axis=-1), np.concatenate(deviations)


class FlightSearch(Search):
    """With effects that begin in mid-flight."""

    def screened(self, h: Hypothesis) -> list[tuple[Tracing[Any], Candidate]]:
        """The most promising effects beside a hypothesis, each in its best shape, then those that begin."""
        barred = {APART.get(name) for name in h.names}
        plain = [(e, c, g) for e, c, g in self._promising(h) if e.name not in barred][:TRIED]
        if not h.members and len(self.channels.frame.time_s) < SHORT_ROWS:
            # beside nothing all are tried: noise is then what the strongest of them makes
            plain = self._promising(h, least=-np.inf)
        gains = {e.name: g for e, _, g in plain}
        begun_late = [(g, c) for g, c in self._beginning(h) if g > gains.get(c.effect.name, 0.0) + MORE]
        return [*((e, c) for e, c, _ in plain), *((c.effect, c) for _, c in begun_late)]

    def _beginning(self, h: Hypothesis) -> list[tuple[float, Candidate]]:
        """Of every effect that may begin in mid-flight the best beginning, with the nats that it gains.

        Blocks follow one another in time, so the products of columns that start at a block's edge are sums
        over the blocks behind it.
        """
        ch = self.channels
        count = int(ch.block.max()) + 1
        first = np.flatnonzero(np.diff(ch.block, prepend=-1) != 0)
        if len(np.unique(ch.frame.log)) > 1 or len(first) != count or count <= 2 * EDGE_BLOCKS:
            return []
        left, time = self.scorer.colour.whiten(h.left), ch.frame.time_s[ch.frame.keep]
        edges = np.arange(EDGE_BLOCKS, count - EDGE_BLOCKS)
        best: dict[str, tuple[float, Candidate, float]] = {}
        for c in self.candidates:
            if not c.effect.sudden or c.effect.name in h.names:
                continue
            k = len(c.deviation)
            cross = np.zeros((count, len(h.fit.deviation), k))
            square, moment = np.zeros((count, k, k)), np.zeros((count, k))
            for i in np.flatnonzero(c.white.any(axis=(0, 2))):
                mine, beside, weight = c.white[:, i], h.whitened(int(i)), 1.0 / h.fit.noise[i] ** 2
                cross += weight * np.add.reduceat(beside[:, :, None] * mine[:, None, :], first)
                square += weight * np.add.reduceat(mine[:, :, None] * mine[:, None, :], first)
                moment += weight * np.add.reduceat(mine * left[:, [i]], first)
            cross, square, moment = (np.cumsum(x[::-1], axis=0)[::-1] for x in (cross, square, moment))
            halves = h.fit.half(cross[edges].transpose(1, 0, 2).reshape(-1, len(edges) * k))
            each = halves.reshape(len(halves), len(edges), k)
            taken = np.einsum("pea,peb->eab", each, each, optimize=True)
            known = square[edges] - taken + np.diag(c.deviation**-2.0)
            gains = [_gain(*both, c) for both in zip(known, moment[edges], strict=True)]
            a = int(np.argmax(gains))
            if gains[a] > max(MORE, best.get(c.effect.name, (0.0,))[0]):
                best[c.effect.name] = gains[a], c, float(time[first[edges[a]]])
        seconds = float(np.median(np.diff(time[first])))
        return [self._sharper(h, c, start, seconds) for _, c, start in best.values()]

    def _sharper(self, h: Hypothesis, c: Candidate, start: float, reach: float) -> tuple[float, Candidate]:
        """The candidate with its beginning between the blocks' edges, and what it gains."""
        ch = self.channels
        flown = ch.frame.time_s[ch.frame.keep]
        best = -np.inf, c
        for _ in range(3):
            for at in start + reach * np.linspace(-1.0, 1.0, 5):
                onset = float(np.clip(at, flown[0] + MARGIN_S, flown[-1] - MARGIN_S))
                shape = {**c.shape, "onset_s": onset}
                columns = self.scorer.colour.whiten(ch.reduce(c.effect.columns(ch.frame, shape)))
                other = Candidate(c.effect, shape, columns, c.deviation)
                gain = _gain(*self.beside(h, other), other)
                if gain > best[0]:
                    best, start = (gain, other), onset
            reach /= 2.5
        return best

    def _refined(self, h: Hypothesis) -> None:
        """Other forms of each member, and other ways of what began to come."""
        super()._refined(h)
        ch = self.channels
        flown = ch.frame.time_s[ch.frame.keep]
        for m in [m for m in h.members if "rotor" in m.shape]:
            self._elsewhere(h, m)
        for k, m in enumerate(h.members):
            if "onset_s" not in m.shape:
                continue
            others = [{n: v for n, v in m.shape.items() if n not in COMES}]
            if "over_s" not in m.shape and (m.name != AS_A_SAG or ch.frame.voltage is not None):
                for over in np.array(OVER) * (flown[-1] - flown[0]):
                    onset = float(np.clip(m.shape["onset_s"] - 0.5 * over, flown[0], flown[-1] - MARGIN_S))
                    others.append({**m.shape, "onset_s": onset, "over_s": float(over)})
            for shape in others:
                other = begun(ch, m.effect, shape, m.coefficients)
                self._try([other if i == k else o for i, o in enumerate(h.members)], h.forms, h)

    def _elsewhere(self, h: Hypothesis, m: Member) -> None:
        """What is at one rotor, at the rotor that it would be at beside the others as they are now."""
        others = [o for o in h.members if o is not m]
        without = self._try(others, h.forms, h, anew=False)
        plain = [(g, c) for _, c, g in self._promising(without) if c.effect.name == m.name]
        late = [(g, c) for g, c in self._beginning(without) if c.effect.name == m.name]
        if not (found := [*plain, *late]):
            return
        best = max(found, key=lambda pair: pair[0])[1]
        if best.shape["rotor"] != m.shape["rotor"]:
            self._try([*others, self.started(without, best)], h.forms, without)


def _gain(information: Array, moment: Array, c: Candidate) -> float:
    """Log evidence of coefficients with this information (K, K), their priors in it, and moment (K,)."""
    low = np.linalg.cholesky(information * np.outer(c.deviation, c.deviation))
    z = np.linalg.solve(low, moment * c.deviation)
    return float(0.5 * z @ z - np.sum(np.log(np.diag(low))))
