"""Which names may be claimed: those that the log itself, not a prior, tells from what could stand in.

The mass of a set depends on the widths of priors, each good to a factor of a few, and on odds that are the
same for every log (Kass and Raftery 1995, section 5.3, on how far Bayes factors can be believed). So a name
needs 99 % of the mass, and besides: the evidence must prefer it to nothing, and to another name in its place
also by the rows alone, by five standard errors, and to a free form in its place by as much as its odds ask.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coaxlink.frames import Array
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.hypotheses import ODDS, Hypothesis
from coaxlink.residual.diagnosis.posterior import CLAIMED, RIVAL, Posterior
from coaxlink.residual.regression.joint_model import composed

APART = 12.5  # nats: five standard errors, the level at which physics speaks of a discovery
# judgement: half of an effect. A form that is off by more is another form
CARRIED = 0.5
SAME_TIME_PROFILE = 0.99  # correlation, judgement: of two columns that no log of this length tells apart
EVERYWHERE = ("time_s", "upper_speed", "lower_speed")


@dataclass(frozen=True)
class Claims:
    """Names that are there, a group of which one is there, and why names of most mass are withheld."""

    sure: frozenset[str]
    group: tuple[str, ...]
    withheld: dict[str, str]


NOTHING = Claims(frozenset(), (), {})


def claims(ch: Channels, found: Posterior) -> Claims:
    """What may be said of the effects of the set of most mass."""
    sure = {n for n, p in found.effects.items() if p > CLAIMED}
    group = confounded(found, sure)
    withheld: dict[str, str] = {}
    for name in sure - group:
        if (alone := _against_nothing(found, name)) < APART:
            withheld[name] = f"without it the rest is {alone:.1f} nats behind: no name for so little"
            continue
        nats = _against_forms(ch, found, name)
        if nats < -float(ODDS) - np.log(1.0 - CLAIMED):
            withheld[name] = f"a free form in its place is {nats:.1f} nats behind: no name for it"
        elif (over := _not_carried(ch, found.best, name)) is not None:
            withheld[name] = f"{over} holds as much as it does: another form, without a name"
    names = tuple(sorted(group, key=lambda n: -found.of(n)))
    return Claims(frozenset(sure - group - set(withheld)), names, withheld)


def confounded(found: Posterior, sure: set[str]) -> set[str]:
    """Names of which one is there, and the log does not say which."""
    best = found.best
    for name in sorted(best.effects, key=found.of):
        others = {
            next(iter(h.effects - best.effects))
            for h in found.sets
            if best.effects - h.effects == {name}
            and len(h.effects - best.effects) == 1
            and len(h.names) <= len(best.names)
            and ahead(found, h, name) < APART
        }
        if others and found.any_of({name, *others}) > CLAIMED:
            return {name, *others}
    # one of which another is there is open by its mass already
    open_names = {n for n, p in found.effects.items() if RIVAL < p <= CLAIMED}
    for name in sorted(open_names, key=lambda n: -found.of(n)):
        others = {n for n in open_names - {name} if _confounded(found, name, n)}
        if others and found.any_of({name, *others}) > CLAIMED:
            return {name, *others}
    return set()


def ahead(found: Posterior, rival: Hypothesis, name: str) -> float:
    """Nats by which the set of most mass is ahead of another without a name, by evidence or by rows alone.

    Of these the less: by the rows alone every number more is expected to gain half a nat of noise. Or, if it
    is more, what the name gains beside what would be confounded with it.
    """
    return max(_less(found, rival), _beside(found, rival, name))


def _less(found: Posterior, rival: Hypothesis) -> float:
    best, k = found.index(found.best), found.index(rival)
    more = sum(len(m.point) for m in rival.members) - sum(len(m.point) for m in found.best.members)
    evidence = found.behind[k] - found.behind[best]
    return float(min(evidence, found.misfit[k] - found.misfit[best] + 0.5 * max(more, 0)))


def _beside(found: Posterior, rival: Hypothesis, name: str) -> float:
    """Nats that a name still gains beside what would be confounded with it; where that was not weighed, none.

    What a name explains as well with another in the set is not what the other explains.
    """
    wanted, k = rival.names | {name}, found.index(rival)
    both = [b for h, b in zip(found.sets, found.behind, strict=True) if h.names == wanted]
    return float(found.behind[k] - both[0]) if both else 0.0


def _against_nothing(found: Posterior, name: str) -> float:
    """Nats of evidence by which the set of most mass is ahead of the others of its effects alone.

    By the rows alone would be too much to ask: without a name the map bends as far as its prior allows.
    """
    best = found.best
    here = found.behind[found.index(best)]
    rest = [
        float(behind - here)
        for h, behind in zip(found.sets, found.behind, strict=True)
        if h.effects == best.effects - {name} and len(h.names) < len(best.names)
    ]
    return min(rest, default=np.inf)


def _confounded(found: Posterior, name: str, other: str) -> bool:
    """Whether most of what is left of the mass without one name has the other."""
    without = [(m, h) for m, h in zip(found.mass, found.sets, strict=True) if name not in h.names]
    total = sum(m for m, _ in without)
    return total > 0.0 and sum(m for m, h in without if other in h.names) > RIVAL * total


def _against_forms(ch: Channels, found: Posterior, name: str) -> float:
    """Nats by which a name is ahead of a free form in its place; one over its own cause does not count."""
    best = found.best
    here, nats = found.behind[found.index(best)], np.inf
    for h, behind in zip(found.sets, found.behind, strict=True):
        new = [f for f in h.forms if f not in best.forms]
        if best.effects - h.effects != {name} or h.effects - best.effects or len(h.names) > len(best.names):
            continue
        if not any(_own_cause(ch, best, name, f) for f in new):
            nats = min(nats, max(float(behind - here), _beside(found, h, name)))
    return nats


def _own_cause(ch: Channels, h: Hypothesis, name: str, form: str) -> bool:
    """Whether a free form runs over the variable that an effect comes from."""
    variable, channel, *_ = form.split("|")
    m = next(m for m in h.members if m.name == name)
    label, cause = m.effect.cause(ch.bare, m.shape, channel)
    values = np.asarray(cause, float)[ch.frame.keep]
    if " " in variable:  # the sum or difference of speeds holds either
        return any(
            _same_time_profile(values, ch.variables[v])
            for v in (variable.split(" ")[0], variable.split(" ")[2])
        )
    other = ch.variables.get(variable)
    return other is not None and (label == variable or _same_time_profile(values, other))


def _same_time_profile(values: Array, other: Array) -> bool:
    """Whether two variables are one."""
    if np.ptp(values) <= 0.0 or np.ptp(other) <= 0.0:
        return False
    return bool(abs(np.corrcoef(values, other)[0, 1]) > SAME_TIME_PROFILE)


def _not_carried(ch: Channels, h: Hypothesis, name: str) -> str | None:
    """The free form over an effect's own cause that holds more of a channel than half of the effect does.

    Of causes that every log has; what goes with a spacing or a supply has its name from that column.
    """
    own = {
        f: added
        for f, added in forms_of(ch, h).items()
        if f.split("|")[0] in EVERYWHERE and _own_cause(ch, h, name, f)
    }
    if not own:
        return None
    size = np.std(added_by(ch, h, name), axis=0)
    for form, added in own.items():
        c = ch.names.index(form.split("|")[1])
        if size[c] > 0.0 and float(np.std(added)) > CARRIED * size[c]:
            return f"a free form over {form.split('|')[0]}"
    return None


def forms_of(ch: Channels, h: Hypothesis) -> dict[str, Array]:
    """(rows,) that every free form of a set adds to its channel, about its mean."""
    out: dict[str, Array] = {}
    blocks = {f: ch.forms[f]() for f in h.forms}
    at = h.fit.deviation.shape[0] - sum(b.width for b in blocks.values())
    for form, block in blocks.items():
        added = block.columns[:, ch.names.index(form.split("|")[1])] @ h.fit.values[at : at + block.width]
        at += block.width
        out[form] = np.asarray(added - np.mean(added))
    return out


def added_by(ch: Channels, h: Hypothesis, name: str) -> Array:
    """(rows, C) what one effect adds beside the others of its set."""
    with_it, without = (
        composed(ch.bare, [*known, *((m.effect, m.parameters(ch.bare)) for m in members)]).predicted
        for members in (h.members, [m for m in h.members if m.name != name])
        for known in [[k for k in ch.known if k[0].name not in {m.name for m in members}]]
    )
    return np.asarray(ch.reduce(with_it - without))
