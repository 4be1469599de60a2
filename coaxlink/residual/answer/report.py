"""The answer of a judgement: effects with intervals and evidence, rivals, and what stays unexplained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.stats import truncnorm

from coaxlink.channels.stand import DELAY_S
from coaxlink.data.samples import Samples
from coaxlink.effects.onset import COMES
from coaxlink.evidence.blocks import joined
from coaxlink.evidence.held_out import Index, Regression, error_interval
from coaxlink.evidence.noise import white
from coaxlink.frames import Array, FlightFrame, StandFrame
from coaxlink.residual.answer.rebased_model import rebased_flight
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.hypotheses import Hypothesis, Scorer, prior_of
from coaxlink.residual.members import ONSET, Member, Part, composed
from coaxlink.residual.result import (
    Ambiguous,
    ChannelError,
    FoundEffect,
    ParameterValue,
    Refinement,
    Rejected,
    Series,
    Step,
    Suspect,
    Unexplained,
)
from coaxlink.rotor import EffectEntry, RotorModel

DRAWS = 200
SERIES_ROWS = 4000
OF_MODEL = ("_level", "_tilt", "_wake")  # corrections of a given model's loads
DELAY = "_delay_s"  # of a load behind the speeds
WORTH_SAYING = 0.02  # of a channel's error: by how much more it errs with the effects


@dataclass(frozen=True)
class Fitted:
    """A log's rows beside nothing, and about the numbers of the members that are reported."""

    channels: Channels
    members: tuple[Member, ...]
    names: tuple[str, ...]  # of the base's columns, the first ones
    before: Regression
    after: Regression
    steps: bool = True  # whether shapes' numbers are the regression's

    def columns(self, members: Sequence[Member]) -> Index:
        """The base's columns and those of some members."""
        names = {m.name for m in members}
        at = len(self.names) + np.cumsum([0, *(len(m.point) for m in self.members)])
        mine = [
            np.arange(a, b) for m, a, b in zip(self.members, at[:-1], at[1:], strict=True) if m.name in names
        ]
        return np.concatenate([np.arange(len(self.names)), *mine]).astype(np.intp)

    def of(self, members: Sequence[Member]) -> Fitted:
        """With some of the members; nothing added leaves what was there, whatever was weighed beside."""
        after = self.after.only(self.columns(members)) if members else self.before
        return replace(self, members=tuple(members), after=after)

    def numbers(self, m: Member, values: Array) -> dict[str, float]:
        """Parameters of a member at these coefficients (P,); its own where physics refuses them."""
        named = self.moved(m, values).parameters(self.channels.bare)
        refused = m.effect.refuse(named) is not None
        return m.parameters(self.channels.bare) if refused else named

    @cached_property
    def held(self) -> Array:
        """(rows, C) left where every shape stays as it is."""
        free = [np.arange(len(m.point)) < len(m.coefficients) for m in self.members]
        use = np.flatnonzero(np.concatenate([np.ones(len(self.names), bool), *free]))
        few = self.after.only(use)
        return np.asarray(few.target - few.columns @ few.values)

    def moved(self, m: Member, values: Array) -> Member:
        """A member at these coefficients (P,).

        The regression is linear in a shape's numbers: where a log hardly shows one its step goes anywhere,
        and what leaves more than no step is none.
        """
        use = self.columns([m])[len(self.names) :]
        point, limits = values[use], m.effect.free(self.channels.bare, m.shape)
        from_here = np.zeros(len(use)) if self.steps else self.after.values[use]
        for i, key in enumerate(m.keys, start=len(m.coefficients)):
            point[i] = np.clip(point[i] - from_here[i] + m.shape[key], *limits[key])
        return m.at(point)

    @property
    def corrections(self) -> dict[str, float]:
        """What of the base was fitted beside the members."""
        return {name: float(v) for name, v in zip(self.names, self.after.values, strict=False)}

    @property
    def parts(self) -> list[Part]:
        """The members with their numbers, and what the model knows besides."""
        ch = self.channels
        names = {m.name for m in self.members}
        known = [k for k in ch.known if k[0].name not in names]
        return [*known, *((m.effect, m.parameters(ch.bare)) for m in self.members)]

    @property
    def acting(self) -> Any:
        """The frame with all that in its prediction."""
        return composed(self.channels.bare, self.parts)


def fitted_about(ch: Channels, members: Sequence[Member], best: Hypothesis | None) -> Fitted:
    """All rows of the channels about members, beside the free forms of the set that they come from."""
    scorer = Scorer(ch, white(ch.count))
    nothing, slopes = scorer.empty.fit.noise, scorer.slopes(members)
    forms = [ch.forms[f]() for f in best.forms] if best else []
    blocks = [*ch.nuisance, *ch.surface, *forms]
    names = [b.name if b.width == 1 else f"{b.name} {k}" for b in blocks for k in range(b.width)]
    base, deviation = joined(blocks)
    mean, at = np.zeros(len(names)), 0
    target = ch.target - slopes.added
    for m in members:
        columns = slopes.columns[..., at : at + len(m.point)]
        target = target + columns[..., : len(m.coefficients)] @ m.coefficients
        expected, spread = prior_of(ch, m, columns)
        expected[len(m.coefficients) :] = 0.0  # numbers of a shape count from where they are
        mean, deviation = np.append(mean, expected), np.append(deviation, spread)
        at += len(m.point)
    sigma = nothing
    if best is not None:
        sigma = np.maximum(best.fit.noise / np.sqrt(best.colour.rows(1)), ch.least_noise)
    width = len(names)
    fitted = Fitted(
        ch,
        tuple(members),
        tuple(names),
        Regression(base, ch.target, mean[:width], deviation[:width], nothing, ch.block),
        Regression(np.concatenate([base, slopes.columns], axis=-1), target, mean, deviation, sigma, ch.block),
    )
    there = [fitted.moved(m, fitted.after.values) for m in members]
    beyond = (
        ch.target - base @ fitted.after.values[:width] - ch.reduce(scorer.predict(there) - scorer.predict(()))
    )
    return replace(fitted, steps=bool(np.sum((beyond / sigma) ** 2) <= np.sum((fitted.held / sigma) ** 2)))


@dataclass(frozen=True)
class Judged:
    """All that an answer is made of; the members of `fitted` are the claimed ones and the doubtful ones."""

    fitted: Fitted
    claims: Mapping[str, Mapping[str, Any]]  # names of members that are claimed, and how probable they are
    floor: Array  # (C,) noise floor
    suspects: tuple[Suspect, ...]
    notes: tuple[str, ...]
    doubts: tuple[Ambiguous, ...]
    open_ends: tuple[Unexplained, ...]
    rejected: tuple[Rejected, ...]
    trace: tuple[Step, ...]


def reported(j: Judged, logs: Sequence[Samples]) -> Refinement:
    """The whole answer."""
    f = j.fitted.of([m for m in j.fitted.members if m.name in j.claims])
    ch, frame = f.channels, f.channels.frame
    channels = _errors(f, j.floor)
    draws = f.after.drawn(DRAWS) if f.members else np.zeros((0, 0))
    effects = tuple(_found(f, m, draws, j.claims[m.name]) for m in f.members)
    return Refinement(
        kind="flight" if isinstance(frame, FlightFrame) else "stand",
        channels=channels,
        effects=effects,
        unexplained=j.open_ends,
        ambiguous=j.doubts,
        suspect_data=j.suspects,
        rejected=(*j.rejected, *(Rejected(name, f"cannot be judged: {why}") for name, why in ch.impossible)),
        model=_with_effects(_rebased(f), effects),
        corrections=f.corrections,
        trace=j.trace,
        notes=(
            *frame.notes,
            *j.notes,
            *_late(f),
            *(_at_limit(f) if not (effects or j.open_ends or j.suspects) else ()),
            *_worse(channels),
            *(note for log in logs for note in log.notes),
        ),
        series=_series(f, j.floor),
        source="; ".join(log.source for log in logs),
    )


def _at_limit(f: Fitted) -> tuple[str, ...]:
    """Of a stand held against a given model: what its corrections take more of than they may."""
    frame = f.channels.frame
    if not isinstance(frame, StandFrame) or frame.free_nuisance:
        return ()
    at = [
        name
        for name, deviation, value in zip(f.names, f.after.deviation, f.after.values, strict=False)
        if name.endswith(OF_MODEL) and abs(value) > 2.0 * deviation
    ]
    if not at:
        return ()
    return (
        f"{', '.join(at)}: as large as a given model may be off by; something small may hide in them "
        "(more rows at low and full speed would tell)",
    )


def _late(f: Fitted) -> tuple[str, ...]:
    """Of a stand's loads that come later than cells and clocks may."""
    late = {n: v for n, v in f.corrections.items() if n.endswith(DELAY) and abs(v) > DELAY_S}
    if not isinstance(f.channels.frame, StandFrame) or not late:
        return ()
    which = ", ".join(f"{name.removesuffix(DELAY)} {value:.2g} s" for name, value in late.items())
    return (f"after the speeds, by a filter or another clock: {which}; it is corrected, and no effect",)


def _worse(channels: Mapping[str, ChannelError]) -> tuple[str, ...]:
    """What the effects make worse where they mend other channels."""
    more = {
        name: c.rmse_after / c.rmse_before - 1.0
        for name, c in channels.items()
        if c.rmse_after > max(c.rmse_before, c.noise_floor) and c.rmse_before > 0.0
    }
    worse = ", ".join(f"{name} by {100 * x:.0f} %" for name, x in more.items() if x >= WORTH_SAYING)
    return (f"errs more with the effects than without: {worse}",) if worse else ()


def _errors(f: Fitted, floor: Array) -> dict[str, ChannelError]:
    """Errors by channel, on rows that the fits did not see."""
    ch, before, after = f.channels, f.before, f.after
    out = {}
    for c, name in enumerate(ch.names):
        out[name] = ChannelError(
            unit=ch.units[c],
            noise_floor=float(floor[c]),
            rmse_before=float(before.errors[c]),
            rmse_after=float(after.errors[c]),
            ci_before=error_interval(before.held_out[:, c], ch.block),
            ci_after=error_interval(after.held_out[:, c], ch.block),
            held_out_rows=len(ch.target),
            rmse_as_given=float(np.sqrt(np.mean(ch.target[:, c] ** 2))),
        )
    return out


def _found(f: Fitted, m: Member, draws: Array, claim: Mapping[str, Any]) -> FoundEffect:
    """A member with its numbers, their 95 % intervals over blocks drawn again, and its worth."""
    ch, effect = f.channels, m.effect
    parameters = []
    sampled = [f.numbers(m, d) for d in draws]
    for name, value in f.numbers(m, f.after.values).items():
        low, high = np.quantile([s[name] for s in sampled], [0.025, 0.975])
        row = 1.0 / ch.frame.rate_hz if name == ONSET else 0.0  # a beginning is known to a row
        interval = (min(float(low), value - row), max(float(high), value + row))
        if interval[0] == interval[1] and name in m.keys:
            at = f.columns([m])[-len(m.keys) :][m.keys.index(name)]
            limits = effect.free(ch.bare, m.shape)[name]
            interval = _against_limit(value, limits, m.shape[name] + draws[:, at])
        parameters.append(ParameterValue(name, value, interval, effect.units.get(name, "1")))
    without = f.of([o for o in f.members if o is not m]).after.errors
    rmse = {n: (float(without[c]), float(f.after.errors[c])) for c, n in enumerate(ch.names)}
    touched = tuple(n for n, (a, b) in rmse.items() if n in effect.channels and b < 0.98 * a)
    touched = touched or tuple(n for n in ch.names if n in effect.channels)
    was = [dict(numbers) for known, numbers in ch.known if known.name == m.name]
    return FoundEffect(
        m.name,
        touched,
        tuple(parameters),
        {n: rmse[n] for n in touched},
        dict(claim) | ({"was": was[0]} if was else {}),
        f"{effect.physics}; {effect.source}",
        effect.needs,
    )


def _against_limit(value: float, limits: tuple[float, float], drawn: Array) -> tuple[float, float]:
    """95 % interval of a number that all draws (D,) take to one of its limits or beyond: what of their normal
    distribution is inside."""
    if not len(drawn) or limits[0] == limits[1]:
        return value, value
    middle, spread = float(np.mean(drawn)), max(float(np.std(drawn)), 1e-6 * (limits[1] - limits[0]))
    low, high = ((x - middle) / spread for x in limits)
    below = value - limits[0] < limits[1] - value
    other = float(truncnorm.ppf(0.95 if below else 0.05, low, high, middle, spread))
    return (value, other) if below else (other, value)


def _rebased(f: Fitted) -> RotorModel:
    """The model, with its polynomials as fitted beside the effects where the nuisance model was free."""
    frame = f.channels.frame
    model: RotorModel = frame.model
    if isinstance(frame, FlightFrame):
        return rebased_flight(frame, f.corrections) if f.members else model
    if not frame.free_nuisance:
        return model
    terms = {load: dict(named) for load, named in model.terms().items()}
    for name, value in f.corrections.items():
        load, _, term = name.partition(" ")
        if term in terms.get(load, {}):
            terms[load][term] += value
    return model.having(terms)


def _with_effects(model: RotorModel, effects: Sequence[FoundEffect]) -> RotorModel:
    """The model with the effects added; one it had under the same name is replaced.

    It is the vehicle as it landed: what began in mid-flight is there from now on.
    """
    added = tuple(
        EffectEntry(e.name, {q.name: q.value for q in e.parameters if q.name not in COMES}, tuple(e.needs))
        for e in effects
    )
    names = {e.name for e in added}
    return replace(model, effects=(*(e for e in model.effects if e.name not in names), *added))


def _series(f: Fitted, floor: Array) -> Series:
    ch = f.channels
    keep = ch.frame.keep
    step = max(1, len(keep) // SERIES_ROWS)
    causes = {}
    for m in f.members:
        for channel in m.effect.channels:
            label, values = m.effect.cause(ch.bare, m.shape, channel)
            causes[m.name, channel] = label, values[keep][::step]
    return Series(
        time_s=ch.frame.time_s[keep][::step],
        channels=ch.names,
        given=ch.target[::step],
        before=f.before.held_out[::step],
        after=f.after.held_out[::step],
        causes=causes,
        noise={name: float(floor[c]) for c, name in enumerate(ch.names)},
    )
