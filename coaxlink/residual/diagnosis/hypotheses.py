"""Sets of explanations, each with its numbers at their best and its marginal likelihood."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from coaxlink.effects import effect as effect_named
from coaxlink.effects.tracing import Array
from coaxlink.evidence.blocks import Block, joined
from coaxlink.evidence.likelihood import Base, Fit, fitted
from coaxlink.evidence.noise import COLOUR_ROUNDS, Colour, colour_of
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.discrepancy import SHARES, discrepancy
from coaxlink.residual.members import Member, composed, member

ODDS = np.log(1.0 / 50.0)  # that an effect is there: of fifty sound logs, one shows it (judgement)
# of the Gauss-Newton steps, judgement: effort, no part of any answer that is at its best
STEPS = 5
HALVINGS = (1.0, 0.5, 0.2)
SETTLED = 0.2  # nats
CONSISTENT = 1  # rounds
REFUSED = -1e6
REMEMBERED = 60  # linearisations
ROTOR = "rotor"  # the number of a shape that is no quantity but a place
WHOLE = 0.02  # what an effect that is there as a whole may differ from that, by its form


@dataclass(frozen=True)
class Slopes:
    """What members add, (rows, C), and its derivatives by their numbers, (rows, C, K), also whitened."""

    added: Array
    columns: Array
    white: Array


@dataclass(frozen=True)
class Hypothesis:
    """Effects with their numbers, free forms by name, and how well all of it is borne out."""

    members: tuple[Member, ...]
    forms: tuple[str, ...]
    fit: Fit
    log_prior: float
    left: Array  # (rows, C) not whitened
    added: Array  # (rows, C) what the members add
    width: int  # columns of base and map
    white: tuple[Array, ...]  # whitened columns (rows, C, P) side by side: shared ones are held once
    colour: Colour
    slopes: Slopes
    share: float  # of each member that its form may miss

    def whitened(self, channel: int) -> Array:
        """(rows, P) whitened columns of one channel."""
        return np.concatenate([w[:, channel] for w in self.white], axis=-1)

    @property
    def score(self) -> float:
        """Log of evidence times prior."""
        return self.fit.log_evidence + self.log_prior

    @property
    def names(self) -> frozenset[str]:
        """Effects and free forms (by variable and channel)."""
        return frozenset([m.name for m in self.members] + [form_name(f) for f in self.forms])

    @property
    def key(self) -> frozenset[str]:
        """What sets it apart from others that were visited: names, and where what has a place is."""
        return key_of(self.members, self.forms)

    @property
    def effects(self) -> frozenset[str]:
        """Effects alone."""
        return frozenset(m.name for m in self.members)


def form_name(form: str) -> str:
    """Variable and channel of a free form, whatever its length and size."""
    variable, channel, *_ = form.split("|")
    return f"{variable}|{channel}"


def key_of(members: Sequence[Member], forms: Sequence[str]) -> frozenset[str]:
    """Names of effects and free forms; of an effect that is at one rotor this rotor with it."""
    placed = (f"{m.name}@{m.shape[ROTOR]:g}" if ROTOR in m.shape else m.name for m in members)
    return frozenset([*placed, *map(form_name, forms)])


class Scorer:
    """Scores hypotheses about one log under one colour of its noise."""

    def __init__(self, channels: Channels, colour: Colour) -> None:
        self.channels, self.colour = channels, colour
        self.columns, self.deviation = joined([*channels.nuisance, *channels.surface])
        self.white = colour.whiten(self.columns)
        self._base = Base(self.white, self.deviation)
        self._forms: dict[str, tuple[Block, Array]] = {}
        self._slopes: dict[object, Slopes] = {}

    def form(self, name: str) -> tuple[Block, Array]:
        """A free form, and its columns whitened; kept."""
        if name not in self._forms:
            self._forms[name] = self.made(name)
        return self._forms[name]

    def made(self, name: str) -> tuple[Block, Array]:
        """The same, not kept: all of them are large."""
        block = self.channels.forms[name]()
        return block, self.colour.whiten(block.columns)

    @cached_property
    def empty(self) -> Hypothesis:
        """Base and map alone."""
        return self.score((), ())

    def predict(self, members: Sequence[Member]) -> Array:
        """(frame rows, channels) with the members acting."""
        if not members:
            return self._nothing
        parts = [(m.effect, m.parameters(self.channels.bare)) for m in members]
        known = [k for k in self.channels.known if k[0].name not in {m.name for m in members}]
        return np.asarray(composed(self.channels.bare, [*known, *parts]).predicted)

    @cached_property
    def _nothing(self) -> Array:
        return np.asarray(composed(self.channels.bare, self.channels.known).predicted)

    def slopes(self, members: Sequence[Member]) -> Slopes:
        """What the members add, and how that changes with each of their numbers, beside one another."""
        key = tuple((m.name, tuple(sorted(m.shape.items())), tuple(m.coefficients)) for m in members)
        if key not in self._slopes:
            if len(self._slopes) > REMEMBERED:
                self._slopes.clear()
            self._slopes[key] = self._slopes_of(members)
        return self._slopes[key]

    def _slopes_of(self, members: Sequence[Member]) -> Slopes:
        ch, frame = self.channels, self.channels.bare
        here = self.predict(members)
        moves = [ch.reduce(here - self._nothing)]  # each at once: a long flight is large
        for k, m in enumerate(members):
            point = m.point
            for j in range(len(point)):
                step = m.step(frame, j)
                moved = point.copy()
                moved[j] += step
                others = [m.at(moved) if i == k else o for i, o in enumerate(members)]
                moves.append(ch.reduce((self.predict(others) - here) / step))
        columns = np.stack(moves[1:], axis=-1) if members else np.zeros((*moves[0].shape, 0))
        return Slopes(moves[0], columns, self.colour.whiten(columns))

    def linearised(
        self,
        members: Sequence[Member],
        forms: Sequence[str],
        noise: Array | None,
        near: Slopes | None = None,
        share: float = SHARES[0],
    ) -> tuple[Hypothesis, Array]:
        """The model about these members, and (K,) where it would have their numbers instead.

        Their forms may miss `share` of themselves. `near` are slopes taken near these numbers, to be used
        instead of those at them.
        """
        ch = self.channels
        slopes = self.slopes(members) if near is None else near
        added = slopes.added if near is None else ch.reduce(self.predict(members) - self._nothing)
        blocks: list[tuple[Array, Array, Array]] = []
        target = ch.target - added
        origin: list[float] = []
        further = []
        at = 0
        for m in members:
            point = m.point
            columns = slopes.columns[..., at : at + len(point)]
            white = slopes.white[..., at : at + len(point)]
            at += len(point)
            mean, deviation = prior_of(ch, m, columns)
            target = target + columns @ (point - mean)
            blocks.append((columns, white, deviation))
            origin += list(mean)
            mine = added if len(members) == 1 else columns[..., : len(m.coefficients)] @ m.coefficients
            block = discrepancy(ch, m, mine, share)
            if block is not None:
                further.append((block.columns, self.colour.whiten(block.columns), block.deviation))
        blocks += further
        for name in forms:
            form, white = self.form(name)
            blocks.append((form.columns, white, form.deviation))
        rows = self.colour.rows(len(target))
        whitened = self.colour.whiten(target)
        channels = self._base.beside([b[1:] for b in blocks], whitened, rows)
        deviation = np.concatenate([self.deviation, *(b[2] for b in blocks)])
        start = ch.reference * 0.01 if noise is None else noise
        fit = fitted(channels, deviation, start, ch.least_noise)
        width = self.white.shape[-1]
        prior = sum(_log_prior(ch, m) for m in members)
        prior += len({form_name(f) for f in forms}) * (ODDS - np.log(max(len(ch.forms), 1)))
        left, at = target - self.columns @ fit.values[:width], width
        for columns, _, d in blocks:
            left = left - columns @ fit.values[at : at + len(d)]
            at += len(d)
        count = len(origin)
        values = fit.values[width : width + count] + np.array(origin)
        shared = (self.white, *(b[1] for b in blocks))
        h = Hypothesis(
            tuple(members),
            tuple(forms),
            fit,
            float(prior),
            left,
            added,
            width,
            shared,
            self.colour,
            slopes,
            share,
        )
        return h, values

    def score(
        self,
        members: Sequence[Member],
        forms: Sequence[str],
        noise: Array | None = None,
        hopeless: float = -np.inf,
    ) -> Hypothesis:
        """The members moved to their best by Gauss-Newton steps, and the score there.

        What scores less than `hopeless` where it begins is not moved; that it begins where physics refuses it
        is no reason.
        """
        best, values = self.linearised(members, forms, noise)
        if not members or best.fit.log_evidence < hopeless:
            return best
        slopes = self.slopes(members)
        for _ in range(STEPS):
            for share in HALVINGS:
                moved, at = [], 0
                for m in best.members:
                    count = len(m.point)
                    moved.append(m.moved(self.channels.bare, values[at : at + count], share))
                    at += count
                now, further = self.linearised(moved, forms, best.fit.noise, slopes)
                if now.score > best.score:
                    break
            else:
                break
            done = now.score < best.score + SETTLED
            if not done:  # slopes that were taken elsewhere have served
                now, further = self.linearised(moved, forms, now.fit.noise)
                done = now.score < best.score + SETTLED
                slopes = self.slopes(moved)
            best, values = now, further
            if done:
                break
        # a discrepancy is a share of the effect as it is: shapes stay, coefficients go to their best
        ends = []
        for share in SHARES:
            end = best
            for _ in range(CONSISTENT):
                moved, at = [], 0
                for m in end.members:
                    point = m.point
                    point[: len(m.coefficients)] = values[at : at + len(m.coefficients)]
                    at += len(point)
                    moved.append(m.at(point))
                end, values = self.linearised(moved, forms, end.fit.noise, share=share)
            ends.append(end)
        return max(ends, key=lambda h: h.score)


def coloured(ch: Channels, h: Hypothesis) -> Hypothesis:
    """The hypothesis under the colour of what itself leaves; every number of a colour costs as BIC has it."""
    for _ in range(COLOUR_ROUNDS):
        colour = colour_of(h.left)
        near = replace(h.slopes, white=colour.whiten(h.slopes.columns))
        h, _ = Scorer(ch, colour).linearised(h.members, h.forms, h.fit.noise, near, h.share)
    return replace(h, log_prior=h.log_prior - 0.5 * colour.size * np.log(len(h.left)))


def is_whole(name: str, coefficients: int) -> bool:
    """Whether an effect's one coefficient is a share that is all of it."""
    known = effect_named(name)
    shares = [p for p in known.parameters if p.name == "share" and p.prior is not None] if known else []
    return bool(shares) and coefficients == 1


def prior_of(ch: Channels, m: Member, columns: Array) -> tuple[Array, Array]:
    """(K,) means and deviations of a member's numbers: coefficients by size, shapes by their limits."""
    count = len(m.coefficients)
    mean = np.zeros(len(m.point))
    deviation = np.empty(len(m.point))
    deviation[:count] = ch.usual(columns[..., :count])
    whole = effect_named(m.name)
    known = {p.name: p for p in whole.parameters} if whole else {}
    if is_whole(m.name, count):
        mean[0], deviation[0] = 1.0, WHOLE  # all of the drive is late, or rests
    limits = m.effect.free(ch.bare, m.shape)
    for i, key in enumerate(m.keys, start=count):
        low, high = limits[key]
        prior = known[key].prior if key in known else None
        mean[i] = float(m.shape[key])  # flat between the limits, or of a bump as wide as that
        deviation[i] = (
            (high - low) / np.sqrt(12.0) if prior is None else min(prior[1], (high - low) / np.sqrt(12.0))
        )
    return mean, deviation


def _log_prior(ch: Channels, m: Member) -> float:
    """Of a member being there, in this form, with numbers that physics allows."""
    frame = ch.bare
    numbers = m.parameters(frame)
    if m.effect.refuse(numbers) is not None:
        return REFUSED
    out = ODDS - np.log(max(m.effect.forms(frame), 1))
    whole = effect_named(m.name)
    for p in whole.parameters if whole else ():
        if p.prior is not None and p.name in numbers and p.name != "share":
            out -= min(0.5 * ((numbers[p.name] - p.prior[0]) / p.prior[1]) ** 2, 8.0)
    return float(out)


def begun(ch: Channels, effect: Any, shape: Mapping[str, float], coefficients: Array) -> Member:
    """A member with all that is continuous in it free."""
    return member(ch.bare, effect, shape, coefficients)
