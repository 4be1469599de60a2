"""From a log to its answer: faults first, then the posterior over sets of explanations, then what it says."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from coaxlink.channels.judged_rows import LEAST_ROWS
from coaxlink.channels.stand import joined, stand_frame
from coaxlink.data.samples import Samples
from coaxlink.evidence.noise import COLOUR_ROUNDS, Colour, white
from coaxlink.instruments.stand.suspects import find_suspects
from coaxlink.residual.answer.concluded import answered
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.decide import NOTHING, decided
from coaxlink.residual.diagnosis.faults import weighed_faults
from coaxlink.residual.diagnosis.hypotheses import ODDS, Hypothesis, Scorer, coloured
from coaxlink.residual.diagnosis.posterior import Posterior, posterior
from coaxlink.residual.diagnosis.search import Search
from coaxlink.residual.diagnosis.shown import Shown, would_show
from coaxlink.residual.diagnosis.stand import stand_channels
from coaxlink.residual.experiments.stand_run import CLEAR, Experiment, Rival, stand_experiment
from coaxlink.residual.result import HIDDEN, Refinement, WouldShow
from coaxlink.rotor import RotorModel

Progress = Callable[[str], None]
SAME_COLOUR = 0.05  # of a coefficient
NAMED_EVIDENCE = 30.0  # log evidence that a claimed name has, at the least: the smallest size is for that
STARTS = 4  # sets that the next round begins with
ALL_ROWS = 20_000  # of the last fit
SPEEDS = ("upper_rpm", "lower_rpm")
IN_DOUBT = "a tachometer is flagged: every load is predicted from speeds, so no effect is claimed"


@dataclass(frozen=True)
class Diagnosis:
    """The posterior over sets, and the colour of the noise it was found under."""

    posterior: Posterior
    colour: Colour
    channels: Channels  # with the map's discrepancy that it was found beside
    would_show: Mapping[str, Shown]  # of every effect what would have been named


def diagnosed(ch: Channels, progress: Progress) -> Diagnosis:
    """Search under white noise and under the colour of what no set at all leaves, then under that of what the
    best set leaves, until it stays.

    A slow effect is noise under a colour that has it already; under white noise a wander is an effect.
    The map's discrepancy goes the same way: the one that nothing else asks for, then that of the best set.
    """
    ch = mapped(ch, white(ch.count))
    empty = Scorer(ch, white(ch.count)).empty
    first = [white(ch.count), coloured(ch, empty).colour]
    starts: list[Hypothesis] = []
    for colour in first[:1] if _same(*first) else first:
        visited = Search(Scorer(ch, colour), lambda reported: progress(f"weighing {reported}")).run()
        starts += visited.ranked()[:STARTS]
    for number in range(COLOUR_ROUNDS):
        # noise is what the set leaves that has most evidence under the colour of what itself leaves: what
        # wanders is no form over time, and a form over time no noise, before both were weighed
        best = max((coloured(ch, h) for h in (*starts, empty)), key=lambda h: h.score)
        better = mapped(ch, best.colour, best)
        if number and _same(best.colour, colour) and better.map == ch.map:
            break
        ch, colour = better, best.colour
        scorer = Scorer(ch, colour)
        search = Search(scorer, lambda reported: progress(f"weighing {reported}"))
        visited = search.run(starts)
        empty, starts = scorer.empty, visited.ranked()[:STARTS]
    found = posterior(ch, scorer.colour, visited.ranked())
    return Diagnosis(found, scorer.colour, ch, would_show(search, NAMED_EVIDENCE))


def mapped(ch: Channels, colour: Colour, best: Hypothesis | None = None) -> Channels:
    """The channels with the map's discrepancy of most evidence, beside nothing and beside a set's effects.

    What is fitted to the log itself always misses something, in one size or another. Of fifty given models
    one does, as one of fifty logs shows an effect; its sizes and lengths share these odds.
    """
    if not ch.maps:
        return ch
    scores = {}
    for name in ch.maps if ch.bare.free_nuisance else ("", *ch.maps):
        scorer = Scorer(ch.with_map(name), colour)
        score = scorer.empty.score
        if best is not None and best.members:
            score = max(score, scorer.linearised(best.members, (), best.fit.noise, share=best.share)[0].score)
        scores[name] = score + (float(ODDS) - np.log(len(ch.maps)) if name else 0.0)
    return ch.with_map(max(scores, key=lambda name: scores[name]))


def _same(a: Colour, b: Colour) -> bool:
    pairs = zip(a.ahead, b.ahead, strict=True)
    same = all(len(x) == len(y) and bool(np.allclose(x, y, atol=SAME_COLOUR)) for x, y in pairs)
    return same and a.wander == b.wander


def diagnose_stand(several: Sequence[Samples], model: RotorModel | None, progress: Progress) -> Refinement:
    """What these stand logs say of the model, or of their own fit.

    Raises InputError when speeds or loads are missing.
    """
    progress("reading the stand")
    samples = joined(several)
    wrong = find_suspects(stand_frame(samples, model))
    silent = wrong.mislabelled
    if not silent:
        samples = samples.without(*wrong.columns)
    trusted = np.flatnonzero(np.logical_not(wrong.bad))
    if silent and len(trusted) < LEAST_ROWS:
        trusted = np.arange(samples.rows)
    ch = stand_channels(samples, model, trusted)
    found = None
    suspects = list(wrong.suspects)
    notes = list(ch.notes)
    if len(trusted) < LEAST_ROWS:
        notes.append(f"{len(trusted)} rows: held against the model; too few to identify any effect")
    elif any(x.column in SPEEDS for x in suspects):
        notes.append(IN_DOUBT)
    elif not silent:
        found = diagnosed(ch, progress)
        progress("weighing faults")
        fault = weighed_faults(found.channels, found.posterior.best)
        if fault is not None:
            suspects.append(fault.suspect)
            sound = trusted[~fault.rows[trusted]]
            found = None
            if len(sound) >= LEAST_ROWS:
                trusted = sound
                ch = stand_channels(samples, model, trusted)
                found = diagnosed(ch, progress)
    progress("judging")
    every = stand_channels(samples, model, trusted, most=ALL_ROWS)
    if found:
        every = every.with_map(found.channels.map)
    reported = decided(found.channels, found.posterior) if found else NOTHING
    out = answered(every, found.posterior if found else None, reported, suspects, notes, several)
    if found is None:
        return out
    named = {e.name for e in out.effects} | reported.grouped
    shown = {n: s for n, s in found.would_show.items() if n not in named}
    least = [WouldShow(n, s.share, s.channel, s.alike) for n, s in shown.items()]
    out = replace(out, would_show=tuple(sorted(least, key=lambda w: w.share)))
    return out if named or suspects else replace(out, next_run=_next_run(found, shown))


def _next_run(found: Diagnosis, shown: Mapping[str, Shown]) -> Experiment | None:
    """Where nothing is named, the run that would tell the two apart that this log would have taken for one
    another; None where there are none.
    """
    alike = [(s.share, n, o) for n, s in shown.items() for o in s.alike if o in shown and s.share < HIDDEN]
    if not alike:
        return None
    _, *names = min(alike)
    frame, noise = found.channels.bare, found.posterior.best.fit.noise
    members = [shown[name].member for name in names]
    rivals = [Rival(m.effect, m.parameters(frame)) for m in members]
    return stand_experiment(frame, noise, rivals, enough=CLEAR)
