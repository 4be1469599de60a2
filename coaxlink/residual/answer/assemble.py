"""The answer of a judgement: effects with intervals and evidence, rivals, and what stays unexplained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.stats import truncnorm

from coaxlink.data.samples import Samples
from coaxlink.effects.onset import COMES
from coaxlink.frames import Array, FlightFrame, StandFrame
from coaxlink.residual.nuisance.rebased_model import rebased_flight
from coaxlink.residual.regression.blocks import bootstrap, error_interval, held_out, solve
from coaxlink.residual.regression.coloured_noise import Colours, period_of
from coaxlink.residual.regression.dependence import dependences, time_path
from coaxlink.residual.regression.joint_model import ONSET, Joint, Part, columns_of
from coaxlink.residual.regression.problem import Option, Problem
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
# times the noise, share of the reference load: more is said to be unexplained; no wind is without gusts
SILENT, SILENT_SIZE, GUSTS = 1.3, 0.004, 0.0008
WORTH_SAYING = 0.02  # of a channel's error: by how much more it errs with the effects


@dataclass(frozen=True)
class Judged:
    """All that an answer is made of; `joint` holds the members and the doubtful ones."""

    problem: Problem  # before: the model as it came
    claims: frozenset[str]  # names of members that are claimed
    joint: Joint
    floor: Array  # (C,) noise floor
    variables: Mapping[str, Array]
    known: tuple[Part, ...]  # effects that the model carried already
    suspects: tuple[Suspect, ...] = ()
    notes: tuple[str, ...] = ()
    labelled: bool = True  # False: the labels are wrong as a whole, nothing is claimed
    doubts: tuple[Ambiguous, ...] = ()
    open_ends: tuple[Unexplained, ...] | None = None  # what is unexplained, where that is known already
    impossible: tuple[tuple[str, str], ...] = ()  # effects that cannot be tried beside the problem's, and why
    # of each claim, how far it is ahead and how probable
    evidence: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    rejected: tuple[Rejected, ...] = ()
    trace: tuple[Step, ...] = ()

    @property
    def claimed(self) -> list[Option]:
        """Options of the joint problem that are claimed."""
        return [o for o in self.joint.problem.options if o.name in self.claims]


def answer(j: Judged, logs: Sequence[Samples]) -> Refinement:
    """The whole answer."""
    p, q, members = j.problem, j.joint.problem, j.claimed
    use = columns_of(q, members)
    squares_before, fits_before = held_out(p.blocks, columns_of(p, []))
    # nothing added leaves what was there, whatever base a doubt was weighed beside
    taken = q if members else p
    squares_after, fits_after = held_out(q.blocks, use) if members else (squares_before, fits_before)
    before, after = held_out_residual(p, fits_before), held_out_residual(taken, fits_after)
    channels = _channels(j, taken.sigma, squares_before, squares_after)
    final = solve(q.blocks, use, np.ones(q.blocks.count))
    draws = bootstrap(q.blocks, use, DRAWS) if members else np.zeros((0, len(q.blocks.bounds)))
    named = [_found(j, k, final, draws, squares_after) for k in range(len(members))]
    effects, suspects = tuple(named), j.suspects
    unexplained = j.open_ends
    if unexplained is None:
        # what an ambiguous effect would explain is no open end: it is named, only its cause is in doubt
        squares_doubted, fits_doubted = held_out(q.blocks, columns_of(q))
        doubted = held_out_residual(q, fits_doubted)
        fold = q.blocks.fold[q.block]
        floor = _separated(p.frame, j.floor)
        found = dependences(doubted, j.variables, q.block, fold, q.reference, floor) if j.labelled else []
        attributed = _unexplained(p, found)
        unexplained = (*attributed, *_silent(j, attributed, squares_doubted, doubted))
    return Refinement(
        kind="flight" if isinstance(p.frame, FlightFrame) else "stand",
        channels=channels,
        effects=effects,
        unexplained=unexplained,
        ambiguous=j.doubts,
        suspect_data=suspects,
        rejected=(
            *j.rejected,
            *(Rejected(name, f"cannot be judged: {why}") for name, why in (*p.impossible, *j.impossible)),
        ),
        model=_with_effects(_rebased(q, final, bool(effects)), effects),
        corrections={name: float(final[i]) for i, name in enumerate(q.nuisance_names)},
        trace=j.trace,
        notes=(
            *p.frame.notes,
            *j.notes,
            *(_at_limit(q, final) if not (effects or unexplained or suspects) else ()),
            *_worse(channels),
            *(note for log in logs for note in log.notes),
        ),
        series=_series(j, before, after),
        source="; ".join(log.source for log in logs),
    )


def _at_limit(p: Problem, final: Array) -> tuple[str, ...]:
    """Of a stand held against a given model: what its corrections would take more of than they may."""
    if not isinstance(p.frame, StandFrame) or p.frame.free_nuisance:
        return ()
    bounds = p.blocks.bounds[p.nuisance]
    at = [
        name
        for name, bound, value in zip(p.nuisance_names, bounds, final[p.nuisance], strict=True)
        if name.endswith(OF_MODEL) and abs(value) > 0.999 * bound
    ]
    if not at:
        return ()
    return (
        f"{', '.join(at)}: as large as a given model may be off by; something small may hide in them "
        "(more rows at low and full speed would tell)",
    )


def _separated(frame: StandFrame | FlightFrame, floor: Array) -> Array:
    """(C,) noise that a dependence is held against: half of it is the least that counts.

    Where most of its power is what commands did between slow rows, that is no noise but follows the
    manoeuvre, as all does that is recorded of it: nothing smaller is told apart.
    """
    if not isinstance(frame, FlightFrame):
        return floor
    return np.asarray(np.where(frame.sampling**2 > 0.5 * floor**2, 2.0 * frame.sampling, floor))


def _worse(channels: Mapping[str, ChannelError]) -> tuple[str, ...]:
    """What the effects make worse where they mend other channels."""
    more = {
        name: c.rmse_after / c.rmse_before - 1.0
        for name, c in channels.items()
        if c.rmse_after > max(c.rmse_before, c.noise_floor) and c.rmse_before > 0.0
    }
    worse = ", ".join(f"{name} by {100 * x:.0f} %" for name, x in more.items() if x >= WORTH_SAYING)
    return (f"errs more with the effects than without: {worse}",) if worse else ()


def _channels(j: Judged, now: Array, before: Array, after: Array) -> dict[str, ChannelError]:
    """Errors by channel from held-out square sums (B, C), those after in units of `now` (C,)."""
    p, rows = j.problem, j.problem.blocks.rows
    was = p.sigma
    out = {}
    for c, name in enumerate(p.channels):
        low_b, high_b = error_interval(before[:, c], rows)
        low_a, high_a = error_interval(after[:, c], rows)
        out[name] = ChannelError(
            unit=p.units[c],
            noise_floor=float(j.floor[c]),
            rmse_before=float(was[c]) * _rms(before[:, c], rows),
            rmse_after=float(now[c]) * _rms(after[:, c], rows),
            ci_before=(float(was[c]) * low_b, float(was[c]) * high_b),
            ci_after=(float(now[c]) * low_a, float(now[c]) * high_a),
            held_out_rows=int(rows.sum()),
            rmse_as_given=float(was[c] * np.sqrt(np.mean(p.residual[:, c] ** 2))),
        )
    return out


def _rms(squares: Array, rows: Array) -> float:
    return float(np.sqrt(squares.sum() / rows.sum()))


def held_out_residual(p: Problem, fits: Array) -> Array:
    """(rows, C) residual of every row under the fit that did not see it, in the channels' units."""
    out = np.empty_like(p.residual)
    folds = np.unique(p.blocks.fold)
    for k, fold in enumerate(folds):
        rows = p.blocks.fold[p.block] == fold
        used = np.flatnonzero(fits[k])
        out[rows] = p.residual[rows] - p.design[rows][:, :, used] @ fits[k][used]
    return out * p.sigma


def _found(j: Judged, k: int, final: Array, draws: Array, squares_after: Array) -> FoundEffect:
    """Member k with its numbers, their 95 % intervals over blocks drawn again, and its worth."""
    q, option = j.joint.problem, j.claimed[k]
    effect = option.effect
    place = q.options.index(option)
    named = j.joint.named(place, final)
    sampled = [j.joint.named(place, d) for d in draws]
    parameters = []
    for name, value in named.items():
        values = np.array([s[name] for s in sampled])
        low, high = np.quantile(values, [0.025, 0.975]) if len(values) else (value, value)
        row = 1.0 / q.frame.rate_hz if name == ONSET else 0.0  # a beginning is known to a row
        interval = (min(float(low), value - row), max(float(high), value + row))
        if interval[0] == interval[1] and name in option.keys:
            moved = draws[:, option.columns[-len(option.keys) :][option.keys.index(name)]]
            interval = _against_limit(
                value, effect.free(q.frame, option.shape)[name], option.shape[name] + moved
            )
        parameters.append(ParameterValue(name, value, interval, effect.units.get(name, "1")))
    rest = [m for m in j.claimed if m is not option]
    without = held_out(q.blocks, columns_of(q, rest))[0].sum(axis=0)
    rows = q.blocks.rows.sum()
    rmse = {
        name: tuple(float(q.sigma[c] * np.sqrt(x[c] / rows)) for x in (without, squares_after.sum(axis=0)))
        for c, name in enumerate(q.channels)
    }
    touched = tuple(n for n, (a, b) in rmse.items() if n in effect.channels and b < 0.98 * a)
    touched = touched or tuple(n for n in q.channels if n in effect.channels)
    return FoundEffect(
        option.name,
        touched,
        tuple(parameters),
        {n: (rmse[n][0], rmse[n][1]) for n in touched},
        _evidence(j, option.name),
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


def _evidence(j: Judged, name: str) -> dict[str, Any]:
    """How probable it is; what numbers the model had."""
    was = [dict(parameters) for effect, parameters in j.known if effect.name == name]
    return dict(j.evidence.get(name, {})) | ({"was": was[0]} if was else {})


def _rebased(p: Problem, final: Array, found: bool) -> RotorModel:
    """The model, with its polynomials as fitted beside the effects where the nuisance model was free."""
    model: RotorModel = p.frame.model
    if isinstance(p.frame, FlightFrame):
        fitted = {name: float(final[i]) for i, name in enumerate(p.nuisance_names)}
        return rebased_flight(p.frame, fitted) if found else model
    if not (isinstance(p.frame, StandFrame) and p.frame.free_nuisance):
        return model
    terms = {load: dict(named) for load, named in model.terms().items()}
    for i, name in enumerate(p.nuisance_names):
        load, _, term = name.partition(" ")
        if term in terms.get(load, {}):
            terms[load][term] += float(final[i])
    return model.having(terms)


def _unexplained(p: Problem, found: Sequence[Any]) -> list[Unexplained]:
    out = []
    for c, name in enumerate(p.channels):
        mine = [d for d in found if d.channel == c]
        if mine:
            strongest = mine[0]
            related = tuple(dict.fromkeys(d.variable for d in mine if d.share > 0.5 * strongest.share))[:3]
            out.append(Unexplained(name, related, strongest.rms, f"{strongest.variable}: {strongest.where}"))
    return out


def _silent(j: Judged, attributed: Sequence[Unexplained], squares: Array, left: Array) -> list[Unexplained]:
    """Channels far above their noise though nothing recorded was found that they follow.

    Not where what is left (rows, C) is noise of a colour, as gusts and ringing are: of no period, whose turns
    may be too fast for a path over time.
    """
    q, rows, out = j.joint.problem, j.problem.blocks.rows, []
    if not j.labelled:
        return []
    gusty = any(o.name == "wind" for o in j.claimed)
    colours = Colours(left, j.floor, q.reference, flown=isinstance(q.frame, FlightFrame))
    every = np.zeros((len(q.frame.time_s), left.shape[1]))
    every[q.frame.keep] = left  # a period shows at the rows' own distances
    for c, name in enumerate(q.channels):
        low, _ = error_interval(squares[:, c], rows)
        rms = float(q.sigma[c]) * _rms(squares[:, c], rows)
        excess = float(np.sqrt(max(rms**2 - j.floor[c] ** 2, 0.0)))
        if name in {u.channel for u in attributed} or float(q.sigma[c]) * low < SILENT * j.floor[c]:
            continue
        enough = excess > (GUSTS if gusty else SILENT_SIZE) * q.reference[c]
        period = period_of(every[:, c], every[:, c]) if enough else None
        if enough and (period or not colours.hold(c, *time_path(left[:, c]))):
            where = f"{rms / j.floor[c]:.1f} times the noise between neighbouring rows, by nothing recorded"
            where += f", with a period of {period:.1f} rows" if period else ""
            where += ": the wind is not steady" if gusty else ""
            out.append(Unexplained(name, ("time_s",), excess, where))
    return out


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


def _series(j: Judged, before: Array, after: Array) -> Series:
    p = j.problem
    step = max(1, len(before) // SERIES_ROWS)
    causes = {}
    for m in j.claimed:
        for channel in m.effect.channels:
            shape = next(x.shape for x in j.joint.members if x.name == m.name)
            label, values = m.effect.cause(p.frame, shape, channel)
            causes[m.name, channel] = label, values[p.frame.keep][::step]
    return Series(
        time_s=j.variables["time_s"][::step],
        channels=p.channels,
        before=before[::step],
        after=after[::step],
        causes=causes,
        noise={name: float(j.floor[c]) for c, name in enumerate(p.channels)},
    )
