"""The decision: which names are claimed, which stay ambiguous, whether anything is there at all.

Probabilities are those of logistic models of a candidate's `features`, trained on logs of many authors whose
truth is known; a name is claimed from the level on at which, with every author left out in turn, at most one
log in a hundred of the worst author gets a name that is not there (class-conditional conformal prediction:
Vovk et al. 2005, Sadinle et al. 2019). "Nothing to mend" is a claim too, with a level of its own.
`calibration.toml` holds the coefficients; `python research/tracing.py SET... --train` writes it.
"""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from itertools import product
from typing import Any

import numpy as np

from coaxlink.effects.onset import COMES
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.features import MOST_EVIDENCE, Candidate, Features
from coaxlink.residual.diagnosis.flight_forms import Left
from coaxlink.residual.diagnosis.flight_search import Flown
from coaxlink.residual.diagnosis.hypotheses import ODDS, Hypothesis
from coaxlink.residual.diagnosis.posterior import RIVAL, Posterior
from coaxlink.residual.members import Member, composed

STANDS, FLIGHTS = "calibration.toml", "calibration_flights.toml"  # as `--train` writes them
# (special case, general case): what holds the general one has the special one in it, or is one of both
IMPLIED = (("rotor_drag", "wind"),)
SPECIAL = (*IMPLIED, ("mass_change", "battery_voltage"))
FEIGNED = "rotor_lag"  # loops that answer gusts look like it
AT_END = 1e-3  # of a number's range
IDLE = 0.01  # of what a member adds, judgement: a number that changes less does nothing
WAYS = ("raw", "tempered", "own")


@dataclass(frozen=True)
class Group:
    """Names of which one is there, and the log does not say which."""

    names: tuple[str, ...]  # that of the leading set first
    probability: float  # of any of them
    first: float  # of the first


@dataclass(frozen=True)
class Decision:
    """What may be reported of a log, with the probability of each."""

    claimed: Mapping[str, float]
    groups: tuple[Group, ...]
    withheld: Mapping[str, float]  # of names of the leading set
    opened: float  # that something is there beyond what is claimed
    is_open: bool  # whether that is reported
    weighed: tuple[Mapping[str, Any], ...] = ()  # candidates with the numbers they were judged by
    refuted: frozenset[str] = frozenset()  # withheld ones that better nothing where the fit did not look

    def doubt(self, name: str) -> str:
        """Of a withheld name, in words."""
        but = ", but no error on held-out rows is less with it" if name in self.refuted else ""
        return f"probability {self.withheld[name]:.2f}{but}"

    @property
    def grouped(self) -> frozenset[str]:
        """Names of all groups."""
        return frozenset(n for g in self.groups for n in g.names)


NOTHING = Decision({}, (), {}, 0.0, False)


def decided(ch: Channels, found: Posterior) -> Decision:
    """Of a log's posterior."""
    features, level = Features(ch, found), calibration()["level"]
    claimed: dict[str, float] = {}
    withheld: dict[str, float] = {}
    groups: list[Group] = []
    weighed: list[Mapping[str, Any]] = []

    def probable(candidate: Candidate) -> float:
        p = probability("name", terms_of(candidate))
        weighed.append({"names": list(candidate.names), "probability": p, "numbers": candidate.numbers})
        return p

    for name in sorted(found.best.effects):
        alone, rivals = probable(features.candidate(name)), features.rivals(name)
        together = probable(features.candidate(name, rivals)) if rivals else 0.0
        if alone >= level["name"]:
            claimed[name] = alone
        elif together >= level["group"]:
            groups.append(Group((name, *rivals), together, min(alone, together)))
        else:
            withheld[name] = alone
    reported = {*claimed, *(n for g in groups for n in g.names)}
    opened = 0.0
    for names in dict.fromkeys([(), tuple(sorted(reported))]):
        numbers = features.opened(names)
        opened = probability("open", opened_terms(numbers, names))
        weighed.append({"names": ["open", *names], "probability": opened, "numbers": numbers})
    return Decision(claimed, tuple(groups), withheld, opened, opened >= level["open"], tuple(weighed))


def decided_in_flight(flown: Flown) -> tuple[Decision, Hypothesis, Left]:
    """Of what was found in a flight, with the reported set and what is beside it: what the general case
    does not clearly need is the special one.

    A number at the end of what physics allows is no estimate: the name that needs it is withheld. Names of
    which one could be in another's place at a rival's odds make a group.
    """
    ch, found = flown.channels, flown.posterior
    lead = needed(found, found.best)
    claimed: dict[str, float] = {}
    withheld: dict[str, float] = {}
    groups: list[Group] = []
    bound: list[str] = []
    weighed: list[Mapping[str, Any]] = []
    level = calibration(FLIGHTS)["level"]
    for m in lead.members:
        rivals = _in_its_place(found, lead, m.name)
        numbers = flown_numbers(ch, found, lead, m, rivals)
        p = 0.0 if numbers["bound"] else probability("name", flown_terms(numbers), FLIGHTS)
        odds = np.exp(-np.array([0.0, *rivals.values()]))
        first = float(p * odds[0] / odds.sum())
        weighed.append({"names": [m.name, *rivals], "probability": p, "numbers": numbers})
        bound += [m.name] * bool(numbers["bound"])
        if p < level["name"]:
            withheld[m.name] = first
        elif rivals:
            groups.append(Group((m.name, *rivals), p, first))
        else:
            claimed[m.name] = p
    left, opened = Left(flown, lead), 0.0
    reported = {*claimed, *(n for g in groups for n in g.names)}
    for names in dict.fromkeys([(), tuple(sorted(reported))]):
        numbers = _left_open(found, left, {*names, *bound})
        opened = probability("open", flown_open_terms(numbers, names), FLIGHTS)
        weighed.append({"names": ["open", *names], "probability": opened, "numbers": numbers})
    decision = Decision(claimed, tuple(groups), withheld, opened, opened >= level["open"], tuple(weighed))
    return decision, lead, left


def needed(found: Posterior, lead: Hypothesis) -> Hypothesis:
    """The leading set without what the log does not clearly need: the special case in place of the general
    one, and no member without which the rest is as good but for a rival's odds. Each member raises what the
    others have to show, so one that explains nothing would silence them.
    """
    least = -np.log(RIVAL)
    for special, general in SPECIAL:
        named = (lead.effects - {general}) | {special}
        sets = [h for h in found.sets if h.effects == named and special not in lead.effects]
        if general in lead.effects and sets:
            nearest = min(sets, key=found.evidence_behind)
            lead = nearest if found.evidence_behind(nearest) < least else lead
    here = found.evidence_behind(lead)
    fewer = [h for h in found.sets if h.effects < lead.effects and found.evidence_behind(h) - here < least]
    return min(fewer, key=lambda h: (len(h.effects), found.evidence_behind(h)), default=lead)


def alone(kind: str, log_evidence: float) -> float:
    """Probability that a flight holds something, where so many nats of a kind are all that speak for it."""
    return probability("open", flown_open_terms({kind: log_evidence}, ()), FLIGHTS)


def best_of(found: Posterior, names: Collection[str]) -> Hypothesis:
    """The best set of no other effects than these."""
    sets = [h for h in found.sets if h.effects <= {*names}]
    return min(sets, key=found.evidence_behind, default=found.best)


def _left_open(found: Posterior, left: Left, apart: Collection[str]) -> dict[str, float]:
    """What speaks for more than these names: nats of the others, of the best free form, of the best line, and
    of corrections that are strained beside these names alone.

    Those of a lag for themselves.
    """
    here = min(found.evidence_behind(h) for h in found.sets)
    whole, less = (
        max(
            min((found.evidence_behind(h) for h in found.sets if h.effects <= some), default=MOST_EVIDENCE)
            - here,
            0.0,
        )
        for some in ({*apart}, {*apart, FEIGNED})
    )
    return {
        "name": less,
        "lag": whole - less,
        "form": max((f.log_evidence for f in left.forms), default=0.0),
        "line": max((line.log_evidence for line in left.lines), default=0.0),
        "strain": max((strain.log_evidence for strain in left.strains(best_of(found, apart))), default=0.0),
    }


def flown_numbers(
    ch: Channels, found: Posterior, lead: Hypothesis, m: Member, rivals: Collection[str] = ()
) -> dict[str, float]:
    """What a flight's name is judged by: tempered nats over the best set with nothing in its place, or of a
    group without any of its names; what else it took to explain the log; whether a number of it is at its
    bound.

    A set in which the general case is there holds the special one.
    """
    names = {m.name, *rivals, *(general for special, general in IMPLIED if special == m.name)}
    here, log_evidence = found.evidence_behind(lead), MOST_EVIDENCE
    for h in found.sets:
        if not h.effects & names and (rivals or h.effects <= lead.effects):
            log_evidence = min(log_evidence, found.evidence_behind(h) - here)
    return {
        "tempered": float(log_evidence),
        "members": float(len(lead.members)),
        "bound": float(at_bound(ch, m)),
    }


def at_bound(ch: Channels, m: Member) -> bool:
    """Whether a number of a form, but for when it came, ends where physics ends; not where a form without it
    begins, as a bend of nothing is none.
    """
    ends = [
        k
        for k, (low, high) in m.effect.free(ch.bare, m.shape).items()
        if k not in COMES and min(m.shape[k] - low, high - m.shape[k]) < AT_END * (high - low)
    ]
    return any(not _is_idle(ch, m, k) for k in ends)


def _is_idle(ch: Channels, m: Member, key: str) -> bool:
    """Whether a member adds the same without one of its numbers."""
    numbers = m.parameters(ch.bare)
    rest = {name: value for name, value in numbers.items() if name != key}
    try:
        nothing, whole, less = (
            composed(ch.bare, parts).predicted for parts in ([], [(m.effect, numbers)], [(m.effect, rest)])
        )
    except KeyError:  # no form is without it
        return False
    return bool(np.std(whole - less) < IDLE * np.std(whole - nothing))


def _in_its_place(found: Posterior, lead: Hypothesis, name: str) -> dict[str, float]:
    """Names that could be in another's place at a rival's odds, and by how many nats they are behind."""
    implied = {general for special, general in IMPLIED if special == name}
    out: dict[str, float] = {}
    for h in found.sets:
        new = h.effects - lead.effects
        if lead.effects - h.effects == {name} and len(new) == 1 and not new & implied:
            behind = max(found.evidence_behind(h) - found.evidence_behind(lead), 0.0)
            if behind < -np.log(RIVAL):
                out[next(iter(new))] = min(behind, out.get(next(iter(new)), np.inf))
    return dict(sorted(out.items(), key=lambda pair: pair[1]))


@cache
def calibration(file: str = STANDS) -> dict[str, Any]:
    """Levels, and of each model the intercept and the weights of its terms."""
    return tomllib.loads(resources.files("coaxlink.residual.diagnosis").joinpath(file).read_text())


def probability(model: str, terms: Mapping[str, float], file: str = STANDS) -> float:
    """That a candidate is there (`name`), or more than is reported (`open`), of its terms."""
    weights = calibration(file)[model]
    total = weights["intercept"] + sum(w * terms[k] for k, w in weights["weights"].items())
    return float(1.0 / (1.0 + np.exp(-np.clip(total, -30.0, 30.0))))


def terms_of(candidate: Candidate) -> dict[str, float]:
    """What the logistic model takes of a candidate: a name is as sure as its strongest rival is far.

    A rival of no size is nothing in the place, with odds of its own to pay: none of a name is further away
    than that, whether it was worth a visit or not. A group holds the rivals that were.
    """
    numbers = dict(candidate.numbers)
    for kind, way in product(("free", "cause", "rival") if len(candidate.names) == 1 else (), WAYS):
        most = numbers[f"nothing_{way}"] - float(ODDS)
        numbers[f"{kind}_{way}"] = min(numbers[f"{kind}_{way}"], most)
    out = {name: numbers[name] for name in ("beside", "forms", "load", "members")}
    for way in WAYS:
        out[f"rival_{way}"] = numbers[f"rival_{way}"]
        out[f"weakest_{way}"] = min(numbers[f"{kind}_{way}"] for kind in ("nothing", "free", "rival"))
    out["cause"] = min(numbers[f"cause_{way}"] for way in WAYS)
    out["weakest"] = min(*(out[f"weakest_{way}"] for way in WAYS), numbers["freed"])
    out = {name: _scaled(name, value) for name, value in out.items()}
    return out | {"group": float(len(candidate.names) > 1)}


def opened_terms(numbers: Mapping[str, float], reported: Collection[str]) -> dict[str, float]:
    """What the logistic model takes of what a stand log holds beyond some names: it is as sure as its weakest
    number.
    """
    return _beyond({"weakest": max(min(numbers[way] for way in WAYS), 0.0)}, reported)


def _beyond(log_evidence: Mapping[str, float], reported: Collection[str]) -> dict[str, float]:
    """A name's own law misses more than nothing does."""
    return {name: _scaled(name, value) for name, value in log_evidence.items()} | {
        "said": float(bool(reported))
    }


def flown_terms(numbers: Mapping[str, float]) -> dict[str, float]:
    """What the logistic model takes of a flight's name."""
    return {name: _scaled(name, numbers[name]) for name in ("tempered", "members")}


def flown_open_terms(numbers: Mapping[str, float], reported: Collection[str]) -> dict[str, float]:
    """What the logistic model takes of what a flight holds beyond some names: nats of a name, a form and a
    line add up. What strains the corrections is what a name would explain.
    """
    name, strain, form, line, lag = (
        numbers.get(kind, 0.0) for kind in ("name", "strain", "form", "line", "lag")
    )
    return _beyond({"tempered": max(name, strain) + form + line, "lag": lag}, reported)


def flown_evidence() -> float:
    """That a name which explains a flight alone has where it is told, at the least."""
    level, model = calibration(FLIGHTS)["level"]["name"], calibration(FLIGHTS)["name"]
    total = np.log(level / (1.0 - level)) - model["intercept"] - model["weights"]["members"]
    return float(np.expm1(total / model["weights"]["tempered"]))


PLAIN = ("beside", "forms", "load", "members")  # numbers that are no nats


def _scaled(name: str, value: float) -> float:
    """Nats and standard errors by their logarithm: the twentieth tells more than the thousandth."""
    if name in PLAIN:
        return float(np.clip(value, -10.0, 10.0))
    return float(np.sign(value) * np.log1p(min(abs(value), MOST_EVIDENCE)))
