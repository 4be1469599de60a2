"""What the decision is made from: of every candidate, how far the log bears it out, in numbers.

A candidate is a name of the leading set, or a group of names that could each be in one place. Nats are
differences of log evidence between sets of explanations: against nothing in the candidate's place, against
free forms in it, against any other name. Each is taken as it is, tempered (`posterior`), and with the noise
of either set having a colour of its own, so that what moves slowly has to be more than a cell's wander.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.stats import chi2

from coaxlink.evidence.blocks import FORM_LENGTHS, in_channel, waves
from coaxlink.frames import Array
from coaxlink.residual.diagnosis.channels import EFFECT_SIZE, LOADS, Channels
from coaxlink.residual.diagnosis.hypotheses import Hypothesis, Scorer, coloured
from coaxlink.residual.diagnosis.posterior import RIVAL, Posterior
from coaxlink.residual.members import composed
from coaxlink.signals import without_row_noise

WEIGHED = 2  # sets of a kind that are weighed with a colour of their own: seconds
METER = 0.01  # of its range: what a recorded variable errs by (instruments of class 1, IEC 60051)
MOST_EVIDENCE = 3000.0  # where no set of a kind was worth a visit


@dataclass(frozen=True)
class Candidate:
    """A name of the leading set or a group of one, and the numbers that it is judged by."""

    names: tuple[str, ...]
    numbers: dict[str, float]


class Features:
    """Of one log's posterior."""

    def __init__(self, ch: Channels, found: Posterior) -> None:
        self.ch, self.found, self.lead = ch, found, found.best
        self._own: dict[int, float] = {}

    def candidate(self, name: str, group: Collection[str] = ()) -> Candidate:
        """A name of the leading set, alone or with others that could be in its place."""
        lead, ch = self.lead, self.ch
        names = {name, *group}
        others = lead.effects - {name}
        mine = {f for f in ch.forms if own_cause(ch, lead, name, f)}
        without = [h for h in self.found.sets if not h.effects & names]
        nothing = [h for h in without if h.effects <= others and h.names <= lead.names]
        free = [h for h in without if h.effects <= others]
        numbers: dict[str, float] = {}
        for kind, sets in (
            ("nothing", nothing),
            ("free", [h for h in free if not (set(h.forms) - set(lead.forms)) & mine]),
            ("cause", [h for h in free if (set(h.forms) - set(lead.forms)) & mine]),
            ("rival", [h for h in without if not h.effects <= others]),
        ):
            numbers |= self._log_evidence(kind, sets)
        rms = np.std(self.added[name], axis=0)
        c = int(np.argmax(rms / ch.reference))
        beside = max((float(np.std(self.added[o][:, c])) for o in others), default=0.0)
        numbers["beside"] = float(np.log1p(beside / max(rms[c], 1e-9)))
        numbers["load"] = float(np.log(max(rms[c] / ch.reference[c], 1e-6) / EFFECT_SIZE))
        numbers["freed"] = self._freed(name) if others else MOST_EVIDENCE
        # what else it took to explain the log: a log that is not understood tells less
        numbers["members"] = float(len(lead.members))
        numbers["forms"] = float(sum(f not in mine for f in lead.forms))
        return Candidate((name, *(n for n in group if n != name)), numbers)

    def rivals(self, name: str) -> list[str]:
        """Other names that could be in a name's place, the strongest first.

        What the rows themselves say counts, no width of a prior: a name is no rival where the numbers of both
        would let it fall so far behind in one of a hundred logs (chi-square).
        """
        others = self.lead.effects - {name}
        own = next(len(m.point) for m in self.lead.members if m.name == name)
        here = self.found.misfit[self.found.index(self.lead)]
        out: dict[str, float] = {}
        for h, misfit in zip(self.found.sets, self.found.misfit, strict=True):
            new = h.effects - self.lead.effects
            if self.lead.effects - h.effects == {name} and len(new) == 1:
                other = next(m for m in h.members if m.name in new)
                if misfit - here < 0.5 * chi2.ppf(1.0 - RIVAL, own + len(other.point)):
                    out[other.name] = min(float(self.tempered(h)), out.get(other.name, np.inf))
        return sorted(set(out) - others, key=lambda n: out[n])

    def opened(self, claimed: Collection[str]) -> dict[str, float]:
        """What is there beyond the claimed names: the best of all sets over the best of these names alone."""
        plain = [h for h in self.found.sets if h.effects <= set(claimed) and not h.forms]
        best = max(self.found.sets, key=lambda h: h.score)
        base = max(plain, key=lambda h: h.score, default=self.found.sets[-1])
        return {
            "raw": float(best.score - base.score),
            "own": float(self.own(best) - self.own(base)),
            "tempered": float(max(self.tempered(base) - self.tempered(best), 0.0)),
        }

    def tempered(self, h: Hypothesis) -> float:
        """Nats behind the leading set, tempered, odds and all."""
        return self.found.evidence_behind(h) - self.found.evidence_behind(self.lead)

    def own(self, h: Hypothesis) -> float:
        """Score of a set whose noise has the colour of what it leaves."""
        if id(h) not in self._own:
            self._own[id(h)] = coloured(self.ch, h).score
        return self._own[id(h)]

    @cached_property
    def added(self) -> dict[str, Array]:
        """(rows, C) that each name of the leading set adds."""
        return {name: added_by(self.ch, self.lead, name) for name in self.lead.effects}

    def _log_evidence(self, kind: str, sets: Sequence[Hypothesis]) -> dict[str, float]:
        """Of the leading set over the best of these; three ways."""
        if not sets:
            return {f"{kind}_{way}": MOST_EVIDENCE for way in ("raw", "tempered", "own")}
        best = sorted(sets, key=lambda h: -h.score)[:WEIGHED]
        return {
            f"{kind}_raw": float(self.lead.score - best[0].score),
            f"{kind}_tempered": min(self.tempered(h) for h in sets),
            f"{kind}_own": float(self.own(self.lead) - max(self.own(h) for h in best)),
        }

    def _freed(self, name: str) -> float:
        """Nats of a name beside free curves of every load over the causes of the other names.

        What changes with a spacing from session to session is the spacing's, whatever its form misses: a cell
        that drifts besides must show within one level of it.
        """
        ch, lead, blocks = self.ch, self.lead, []
        rest = [m for m in lead.members if m.name != name]
        for m in rest:
            for c, channel in enumerate(ch.names):
                cause = np.asarray(m.effect.cause(ch.bare, m.shape, channel)[1], float)[ch.frame.keep]
                if np.ptp(cause) > 0.0 and np.any(self.added[m.name][:, c]):
                    f, d = _curve(cause)
                    both = np.concatenate([f * ch.weights[:, [c]], f * ch.reference[c]], axis=1)
                    process = both, np.concatenate([d, d]) * EFFECT_SIZE
                    blocks.append(in_channel("freed", process, np.ones(len(f)), c, ch.count))
        free = Scorer(replace(ch, surface=(*ch.surface, *blocks)), lead.colour)
        both_of, alone = (
            free.linearised(x, lead.forms, lead.fit.noise, share=lead.share)[0] for x in (lead.members, rest)
        )
        return float(both_of.score - alone.score)


def _curve(cause: Array) -> tuple[Array, Array]:
    """(rows, K) a free function of a cause (rows,), (K,) deviations: smooth, or of every level where they are
    fewer than the functions of that.
    """
    smooth = waves(cause, min(FORM_LENGTHS))
    levels = np.unique(np.round((cause - cause.min()) / np.ptp(cause) / METER), return_inverse=True)[1]
    if levels.max() >= smooth[0].shape[1]:
        return smooth
    return np.eye(levels.max() + 1)[levels], np.ones(levels.max() + 1)


def forms_of(ch: Channels, h: Hypothesis) -> dict[tuple[str, str], Array]:
    """(rows,) that every free form of a set adds to a channel, about its mean."""
    out: dict[tuple[str, str], Array] = {}
    blocks = {f: ch.forms[f]() for f in h.forms}
    at = h.fit.deviation.shape[0] - sum(b.width for b in blocks.values())
    for form, block in blocks.items():
        added = block.columns @ h.fit.values[at : at + block.width]
        at += block.width
        for c in np.flatnonzero(block.columns.any(axis=(0, 2))):
            out[form, ch.names[c]] = np.asarray(added[:, c] - np.mean(added[:, c]))
    return out


def added_by(ch: Channels, h: Hypothesis, name: str) -> Array:
    """(rows, C) what one effect adds beside the others of its set."""
    with_it, without = (
        composed(ch.bare, [*known, *((m.effect, m.parameters(ch.bare)) for m in members)]).predicted
        for members in (h.members, [m for m in h.members if m.name != name])
        for known in [[k for k in ch.known if k[0].name not in {m.name for m in members}]]
    )
    return np.asarray(ch.reduce(with_it - without))


def own_cause(ch: Channels, h: Hypothesis, name: str, form: str) -> bool:
    """Whether a free form runs over the variable that an effect comes from."""
    variable, channel, *_ = form.split("|")
    m = next(m for m in h.members if m.name == name)
    label, cause = m.effect.cause(ch.bare, m.shape, ch.names[0] if channel == LOADS else channel)
    values = np.asarray(cause, float)[ch.frame.keep]
    if " " in variable:  # the sum or difference of speeds holds either
        return any(same_variable(values, ch.variables[v]) for v in variable.split(" ")[::2])
    other = ch.variables.get(variable)
    return other is not None and (label == variable or same_variable(values, other))


def same_variable(values: Array, other: Array) -> bool:
    """Whether one of two variables (rows,) is a straight function of the other within its meter's error: this
    log cannot tell them apart."""
    if np.ptp(values) <= 0.0 or np.ptp(other) <= 0.0:
        return False
    along = other - np.mean(other)
    about = values - np.mean(values)
    slope = float(about @ along) / float(along @ along)
    noise = np.std(values - without_row_noise(values)), slope * np.std(other - without_row_noise(other))
    return bool(np.std(about - slope * along) <= METER * np.ptp(values) + np.hypot(*noise))
