"""Flights as one self-contained page: charts over time that zoom, two logs beside one another, no network."""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib.resources import files

import markupsafe

from coaxlink.report.flight_charts import FlightCharts, as_json
from coaxlink.report.html import PageTable, render
from coaxlink.report.made import Made
from coaxlink.report.pictures.looks import LOOKS


def flight_page(flights: Sequence[FlightCharts], made: Made) -> str:
    """The page of one log or two."""
    document = json.dumps(as_json(flights), allow_nan=False).replace("<", "\\u003c")
    script = (files("coaxlink.report") / "templates" / "flight.js").read_text()
    names = [f.source for f in flights]
    events = [(f.source, f"{t:.1f}", text) for f in flights for t, text in f.events]
    rests = [(f.source, text) for f in flights for text in f.premises]
    return render(
        "flight.html",
        title=" and ".join(names),
        answers=[f"{f.source}, {f.seconds:.0f} s. {f.answer}" for f in flights],
        columns=len(flights),
        events=PageTable(("log", "time, s", "event"), events, (2,)),
        rests=PageTable(("log", "what this page rests on"), rests, (1,)),
        data=markupsafe.Markup(document),
        script=markupsafe.Markup(script),
        colours=markupsafe.Markup(json.dumps([look.colour for look in LOOKS])),
        made=made,
    )
