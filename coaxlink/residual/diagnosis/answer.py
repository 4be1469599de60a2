"""The posterior in words and numbers: the same object that the residual room's engine gives."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from coaxlink.data.samples import Samples
from coaxlink.effects import flight_effects, stand_effects
from coaxlink.effects.tracing import Tracing
from coaxlink.frames import Array
from coaxlink.residual.answer.assemble import Judged, answer
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.decide import Decision, Group
from coaxlink.residual.diagnosis.features import forms_of
from coaxlink.residual.diagnosis.hypotheses import WHOLE, Hypothesis, is_whole
from coaxlink.residual.diagnosis.parts import Block
from coaxlink.residual.diagnosis.posterior import Posterior
from coaxlink.residual.experiments.stand_run import Rival, stand_experiment
from coaxlink.residual.regression.joint_model import Fitter, Joint, Member, straight
from coaxlink.residual.regression.problem import Problem, build
from coaxlink.residual.result import (
    Ambiguous,
    FoundEffect,
    Refinement,
    Rejected,
    SmoothSurface,
    Step,
    Suspect,
    Unexplained,
)
from coaxlink.signals import noise_floor

SHOWN = 12  # sets in the trace
# of the reference load, judgement: a row's noise of a good stand. A smooth part of the map this large is told
SMOOTH_SAID = 0.003


def answered(
    ch: Channels,
    found: Posterior | None,
    said: Decision,
    suspects: Sequence[Suspect],
    notes: Sequence[str],
    logs: Sequence[Samples],
    held: Collection[str] = (),
) -> Refinement:
    """The answer to these logs; `found` is None where nothing may be claimed.

    Of effects that are `held` the shape stays as the evidence has it: in the last, linear fit it has no prior
    and moves to where physics ends.
    """
    sure, leading = {*said.claimed}, {*said.claimed, *(g.names[0] for g in said.groups)}
    best = _borne_out(found, leading) if found else None
    doubts = tuple(_doubt(ch, found, g) for g in said.groups) if found else ()
    problem = _problem(ch, best)
    members = tuple(m for m in best.members if m.name in leading) if best else ()
    fixed = [k for k in ch.known if k[0].name not in {m.name for m in members}]
    members = tuple(replace(m, whole=is_whole(m), keys=() if m.name in held else m.keys) for m in members)
    fitter = Fitter(problem, ch.bare, fixed, ch.reduce)
    joint = held_whole(fitter.linear(members)) if members else straight(problem)
    judged = Judged(
        problem,
        frozenset(sure),
        joint,
        _floor(ch, best),
        {"time_s": ch.frame.time_s[ch.frame.keep], **ch.variables},  # it may stand still in a damaged log
        ch.known,
        tuple(suspects),
        tuple(n for n in notes if n not in ch.frame.notes),
        found is not None,
        doubts,
        open_ends=tuple(_unexplained(ch, found, said)) if found else (),
        impossible=ch.impossible,
    )
    out = answer(judged, logs)
    if found is None:
        return out
    effects = tuple(
        replace(
            e,
            evidence={
                **e.evidence,
                "probability": round(said.claimed[e.name], 4),
                "nats": worth(found, e.name),
            },
        )
        for e in out.effects
    )
    others = (*out.rejected, *rejected(found, said))
    surface = _smooth(ch, best)
    return replace(
        out, effects=effects, rejected=others, trace=trace_of(found), surface=surface, weighed=said.weighed
    )


def held_whole(joint: Joint) -> Joint:
    """The linear problem with the prior of what is there as a whole, as the evidence has it."""
    bounds = joint.problem.blocks.bounds.copy()
    for option, m in zip(joint.problem.options, joint.members, strict=True):
        if m.whole:
            bounds[option.columns[0]] = -2.0 * WHOLE
    return replace(joint, problem=replace(joint.problem, blocks=replace(joint.problem.blocks, bounds=bounds)))


def refused(effect: FoundEffect) -> bool:
    """Whether physics does not allow the numbers that all rows gave an effect."""
    numbers = {p.name: p.value for p in effect.parameters}
    every: tuple[Tracing[Any], ...] = (*stand_effects(), *flight_effects())
    return any(e.refuse(numbers) is not None for e in every if e.name == effect.name)


def _borne_out(found: Posterior, names: set[str]) -> Hypothesis:
    """The best set of just these effects; the leading one where none was visited."""
    return max((h for h in found.sets if h.effects == names), key=lambda h: h.score, default=found.best)


def _problem(ch: Channels, best: Hypothesis | None) -> Problem:
    """Base, map and the free forms of the best set as corrections drawn from their priors."""
    blocks: list[Block] = [*ch.nuisance, *ch.surface]
    blocks += [ch.forms[f]() for f in (best.forms if best else ())]
    corrections = []
    for block in blocks:
        for k in range(block.width):
            name = block.name if block.width == 1 else f"{block.name} {k}"
            corrections.append((name, -2.0 * float(block.deviation[k]), block.columns[..., k]))
    sigma = (
        best.fit.noise
        if best
        else np.maximum(
            noise_floor(ch.target, ch.block.astype(float), np.full(ch.count, 6.0)), ch.least_noise
        )
    )
    return build(
        frame=ch.bare if not ch.known else ch.frame,
        channels=ch.names,
        units=ch.units,
        reference=ch.reference,
        residual=ch.target,
        sigma=np.maximum(sigma, ch.least_noise),
        corrections=corrections,
        effects=(),
        reduce=ch.reduce,
        block=ch.block,
    )


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


def _doubt(ch: Channels, found: Posterior, group: Group) -> Ambiguous:
    """Names of which one is there, and no one knows which."""
    rivals = rivals_of(ch, found, group)
    plan = stand_experiment(ch.bare, found.best.fit.noise, rivals) if len(rivals) == 2 else None
    experiment = (
        plan.text
        if plan
        else "no run inside what this log has seen tells them apart: record more of what each needs"
    )
    held = np.array([max(found.of(name), 1e-9) for name in group.names[1:]])
    others = (group.probability - group.first) * held / np.sum(held)
    return Ambiguous(group.names, experiment, plan, tuple(round(float(p), 4) for p in (group.first, *others)))


def _unexplained(ch: Channels, found: Posterior, said: Decision) -> list[Unexplained]:
    """What is there beyond the names, where the decision says so: free forms, and causes of withheld
    names.
    """
    if not said.is_open:
        return []
    shown = max((h for h in found.sets if h.effects == found.best.effects), key=lambda h: h.score)
    pieces: dict[str, list[tuple[float, str, str]]] = {}
    for (form, channel), added in forms_of(ch, shown).items():
        variable, _, length, _ = form.split("|")
        where = float(_values(ch, variable)[int(np.argmax(np.abs(added)))])
        text = (
            f"{variable.split(' & ')[0]}: most at {where:.3g}, bends within {float(length):.2g} of its range"
        )
        pieces.setdefault(channel, []).append((float(np.std(added)), variable, text))
    for m in [m for m in shown.members if m.name in said.withheld]:
        u = unnamed(ch, found, shown, m, said.withheld[m.name])
        pieces.setdefault(u.channel, []).append((u.rmse, u.depends_on[0], u.where))
    if not pieces and not said.claimed and not said.groups:
        left = np.std(shown.left, axis=0)
        c = int(np.argmax(left / ch.reference))
        why = f"probability {said.opened:.2f} that something is there; it follows nothing that was recorded"
        pieces[ch.names[c]] = [(float(left[c]), "time_s", why)]
    out = []
    for channel, parts in pieces.items():
        parts.sort(reverse=True)
        variables = tuple(dict.fromkeys(v for _, both, _ in parts for v in both.split(" & ")))[:3]
        out.append(Unexplained(channel, variables, parts[0][0], parts[0][2]))
    return sorted(out, key=lambda u: -u.rmse / ch.reference[ch.names.index(u.channel)])


def unnamed(ch: Channels, found: Posterior, h: Hypothesis, m: Member, probability: float) -> Unexplained:
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
        f"probability {probability:.2f}: no name for it"
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
    out, at = [], sum(b.width for b in ch.nuisance)
    for block in ch.surface:
        values = best.fit.values[at : at + block.width]
        at += block.width
        c = int(np.argmax(np.abs(block.columns).sum(axis=(0, 2))))
        size = float(np.sqrt(np.mean((block.columns[:, c] @ values) ** 2)))
        if size > SMOOTH_SAID * ch.reference[c] and not ch.names[c].endswith("_speed"):
            out.append(SmoothSurface(ch.names[c], size, size / float(ch.reference[c]), ch.units[c]))
    return tuple(out)


def worth(found: Posterior, name: str) -> float:
    """Log odds of the evidence for a name: the best set with it against the best without."""
    rival = found.without([name])
    return round(float(found.best.score - rival.score), 1) if rival else float(found.best.score)


def rejected(found: Posterior, said: Decision) -> list[Rejected]:
    """Every name that some set holds and that is not said, and why."""
    out = []
    for name in sorted({n for h in found.sets for n in h.effects} - {*said.claimed} - said.grouped):
        if name in said.withheld:
            out.append(Rejected(name, f"probability {said.withheld[name]:.2f}: too little for a name"))
            continue
        with_it = max((h for h in found.sets if name in h.names), key=lambda h: h.score)
        behind = found.best.score - with_it.score
        out.append(Rejected(name, f"{behind:.1f} nats behind the most probable set"))
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
