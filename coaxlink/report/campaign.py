"""A campaign's summary as text for a screen and as one self-contained page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from coaxlink.report.html import PagePicture, PageTable, render
from coaxlink.report.made import Made
from coaxlink.report.pictures.campaign_plots import WORDS, words
from coaxlink.studies.campaign.summary import FIGURES, Paired, Spread, Summary


def number(x: float) -> str:
    """Three significant digits; 0 for what is nothing in any of the units here."""
    return "-" if not math.isfinite(x) else f"{x:.3g}" if abs(x) >= NOTHING else "0"


def sentences(s: Summary) -> Iterator[str]:
    """The answer, then what did not end as planned."""
    yield from answer(s)
    yield from ends(s)


def ends(s: Summary) -> Iterator[str]:
    """Flights that did not end as planned, and those that were not flown."""
    for law, c in s.counts.items():
        for why, count in c.failsafe.items():
            yield f"{law}: {count} of {c.flown} flights ended in the {why} failsafe"
        for why, count in c.problem.items():
            yield f"{law}: {count} not flown: {why}"


def answer(s: Summary) -> Iterator[str]:
    """What was flown; then every figure that a law makes worse or better, beyond its interval."""
    flights = sum(c.flown for c in s.counts.values())
    *others, last = s.laws
    against = f", each draw by {', '.join(others)} and {last}" if others else f" by {last}"
    yield f"{s.name}: {flights} simulated flights{against}."
    for law, found in s.paired.items():
        better = [_change(f, p) for f, p in found.items() if p.ci[1] < 0.0]
        worse = [_change(f, p) for f, p in found.items() if p.ci[0] > 0.0]
        yield (
            f"{law} against {s.laws[0]}: {len(better)} of {len(found)} figures better, {len(worse)} worse. "
            f"Worse: {', '.join(worse) or 'none'}. Better: {', '.join(better) or 'none'}."
        )


def _change(figure: str, p: Paired) -> str:
    name = WORDS[figure].removesuffix(", rms").replace(",", "")
    return f"{name} {100 * p.share:+.2g} %" if math.isfinite(p.share) else name


def spread_rows(s: Summary) -> list[tuple[str, ...]]:
    """A row a figure: mean and interval of each law."""
    return [(words(name), *(_spread(s.figures[law][name]) for law in s.laws)) for name in FIGURES]


def _spread(x: Spread) -> str:
    return f"{number(x.mean)} ({number(x.ci[0])} .. {number(x.ci[1])})"


def worst_rows(s: Summary) -> list[tuple[str, ...]]:
    """The worst flights and how to fly them again."""
    return [(w.law, str(w.cell), number(w.value), w.failsafe or "-", w.replay) for w in s.worst]


def spread_heads(s: Summary) -> tuple[str, ...]:
    """Of `spread_rows`."""
    return "mean (95 % interval)", *s.laws


def worst_heads(s: Summary) -> tuple[str, ...]:
    """Of `worst_rows`."""
    return "law", "cell", words(s.judge), "failsafe", "to fly it again"


NOTHING = 1e-6  # m, N, N m, deg, Wh, shares


def page(s: Summary, columns: Mapping[str, Any], made: Made | None = None) -> str:
    """The whole report as HTML."""
    from coaxlink.report.pictures import campaign_plots as plots

    quantiles = [
        (law, words(name), *(number(v) for v in (x.p5, x.median, x.p95)))
        for name in FIGURES
        for law, x in ((law, s.figures[law][name]) for law in s.laws)
    ]
    pairs = [
        (law, words(name), f"{p.difference:+.3g}", " .. ".join(map(number, p.ci)),
         f"{100 * p.share:+.1f}", f"{100 * p.better:.0f}", f"{p.p_value:.1g}")
        for law, found in s.paired.items()
        for name, p in found.items()
    ]  # fmt: skip
    pair_heads = ("law", "figure, unit", f"less {s.laws[0]}'s", "95 % interval", f"in % of {s.laws[0]}'s",
                  "smaller in % of draws", "p (Wilcoxon)")  # fmt: skip
    first, *more = answer(s)
    versions = ", ".join(f"{k} {v}" for k, v in dict(s.manifest.get("versions", {})).items())
    return render(
        "campaign.html",
        title=f"Campaign {s.name}",
        lead=" ".join([first, *more[:1]]),
        made=made or Made.now(),
        spreads=PagePicture(plots.spreads(s, columns), "spread of the main figures, law by law"),
        remarks=[*more[1:], *ends(s)],
        figures=PageTable(spread_heads(s), spread_rows(s)),
        reference=s.laws[0],
        differences=PagePicture(plots.differences(s), "differences on equal seeds with intervals"),
        pairs=PageTable(pair_heads, pairs),
        judge=words(s.judge),
        worst=PageTable(worst_heads(s), worst_rows(s), wide=(4,)),
        quantiles=PageTable(("law", "figure, unit", "5 % quantile", "median", "95 % quantile"), quantiles),
        flown_with=f"flown with {versions}; campaign {str(s.manifest.get('digest', ''))[:16]}",
    )
