"""The posterior in words and numbers: the same object that the residual room's engine gives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from coaxlink.data.samples import Samples
from coaxlink.frames import Array
from coaxlink.residual.answer.report import Fitted, Judged, fitted_about, reported
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.decide import Decision, Group
from coaxlink.residual.diagnosis.features import forms_of
from coaxlink.residual.diagnosis.hypotheses import Hypothesis
from coaxlink.residual.diagnosis.posterior import Posterior
from coaxlink.residual.experiments.stand_run import Experiment, Rival, stand_experiment
from coaxlink.residual.members import Member
from coaxlink.residual.result import (
    Ambiguous,
    Refinement,
    Rejected,
    SmoothSurface,
    Step,
    Suspect,
    Unexplained,
)
from coaxlink.signals import noise_floor

Planned = Callable[[Any, Array, Sequence[Rival]], Experiment | None]
NO_RUN = "no run within this log's range distinguishes them: record more of what each needs"
SHOWN = 12  # sets in the trace
# of the reference load, judgement: a row's noise of a good stand. A smooth part of the map this large is told
SMOOTH_REPORTED = 0.003


def answered(
    ch: Channels,
    found: Posterior | None,
    stated: Decision,
    suspects: Sequence[Suspect],
    notes: Sequence[str],
    logs: Sequence[Samples],
) -> Refinement:
    """The answer to these stand logs; `found` is None where nothing may be claimed."""
    leading = {*stated.claimed, *(g.names[0] for g in stated.groups)}
    best = _borne_out(found, leading) if found else None
    members = [m for m in best.members if m.name in leading] if best else []
    fitted = fitted_about(ch, members, best)
    if not _helps(fitted, stated):
        names = stated.claimed
        without = replace(stated, claimed={}, withheld={**stated.withheld, **names}, refuted=frozenset(names))
        there = replace(without, opened=max(stated.opened, *names.values()), is_open=True)
        return answered(ch, found, there, suspects, notes, logs)
    out = concluded(
        fitted,
        found,
        stated,
        _floor(ch, best),
        (suspects, [n for n in notes if n not in ch.frame.notes]),
        [doubt_of(ch, found, g, stand_experiment, NO_RUN) for g in stated.groups] if found else [],
        _unexplained(ch, found, stated) if found else [],
        logs,
    )
    return replace(out, surface=_smooth(ch, best))


def _helps(fitted: Fitted, stated: Decision) -> bool:
    """Whether any channel errs less with what is claimed, on rows that the fits did not see."""
    mine = fitted.of([m for m in fitted.members if m.name in stated.claimed])
    return not mine.members or bool(np.any(mine.after.errors < mine.before.errors))


def concluded(
    fitted: Fitted,
    found: Posterior | None,
    stated: Decision,
    floor: Array,
    beside: tuple[Sequence[Suspect], Sequence[str]],
    doubts: Sequence[Ambiguous],
    open_ends: Sequence[Unexplained],
    logs: Sequence[Samples],
) -> Refinement:
    """The answer about members that are reported; `beside` are what is suspect, and notes."""
    suspects, notes = beside
    claims = {
        n: {"probability": round(p, 4), "nats": worth(found, n)} for n, p in stated.claimed.items() if found
    }
    judged = Judged(
        fitted,
        claims,
        floor,
        tuple(suspects),
        tuple(notes),
        tuple(doubts),
        tuple(open_ends),
        tuple(rejected(found, stated)) if found else (),
        trace_of(found) if found else (),
    )
    more = round(stated.opened, 4) if found else None
    return replace(reported(judged, logs), more=more, weighed=stated.weighed)


def _borne_out(found: Posterior, names: set[str]) -> Hypothesis:
    """The best set of just these effects; the leading one where none was visited."""
    return max((h for h in found.sets if h.effects == names), key=lambda h: h.score, default=found.best)


def _floor(ch: Channels, best: Hypothesis | None) -> Array:
    """(C,) noise of what the best set leaves."""
    if best is None:
        return np.asarray(noise_floor(ch.target, ch.block.astype(float), np.full(ch.count, 6.0)))
    return np.asarray(np.std(best.left, axis=0))


def rivals_of(ch: Channels, found: Posterior, group: Group) -> list[Rival]:
    """The first two names of a group, each with its numbers where it is there without the others."""
    rivals = []
    for name in group.names[:2]:
        h = found.without({*group.names} - {name})
        m = next((m for m in h.members if m.name == name), None) if h else None
        if m is not None:
            rivals.append(Rival(m.effect, m.parameters(ch.bare)))
    return rivals


def doubt_of(ch: Channels, found: Posterior, group: Group, planned: Planned, none: str) -> Ambiguous:
    """Names of which one is there, and no one knows which; what would tell is planned, or `none` reported."""
    rivals = rivals_of(ch, found, group)
    plan = planned(ch.bare, found.best.fit.noise, rivals) if len(rivals) == 2 else None
    held = np.array([max(found.of(name), 1e-9) for name in group.names[1:]])
    others = (group.probability - group.first) * held / np.sum(held)
    stated = tuple(round(float(p), 4) for p in (group.first, *others))
    return Ambiguous(group.names, plan.text if plan else none, plan, stated)


def _unexplained(ch: Channels, found: Posterior, stated: Decision) -> list[Unexplained]:
    """What is there beyond the names, where the decision says so: free forms, and causes of withheld
    names.
    """
    if not stated.is_open:
        return []
    shown = max((h for h in found.sets if h.effects == found.best.effects), key=lambda h: h.score)
    pieces = pieces_of(ch, shown)
    for m in [m for m in shown.members if m.name in stated.withheld]:
        u = unnamed(ch, found, shown, m, stated.doubt(m.name))
        pieces.setdefault(u.channel, []).append((u.rmse, u.depends_on[0], u.where))
    if not pieces and not stated.claimed and not stated.groups:
        left = np.std(shown.left, axis=0)
        c = int(np.argmax(left / ch.reference))
        why = f"probability {stated.opened:.2f} that something is there; it follows nothing that was recorded"
        pieces[ch.names[c]] = [(float(left[c]), "time_s", why)]
    return unexplained_of(ch, pieces)


Pieces = dict[str, list[tuple[float, str, str]]]  # by channel: size, variables, words


def pieces_of(ch: Channels, shown: Hypothesis) -> Pieces:
    """Of every free form of a set, by channel."""
    pieces: Pieces = {}
    for (form, channel), added in forms_of(ch, shown).items():
        variable, _, length, _ = form.split("|")
        where = float(_values(ch, variable)[int(np.argmax(np.abs(added)))])
        text = (
            f"{variable.split(' & ')[0]}: most at {where:.3g}, bends within {float(length):.2g} of its range"
        )
        pieces.setdefault(channel, []).append((float(np.std(added)), variable, text))
    return pieces


def unexplained_of(ch: Channels, pieces: Pieces) -> list[Unexplained]:
    """Of every channel the largest, the largest over its load first."""
    out = []
    for channel, parts in pieces.items():
        parts.sort(reverse=True)
        variables = tuple(dict.fromkeys(v for _, both, _ in parts for v in both.split(" & ")))[:3]
        out.append(Unexplained(channel, variables, parts[0][0], parts[0][2]))
    return sorted(out, key=lambda u: -u.rmse / ch.reference[ch.names.index(u.channel)])


def unnamed(ch: Channels, found: Posterior, h: Hypothesis, m: Member, doubt: str) -> Unexplained:
    """What a member explains that is not probable enough for a name, corrections having given way."""
    less = [o for o in found.sets if o.names <= h.names - {m.name}]
    without = max(less, key=lambda o: o.score) if less else found.without({m.name})
    moved = h.left if without is None else without.left - h.left
    rms = np.sqrt(np.mean(moved**2, axis=0))
    mine = [c for c, name in enumerate(ch.names) if name in m.effect.channels]
    c = max(mine or range(ch.count), key=lambda k: rms[k] / ch.reference[k])
    label, _ = m.effect.cause(ch.bare, m.shape, ch.names[c])
    text = (
        f"{label}: {100.0 * rms[c] / ch.reference[c]:.2g} % of the load, as {m.name} would have it, "
        f"{doubt}: no name for it"
    )
    return Unexplained(ch.names[c], (label,), float(rms[c]), text)


def _values(ch: Channels, variable: str) -> Array:
    if variable in ch.variables:
        return np.asarray(ch.variables[variable])
    first, sign, second = variable.split(" ")
    if sign == "&":
        return np.asarray(ch.variables[first])
    return np.asarray(ch.variables[first] + (1.0 if sign == "+" else -1.0) * ch.variables[second])


def _smooth(ch: Channels, best: Hypothesis | None) -> tuple[SmoothSurface, ...]:
    """What the map adds to the polynomials: a part of the rotor model, named with its size."""
    if best is None:
        return ()
    smooth, at = np.zeros_like(ch.target), sum(b.width for b in ch.nuisance)
    for block in ch.surface:
        smooth += block.columns @ best.fit.values[at : at + block.width]
        at += block.width
    size = np.sqrt(np.mean(smooth**2, axis=0))
    return tuple(
        SmoothSurface(name, float(rms), float(rms / of), unit)
        for name, unit, rms, of in zip(ch.names, ch.units, size, ch.reference, strict=True)
        if rms > SMOOTH_REPORTED * of and not name.endswith("_speed")
    )


def worth(found: Posterior, name: str) -> float:
    """Log odds of the evidence for a name: the best set with it against the best without."""
    rival = found.without([name])
    return round(float(found.best.score - rival.score), 1) if rival else float(found.best.score)


def rejected(found: Posterior, stated: Decision) -> list[Rejected]:
    """Every name that some set holds and that is not reported, and why."""
    out = []
    for name in sorted({n for h in found.sets for n in h.effects} - {*stated.claimed} - stated.grouped):
        if name in stated.withheld:
            out.append(Rejected(name, f"{stated.doubt(name)}: too little for a name"))
            continue
        with_it = max((h for h in found.sets if name in h.names), key=lambda h: h.score)
        behind = found.best.score - with_it.score
        out.append(Rejected(name, f"log evidence {behind:.1f} below the most probable set's"))
    return out


def trace_of(found: Posterior) -> tuple[Step, ...]:
    """The most probable sets."""
    least = min((h.score for h in found.sets if h.score > -1e5), default=found.best.score)
    return tuple(
        Step(
            k + 1,
            "set",
            " + ".join(sorted(h.names)) or "nothing",
            h.score - least,
            float(m),
            0.0,
            h is found.best,
            f"probability {m:.3g}",
        )
        for k, (m, h) in enumerate(zip(found.mass[:SHOWN], found.sets[:SHOWN], strict=True))
    )
