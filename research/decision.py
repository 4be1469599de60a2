"""The decision's numbers, trained on what answers weighed, and how they do on authors they have not seen.

`python research/tracing.py SET... --train F.toml [--picture F.svg]` calls it: it writes the numbers, and
prints of every author the answers by numbers and levels that were trained on the others alone (nested, so no
level was chosen on them either), and how often what was said with a probability was so: the reliability
diagram, of names, of `nothing` and of `unexplained`. With `--picture` alone the diagram is of the numbers as
shipped, so of authors that they have not seen.

Vovk, Gammerman and Shafer, Algorithmic Learning in a Random World (2005); Sadinle, Lei and Wasserman, Least
ambiguous set-valued classifiers (2019): the levels.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from worlds.scores import Answer, Score, accepted, score, table
from worlds.sets import Log

PERSON = {"closed1": "one", "stand": "one", "flight": "one", "sim": "own"}  # who wrote a set
# terms of which more makes a name likelier; and that there is more than is said
RAISE = ("rival_", "weakest", "tempered", "cause", "load")
RAISE_OPEN = ("weakest", "tempered", "lag")
EITHER_WAY = ("group", "said")  # of the others, more lowers the probability
FEW_TERMS = 0.3  # ridge where few terms are fitted: little to share their weight with
RIDGES = {"name": 3.0, "open": FEW_TERMS}  # of a stand's weights in standard deviations of their terms
# share of an author's logs that get a false name; a group of names without any that is there; of all clean
# logs an open end; of all flights a false name; of clean ones an open end (55 hold no level to a hundredth)
SHARES = {"name": 0.01, "group": 0.03, "open": 0.01, "flight name": 0.01, "flight open": 0.03}
MODEL_OF = {"name": "name", "open": "open", "beyond": "open"}  # of an example: whose numbers judge it


@dataclass(frozen=True)
class Example:
    """A candidate of a log, its terms, and whether it is true."""

    log: Log
    model: str  # name, open, or beyond (open behind names)
    names: tuple[str, ...]
    terms: dict[str, float]
    true: bool

    @property
    def author(self) -> str:
        """Who wrote the log."""
        return author_of(self.log)

    @property
    def kind(self) -> str:
        """name, group or open."""
        return "group" if self.model == "name" and len(self.names) > 1 else self.model


def author_of(log: Log) -> str:
    """Who wrote a log."""
    first = log.author.split("/")[0]
    return PERSON.get(first, first)


def examples(log: Log, answer: Answer) -> Iterator[Example]:
    """What an answer weighed. That something is there at all is asked of the log as it came."""
    from coaxlink.residual.diagnosis.decide import flown_open_terms, flown_terms, opened_terms, terms_of
    from coaxlink.residual.diagnosis.features import Candidate

    def beyond(numbers: dict[str, float], reported: Sequence[str]) -> dict[str, float]:
        flown = log.kind == "flight"
        return flown_open_terms(numbers, reported) if flown else opened_terms(numbers, reported)

    if answer.get("cannot_judge") or answer.get("not_this_vehicle"):  # nothing of it is said
        return
    sets, hidden = accepted(log.truth), frozenset(log.truth["effects"])
    for weighed in answer.get("weighed", []):
        names, numbers = tuple(weighed["names"]), weighed["numbers"]
        if names[0] == "open":
            if log.sort not in ("fault", "real"):
                if len(names) == 1:
                    model, more = "open", log.sort != "clean"
                else:
                    model, more = "beyond", _is_more(log, frozenset(names[1:]))
                yield Example(log, model, names, beyond(numbers, names[1:]), more)
            continue
        there = hidden.union(*sets)
        true = bool(there & {*names}) if len(names) > 1 else names[0] in there and log.sort != "ambiguous"
        if log.sort == "real":
            continue
        if numbers.get("bound"):  # no name, whatever its evidence
            continue
        if log.kind == "flight":
            yield Example(log, "name", names[:1], flown_terms(numbers), true)
        else:
            yield Example(log, "name", names, terms_of(Candidate(names, numbers)), true)


def _is_more(log: Log, names: frozenset[str]) -> bool:
    """Whether a log holds more than these names say."""
    if log.sort == "ambiguous":
        return not names & frozenset(log.truth["effects"])
    sets = accepted(log.truth)
    return not any(s <= names for s in (sets[1:] if log.sort == "odd" else sets))


@dataclass(frozen=True)
class Logistic:
    """A logistic model in its terms' own units."""

    intercept: float
    weights: dict[str, float]

    def __call__(self, terms: dict[str, float]) -> float:
        total = self.intercept + sum(w * terms[k] for k, w in self.weights.items())
        return 1.0 / (1.0 + math.exp(-max(min(total, 30.0), -30.0)))


def logistic(mine: Sequence[Example], ridge: float) -> Logistic:
    """Fitted with every author weighing as the root of his logs, and signs that evidence can have."""
    import numpy as np
    from scipy.optimize import minimize

    names = sorted(mine[0].terms)
    x = np.array([[e.terms[k] for k in names] for e in mine])
    middle, spread = x.mean(axis=0), x.std(axis=0) + 1e-6
    z, y = (x - middle) / spread, np.array([e.true for e in mine], float)
    count = Counter(e.author for e in mine)
    weight = np.array([count[e.author] ** -0.5 for e in mine])
    weight *= len(weight) / weight.sum()
    raises = RAISE if mine[0].model == "name" else RAISE_OPEN

    def bounds(name: str) -> tuple[float | None, float | None]:
        if name in EITHER_WAY:
            return None, None
        return (0.0, None) if name.startswith(raises) else (None, 0.0)

    def cost(t: Any) -> tuple[float, Any]:
        total = z @ t[1:] + t[0]
        slope = weight * (1.0 / (1.0 + np.exp(-total)) - y)
        value = float(weight @ np.logaddexp(0.0, np.where(y > 0, -total, total)))
        return value + 0.5 * ridge * float(t[1:] @ t[1:]), np.r_[slope.sum(), z.T @ slope + ridge * t[1:]]

    limits = [(None, None), *map(bounds, names)]
    found = minimize(cost, np.zeros(len(names) + 1), jac=True, method="L-BFGS-B", bounds=limits).x
    weights = {k: float(w) for k, w in zip(names, found[1:] / spread, strict=True)}
    return Logistic(float(found[0] - (found[1:] / spread) @ middle), weights)


@dataclass(frozen=True)
class Decider:
    """Both models and the levels from which on something is said."""

    models: dict[str, Logistic]
    level: dict[str, float]

    def again(self, answer: Answer) -> Answer:
        """An answer as these numbers would have had it; what is open beyond names is not worked out again."""
        if "failed" in answer or not answer.get("weighed"):
            return answer
        from coaxlink.residual.diagnosis.decide import opened_terms, terms_of
        from coaxlink.residual.diagnosis.features import Candidate

        claimed: list[str] = []
        groups: dict[str, list[str]] = {}
        opened = 0.0
        for weighed in answer["weighed"]:
            names, numbers = weighed["names"], weighed["numbers"]
            if names == ["open"]:
                opened = self.models["open"](opened_terms(numbers, ()))
            elif names[0] != "open":
                p = self.models["name"](terms_of(Candidate(tuple(names), numbers)))
                if len(names) == 1 and p >= self.level["name"]:
                    claimed.append(names[0])
                elif len(names) > 1 and p >= self.level["group"]:
                    groups[names[0]] = names
        groups = {first: names for first, names in groups.items() if first not in claimed}
        reported = [*claimed, *groups]
        was_open = bool(answer["unexplained"]) if reported else opened >= self.level["open"]
        return {
            **answer,
            "effects": [{"name": n} for n in claimed],
            "ambiguous": [{"names": names} for names in groups.values()],
            "unexplained": (answer["unexplained"] or [{"channel": "any", "depends_on": []}]) * was_open,
        }


MODELS = {"name": ("name", "group"), "open": ("open",)}  # and their levels


def decider(every: Sequence[Example], trained: Sequence[str]) -> Decider:
    """Of these models trained on these examples, the others as shipped; levels by authors, each left out in
    turn.
    """
    from coaxlink.residual.diagnosis.decide import calibration

    authors = sorted({e.author for e in every})
    reported: dict[int, float] = {}
    for author, model in itertools.product(authors, trained):
        mine = [e for e in every if MODEL_OF[e.model] == model]
        fitted = logistic([e for e in mine if e.author != author], RIDGES[model])
        reported |= {id(e): fitted(e.terms) for e in mine if e.author == author}
    shipped = calibration()
    level = dict(shipped["level"])
    models = {model: Logistic(shipped[model]["intercept"], shipped[model]["weights"]) for model in MODELS}
    for model in trained:
        mine = [e for e in every if MODEL_OF[e.model] == model]
        models[model] = logistic(mine, RIDGES[model])
        for kind in MODELS[model]:
            # clean logs of one author are too few to hold a level to one in a hundred
            apart = [[e for e in mine if e.author == a] for a in authors] if kind != "open" else [mine]
            level[kind] = max(_level(some, reported, kind) for some in apart)
    return Decider(models, level)


def train(
    logs: Sequence[Log],
    answers: Sequence[Answer],
    path: Path,
    picture: Path | None = None,
    trained: Sequence[str] = tuple(MODELS),
) -> None:
    """Write the decision's numbers; print how they do on every author when he is left out."""
    import tomli_w

    from coaxlink.residual.diagnosis.decide import calibration

    every = [e for log, answer in zip(logs, answers, strict=True) for e in examples(log, answer)]
    authors = sorted({e.author for e in every})
    reported: dict[int, float] = {}
    scores: list[Score] = []
    for author in authors:
        others = decider([e for e in every if e.author != author], trained)
        reported |= {id(e): others.models[MODEL_OF[e.model]](e.terms) for e in every if e.author == author}
        for log, answer in zip(logs, answers, strict=True):
            if author_of(log) == author:
                scores.append(score(log, others.again(answer)))
    whole = decider(every, trained)
    out: dict[str, Any] = {"level": {k: round(v, 4) for k, v in whole.level.items()}}
    for model, fitted in whole.models.items():
        weights = {k: round(w, 5) for k, w in fitted.weights.items()}
        out[model] = {"intercept": round(fitted.intercept, 5), "weights": weights}
    seen = Counter(e.author for e in every if e.model == "open")
    logs_of = ", ".join(f"{a} {n}" for a, n in sorted(seen.items()))
    out["logs"] = calibration()["logs"] | dict.fromkeys(trained, logs_of)
    path.write_text("# written by: python research/tracing.py SET... --train\n" + tomli_w.dumps(out))
    print(f"levels {out['level']}\nevery author left out in turn:\n{table(scores)}")
    rows = diagram(every, reported)
    print("\n".join(map(str, rows)))
    if picture:
        draw(rows, picture)


def determined(logs: Sequence[Log], answers: Sequence[Answer], picture: Path) -> None:
    """Print and draw how often what the answers said with a probability was so."""
    from coaxlink.residual.diagnosis.decide import FLIGHTS, STANDS, probability

    rows = []
    for kind, file, where in (("stand", STANDS, ""), ("flight", FLIGHTS, " in flight")):
        pairs = zip(logs, answers, strict=True)
        every = [e for log, answer in pairs if log.kind == kind for e in examples(log, answer)]
        reported = {id(e): probability(MODEL_OF[e.model], e.terms, file) for e in every}
        rows += diagram(every, reported, where)
    print("\n".join(map(str, rows)))
    draw(rows, picture)


def train_flights(
    logs: Sequence[Log],
    answers: Sequence[Answer],
    path: Path,
    picture: Path | None = None,
    trained: Sequence[str] = tuple(MODELS),
) -> None:
    """Write the probabilities of a flight's names and of more than is said, with the levels from which on
    they are told; print how they do on every set when that is left out.
    """
    import tomli_w

    from coaxlink.residual.diagnosis.decide import FLIGHTS, calibration

    every = [e for log, answer in zip(logs, answers, strict=True) for e in examples(log, answer)]
    reported: dict[int, float] = {}
    counts = Counter(author_of(log) for log in logs)
    out = {name: dict(part) for name, part in calibration(FLIGHTS).items()}
    for model in trained:
        mine = [e for e in every if MODEL_OF[e.model] == model]
        for root in {e.log.root for e in mine}:
            fitted = logistic([e for e in mine if e.log.root != root], FEW_TERMS)
            reported |= {id(e): fitted(e.terms) for e in mine if e.log.root == root}
        whole = logistic(mine, FEW_TERMS)
        own = {id(e): whole(e.terms) for e in mine}
        some = [log for log in logs if model == "name" or log.sort == "clean"]
        out["level"][model] = round(_level(mine, own, model, len(some), SHARES[f"flight {model}"]), 4)
        weights = {k: round(w, 5) for k, w in whole.weights.items()}
        out[model] = {"intercept": round(whole.intercept, 5), "weights": weights}
        out["logs"][model] = ", ".join(f"{a} {n}" for a, n in sorted(counts.items()))
    head = "# written by: python research/tracing.py SET... --kind flight --train\n"
    path.write_text(head + tomli_w.dumps(out))
    rows = diagram([e for e in every if id(e) in reported], reported, " in flight")
    print(f"levels {out['level']}, every set left out in turn", *rows, sep="\n")
    if picture:
        draw(rows, picture)


def _level(
    mine: Sequence[Example], reported: dict[int, float], kind: str, count: int = 0, share: float = 0.0
) -> float:
    """From where on at most the kind's share of an author's logs has something said that is not so.

    Of `count` logs, where some have no candidate at all.
    """
    worst: dict[tuple[Path, str], float] = {}
    named = {(e.log.root, e.log.case) for e in mine if e.model == "beyond"}  # wrongly, and counted there
    for e in mine:
        key = (e.log.root, e.log.case)
        if kind == "open" and (e.log.sort != "clean" or key in named):
            continue
        wrong = not e.true and e.kind == kind and not (kind == "name" and e.log.sort == "ambiguous")
        worst[key] = max(worst.get(key, 0.0), reported[id(e)] if wrong else 0.0)
    ranked = sorted(worst.values(), reverse=True)
    allowed = round((share or SHARES[kind]) * max(count, len(ranked)))
    return ranked[allowed] + 1e-4 if len(ranked) > allowed else 0.0


@dataclass(frozen=True)
class Reliability:
    """Of what was said with about one probability, how much was so, with a 95 % interval (Wilson 1927)."""

    what: str
    reported: float
    so: float
    low: float
    high: float
    count: int

    def __str__(self) -> str:
        between = f"{self.low:.2f} .. {self.high:.2f}"
        return f"{self.what:21s} said {self.reported:.2f}  so {self.so:.2f} ({between})  {self.count:4d}"


EDGES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97, 1.01)
WILSON = 1.96  # standard errors


def reliability(what: str, claims: Sequence[tuple[float, bool]]) -> list[Reliability]:
    """Of claims (probability, whether it is so), by probability."""
    out = []
    for low, high in itertools.pairwise(EDGES):
        some = [c for c in claims if low <= c[0] < high]
        if not some:
            continue
        n, so = len(some), sum(true for _, true in some) / len(some)
        middle = (so + WILSON**2 / (2 * n)) / (1 + WILSON**2 / n)
        half = WILSON / (1 + WILSON**2 / n) * math.sqrt(so * (1 - so) / n + WILSON**2 / (4 * n * n))
        reported = sum(p for p, _ in some) / n
        out.append(Reliability(what, reported, so, max(middle - half, 0.0), min(middle + half, 1.0), n))
    return out


def diagram(every: Sequence[Example], reported: dict[int, float], where: str = "") -> list[Reliability]:
    """Names and groups of them; that nothing is there; that something is, beyond what is named."""
    single = [e for e in every if e.model == "name" and len(e.names) == 1]
    group = [e for e in every if e.model == "name" and len(e.names) > 1]
    opened = [e for e in every if e.model == "open"]
    last = {(e.log.root, e.log.case): e for e in every if e.model in ("open", "beyond")}
    return [
        *reliability(f"names{where}", [(reported[id(e)], e.true) for e in single]),
        *reliability(f"groups{where}", [(reported[id(e)], e.true) for e in group]),
        *reliability(f"nothing{where}", [(1.0 - reported[id(e)], not e.true) for e in opened]),
        *reliability(f"unexplained{where}", [(reported[id(e)], e.true) for e in last.values()]),
    ]


def draw(rows: Sequence[Reliability], path: Path) -> None:
    """The reliability diagram, a panel a kind: what was said against what was so."""
    from matplotlib.figure import Figure

    kinds = list(dict.fromkeys(r.what for r in rows))
    figure = Figure(figsize=(3.2 * len(kinds), 3.4), layout="constrained")
    for axes, kind in zip(figure.subplots(1, len(kinds), squeeze=False)[0], kinds, strict=True):
        mine = [r for r in rows if r.what == kind]
        axes.plot([0, 1], [0, 1], color="0.7", linestyle="--", linewidth=1)
        # where all were so the interval ends there but for rounding
        errors = [[max(r.so - r.low, 0.0) for r in mine], [max(r.high - r.so, 0.0) for r in mine]]
        axes.errorbar(
            [r.reported for r in mine], [r.so for r in mine], errors, color="0.1", marker="o", capsize=3
        )
        for r in mine:
            axes.annotate(f"{r.count}", (r.reported, r.so), (5, -11), textcoords="offset points", fontsize=8)
        axes.set(title=kind, xlabel="said", xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), aspect="equal")
    figure.axes[0].set_ylabel("so (95 %)")
    figure.savefig(path)
