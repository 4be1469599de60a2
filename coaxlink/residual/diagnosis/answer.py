"""The posterior in words and numbers: the same object that the residual room's engine gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from coaxlink.data.samples import Samples
from coaxlink.frames import Array
from coaxlink.residual.answer.assemble import Judged, answer
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.claims import NOTHING, Claims, added_by, claims, forms_of
from coaxlink.residual.diagnosis.hypotheses import ODDS, Hypothesis, form_name
from coaxlink.residual.diagnosis.parts import Block
from coaxlink.residual.diagnosis.posterior import CLAIMED, Posterior
from coaxlink.residual.experiments.stand_run import Rival, stand_experiment
from coaxlink.residual.regression.joint_model import ONSET, Fitter, straight
from coaxlink.residual.regression.problem import Problem, build
from coaxlink.residual.result import (
    Ambiguous,
    Refinement,
    Rejected,
    Step,
    Suspect,
    Unexplained,
    probability,
)
from coaxlink.residual.search.select import Selection
from coaxlink.signals import noise_floor

OPEN = 0.9  # probability of a free form that is said
SHOWN = 12  # sets in the trace
# of the reference load, judgement: a row's noise of a good stand. A smooth part of the map this large is told
SMOOTH_SAID = 0.003


def answered(
    ch: Channels,
    found: Posterior | None,
    suspects: Sequence[Suspect],
    notes: Sequence[str],
    logs: Sequence[Samples],
) -> Refinement:
    """The answer to these logs; `found` is None where nothing may be claimed."""
    best = found.best if found else None
    said = claims(ch, found) if found else NOTHING
    doubts = _doubts(ch, found, said) if found else ()
    sure = said.sure
    doubtful = {n for d in doubts for n in d.names}
    problem = _problem(ch, best)
    members = tuple(m for m in best.members if m.name in sure | doubtful) if best else ()
    # a fit that does not see the rows about a beginning knows nothing of it
    members = tuple(replace(m, keys=tuple(k for k in m.keys if k != ONSET)) for m in members)
    fixed = [k for k in ch.known if k[0].name not in {m.name for m in members}]
    joint = Fitter(problem, ch.bare, fixed, ch.reduce).linear(members) if members else straight(problem, [])
    claimed = [o for o in joint.problem.options if o.name in sure]
    unexplained = _unexplained(ch, found, said) if found else ()
    judged = Judged(
        problem,
        Selection(members=claimed),
        joint,
        _floor(ch, best),
        {"time_s": ch.frame.time_s[ch.frame.keep], **ch.variables},  # it may stand still in a damaged log
        ch.known,
        tuple(suspects),
        (*(n for n in notes if n not in ch.frame.notes), *_smooth(ch, best)),
        found is not None,
        doubts,
        open_ends=tuple(unexplained),
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
                "probability": probability(found.of(e.name)),
                "nats": _worth(found, e.name),
            },
        )
        for e in out.effects
    )
    return replace(
        out,
        effects=effects,
        rejected=(*out.rejected, *_rejected(found, sure | doubtful, said)),
        trace=_trace(found),
    )


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
    problem = build(
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
    return replace(problem, noise_known=True)


def _floor(ch: Channels, best: Hypothesis | None) -> Array:
    """(C,) noise of what the best set leaves."""
    if best is None:
        return np.asarray(noise_floor(ch.target, ch.block.astype(float), np.full(ch.count, 6.0)))
    return np.asarray(np.std(best.left, axis=0))


def _doubts(ch: Channels, found: Posterior, said: Claims) -> tuple[Ambiguous, ...]:
    """Names of which one is there, and no one knows which."""
    names, group = said.group, set(said.group)
    if len(names) < 2:
        return ()
    rivals = []
    for name in names[:2]:
        h = found.without(group - {name})
        m = next((m for m in h.members if m.name == name), None) if h else None
        if m is not None:
            rivals.append(Rival(m.effect, m.parameters(ch.bare)))
    plan = None
    if len(rivals) == 2:
        plan = stand_experiment(ch.bare, found.best.fit.noise, rivals)
    told = (
        plan.text
        if plan
        else "no run inside what this log has seen tells them apart: record more of what each needs"
    )
    held = np.array([max(found.of(name), 1e-9) for name in names])
    shares = tuple(probability(float(p)) for p in held / np.sum(held))
    return (Ambiguous(names, told, plan, shares),)


def _unexplained(ch: Channels, found: Posterior, said: Claims) -> list[Unexplained]:
    """Free forms of the set of most mass, or of one that is ahead of it beside the same effects.

    Where what is left hangs together, the log does not say which form it is; that there is one it does.
    """
    best = found.best
    ahead = max((h for h in found.sets if h.effects == best.effects), key=lambda h: h.score)
    certain = ahead.score - best.score > -float(ODDS) - np.log(1.0 - CLAIMED)
    shown = ahead if certain else best
    pieces: dict[str, list[tuple[float, str, str]]] = {}
    for form, added in forms_of(ch, shown).items():
        variable, channel, length, _ = form.split("|")
        mine = found.any_of({form_name(f) for h in found.sets for f in h.forms if f.split("|")[1] == channel})
        if mine < OPEN and not certain:
            continue
        where = float(_values(ch, variable)[int(np.argmax(np.abs(added)))])
        text = f"{variable}: most at {where:.3g}, bends within {float(length):.2g} of its range"
        if mine < OPEN:
            text += f", {ahead.score - best.score:.0f} nats; what it hangs on is not told"
        else:
            text += f", probability {found.of(form_name(form)):.3f}"
        pieces.setdefault(channel, []).append((float(np.std(added)), variable, text))
    for name, why in said.withheld.items():
        added = added_by(ch, best, name)
        c = int(np.argmax(np.std(added, axis=0) / ch.reference))
        m = next(m for m in best.members if m.name == name)
        label, _ = m.effect.cause(ch.bare, m.shape, ch.names[c])
        text = f"{label}: as {name} would have it, but {why}"
        pieces.setdefault(ch.names[c], []).append((float(np.std(added[:, c])), label, text))
    out = []
    for channel, parts in pieces.items():
        parts.sort(reverse=True)
        variables = tuple(dict.fromkeys(v for _, v, _ in parts))[:3]
        out.append(Unexplained(channel, variables, parts[0][0], parts[0][2]))
    return sorted(out, key=lambda u: -u.rmse / ch.reference[ch.names.index(u.channel)])


def _values(ch: Channels, variable: str) -> Array:
    if variable in ch.variables:
        return np.asarray(ch.variables[variable])
    first, sign, second = variable.split(" ")
    return np.asarray(ch.variables[first] + (1.0 if sign == "+" else -1.0) * ch.variables[second])


def _smooth(ch: Channels, best: Hypothesis | None) -> list[str]:
    """What the map adds to the polynomials: a part of the rotor model, told by its size."""
    if best is None:
        return []
    out, at = [], sum(b.width for b in ch.nuisance)
    for block in ch.surface:
        values = best.fit.values[at : at + block.width]
        at += block.width
        c = int(np.argmax(np.abs(block.columns).sum(axis=(0, 2))))
        size = float(np.sqrt(np.mean((block.columns[:, c] @ values) ** 2)))
        if size > SMOOTH_SAID * ch.reference[c]:
            out.append(
                f"{ch.names[c]}: a smooth surface of {size:.2g} {ch.units[c]} rms over the speeds"
                " belongs to the rotor map"
            )
    return out


def _worth(found: Posterior, name: str) -> float:
    """Log odds of the evidence for a name: the best set with it against the best without."""
    rival = found.without([name])
    return round(float(found.best.score - rival.score), 1) if rival else float(found.best.score)


def _rejected(found: Posterior, kept: frozenset[str] | set[str], said: Claims) -> list[Rejected]:
    out = []
    for name, p in found.effects.items():
        if name not in kept:
            with_it = max((h for h in found.sets if name in h.names), key=lambda h: h.score)
            behind = found.best.score - with_it.score
            why = said.withheld.get(name, f"{behind:.1f} nats behind the most probable set")
            out.append(Rejected(name, f"probability {p:.3g}: {why}"))
    return out


def _trace(found: Posterior) -> tuple[Step, ...]:
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
