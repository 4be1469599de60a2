"""A fleet over time: as text for a screen, as one self-contained page, as a picture."""

from __future__ import annotations

import datetime
import itertools
from collections.abc import Iterator

import numpy as np

from coaxlink.report.campaign import number
from coaxlink.report.html import PagePicture, PageTable, render
from coaxlink.report.pictures.figures import drawn, new_figure, plain_axis
from coaxlink.report.pictures.looks import LOOKS
from coaxlink.studies.fleet import Fleet, Trend

HEADS = ("vehicle", "found", "where", "logs", "first", "last", "size then", "size now", "a week, 95 %", "p")
MOST_DRAWN = 60  # vehicles in the picture; those with findings first


def sentences(fleet: Fleet) -> Iterator[str]:
    """What was looked at and what is believed."""
    yield f"{fleet.logs} logs of {len(fleet.vehicles)} vehicles"
    for trend in fleet.believed:
        yield trend.words()
    if not fleet.believed:
        yield "nothing that false alarms would not bring"
    doubtful = [c for c in fleet.trends if not c.believed]
    if doubtful:
        few = ", ".join(f"{c.vehicle} {c.name} {c.part}".strip() for c in doubtful[:5])
        yield f"found in too few logs to be believed: {few}" + (" ..." if len(doubtful) > 5 else "")


def rows(trends: tuple[Trend, ...]) -> list[tuple[str, ...]]:
    """A row a kind of finding and vehicle."""
    return [
        (
            c.vehicle, c.name, c.part or "-", f"{len(c.dates)} of {c.logs}", c.dates[0][:10],
            c.dates[-1][:10], f"{c.values[0]:.3g}", f"{c.values[-1]:.3g} {c.unit}".removesuffix(" 1"),
            " .. ".join(number(x) for x in c.per_week_ci), f"{c.p_value:.1g}",
        )
        for c in trends
    ]  # fmt: skip


def picture(fleet: Fleet) -> bytes:
    """PNG: which vehicle had how many findings when, and the believed ones' sizes over time."""
    ailing = list(dict.fromkeys(c.vehicle for c in fleet.believed))
    shown = [*ailing, *(v for v in fleet.vehicles if v not in ailing)][:MOST_DRAWN]
    figure = new_figure(4.5 + 0.24 * len(shown))
    over, under = figure.subplots(2, 1, sharex=True, height_ratios=(1.2, 0.4 + 0.08 * len(shown)))
    for c, look in zip(fleet.believed, itertools.cycle(LOOKS), strict=False):
        when = [datetime.datetime.fromisoformat(d) for d in c.dates]
        size = 100.0 * np.array(c.values) if c.unit == "1" else np.array(c.values)
        label = f"{c.vehicle}: {c.name} {c.part}".strip() + (", %" if c.unit == "1" else f", {c.unit}")
        over.plot(when, size, **look.points, ms=3, lw=1, label=label)
    over.set_title("findings that false alarms do not explain")
    if fleet.believed:
        over.legend()
    for row, vehicle in enumerate(shown):
        mine = [(date, len(found)) for v, date, found in fleet.rows if v == vehicle]
        when = [datetime.datetime.fromisoformat(d) for d, _ in mine]
        for found, colour, marker in ((False, "#b8c4d0", "o"), (True, "#c0392b", "X")):
            at = [day for day, (_, n) in zip(when, mine, strict=True) if bool(n) == found]
            under.scatter(at, [row] * len(at), c=colour, marker=marker, s=26 if found else 14)
    under.set_yticks(range(len(shown)), shown)
    under.invert_yaxis()
    under.set_title("logs; cross: something found")
    for axes in (over, under):
        plain_axis(axes)
    figure.autofmt_xdate()
    return drawn(figure)


def page(fleet: Fleet) -> str:
    """The whole report as HTML."""
    first, *lines = sentences(fleet)
    return render(
        "fleet.html",
        title="A fleet over time",
        made=None,
        verdict=first,
        lines=lines,
        picture=PagePicture(picture(fleet), "findings of every vehicle over time"),
        findings=PageTable(HEADS, rows(fleet.trends)),
        problems=PageTable(("log", "why"), list(fleet.problems.items()), wide=(1,)),
    )
