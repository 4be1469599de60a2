"""A campaign's summary as text for a screen and as one self-contained page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from coaxlink.report.html import PagePicture, PageTable, render
from coaxlink.report.made import Made
from coaxlink.report.pictures.campaign_plots import words
from coaxlink.studies.campaign.summary import FIGURES, Paired, Spread, Summary

NOTED = ("height_rms_m", "thrust_error_N", "yaw_error_Nm", "energy_Wh")  # said in sentences, others in tables

PLAIN = {
    "height_rms_m": "height error",
    "thrust_error_N": "thrust error",
    "yaw_error_Nm": "yaw moment error",
    "energy_Wh": "use of energy",
}


def number(x: float) -> str:
    """Three significant digits; 0 for what is nothing in any of the units here."""
    return "-" if not math.isfinite(x) else f"{x:.3g}" if abs(x) >= NOTHING else "0"


def sentences(s: Summary) -> Iterator[str]:
    """What was flown and what stands out."""
    flights = sum(c.flown for c in s.counts.values())
    yield f"{s.name}: {flights} flights, {' / '.join(s.laws)} on equal seeds"
    yield from ends(s)
    for law, found in s.paired.items():
        for name in NOTED:
            yield f"{law} against {s.laws[0]}, {words(name)}: {_against(found[name])}"


def ends(s: Summary) -> Iterator[str]:
    """Flights that did not end as planned, and those that were not flown."""
    for law, c in s.counts.items():
        for why, count in c.failsafe.items():
            yield f"{law}: {count} of {c.flown} flights ended in the {why} failsafe"
        for why, count in c.problem.items():
            yield f"{law}: {count} not flown: {why}"


def lead(s: Summary) -> str:
    """The answer in one sentence: what each law changes against the first, beyond its interval."""
    flights = sum(c.flown for c in s.counts.values())
    said = []
    for law, found in s.paired.items():
        clear = [f for f in NOTED if found[f].ci[0] > 0.0 or found[f].ci[1] < 0.0]
        changes = [f"{_change(found[f].share)} {PLAIN[f]}" for f in clear]
        last = " and ".join([", ".join(changes[:-1]), changes[-1]]) if len(changes) > 1 else "".join(changes)
        said.append(f"{law} makes {last or 'no clear difference'}")
    against = f". Against {s.laws[0]} in the same draws: {'; '.join(said)}" if said else ""
    return f"{flights} simulated flights{against}."


def _change(share: float) -> str:
    return f"{100 * abs(share):.2g} % {'more' if share > 0.0 else 'less'}"


def _against(p: Paired) -> str:
    ends = " .. ".join(number(x) for x in p.ci)
    better = f"smaller in {100 * p.better:.0f} % of draws"
    return f"{p.difference:+.3g} ({100 * p.share:+.1f} %), 95 % {ends}, {better}"


def spread_rows(s: Summary) -> list[tuple[str, ...]]:
    """A row a figure: mean and interval of each law."""
    return [(words(name), *(_spread(s.figures[law][name]) for law in s.laws)) for name in FIGURES]


def _spread(x: Spread) -> str:
    return f"{number(x.mean)} ({number(x.ci[0])} .. {number(x.ci[1])})"


def worst_rows(s: Summary) -> list[tuple[str, ...]]:
    """The worst flights and how to fly them again."""
    return [(w.law, str(w.cell), number(w.value), w.failsafe or "-", w.replay) for w in s.worst]


WORST_HEADS = ("law", "cell", "value", "failsafe", "replay")
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
         f"{100 * p.share:+.1f} %", f"{100 * p.better:.0f} %", f"{p.p_value:.1g}")
        for law, found in s.paired.items()
        for name, p in found.items()
    ]  # fmt: skip
    pair_heads = ("law", "figure", f"less {s.laws[0]}", "95 %", "of its mean", "smaller in", "p")
    versions = ", ".join(f"{k} {v}" for k, v in dict(s.manifest.get("versions", {})).items())
    return render(
        "campaign.html",
        title=f"Campaign {s.name}",
        lead=lead(s),
        made=made or Made.now(),
        spreads=PagePicture(plots.spreads(s, columns), "spread of the main figures, law by law"),
        remarks=list(ends(s)),
        figures=PageTable(("figure", *s.laws), spread_rows(s)),
        reference=s.laws[0],
        differences=PagePicture(plots.differences(s), "differences on equal seeds with intervals"),
        pairs=PageTable(pair_heads, pairs),
        judge=words(s.judge),
        worst=PageTable(WORST_HEADS, worst_rows(s), wide=(4,)),
        quantiles=PageTable(("law", "figure", "5 %", "median", "95 %"), quantiles),
        flown_with=f"flown with {versions}; campaign {str(s.manifest.get('digest', ''))[:16]}",
    )
