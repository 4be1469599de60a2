"""The demo's result: as JSON, as terminal tables, as one page with the residual's pictures beside it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from coaxlink import files
from coaxlink.report import worth
from coaxlink.report.demo_words import TERMS, answer, flown, story
from coaxlink.report.html import PagePicture, PageTable, render
from coaxlink.report.identify import ERROR_HEADS, error_rows
from coaxlink.report.made import Made
from coaxlink.report.page import refinement_parts
from coaxlink.rotor.identification import COAXIAL
from coaxlink.studies.demo import DemoResult
from coaxlink.studies.flight_errors import FlightErrors

CAPTION = (
    "Above: the model's error in the last flight, as given, with small corrections, and with what coaxlink "
    "found. Below: what each mixer took from the battery on the same path"
)
FLIGHT_HEADINGS = (
    "flight", "power, W", "height, m", "thrust gain", "thrust, N", "after gain, N", "roll, N m", "pitch, N m",
    "yaw, N m",
)  # fmt: skip


def to_json(result: DemoResult) -> dict[str, Any]:
    """As `demo --json` writes it; `before` and `after` are held-out errors of the touched channels.

    `before` has the small corrections that any specimen may need; without them: `rmse_as_given` of `refine`.
    """
    found = result.refinement.effects
    channels = result.refinement.channels
    touched = [c for c in channels if any(c in e.channels for e in found)] or list(channels)
    verified = all(u["result"] == "verified" for u in result.uploads.values())
    return {
        "seed": result.seed,
        "identify": result.identification.as_json(),
        "flown": flown(result.flights),
        "worth": worth.to_json(result.worths),
        "upload": {"result": "verified" if verified else "failed", **result.uploads},
        "flights": {name.split()[0]: errors.to_json() for name, errors in result.flights.items()},
        "live": result.live,
        "hidden_flight": result.hidden.to_json(),
        "hidden_effect_found": ", ".join(e.name for e in found) or None,
        "before": {c: channels[c].rmse_before for c in touched},
        "after": {c: channels[c].rmse_after for c in touched},
        "refine": result.refinement.to_json(),
    }


def flight_rows(flights: Mapping[str, FlightErrors]) -> list[list[str]]:
    """A row a flight: power, height error, gain of thrust, allocation error without and with best gains."""
    rows = []
    for name, flight in flights.items():
        d = flight.allocation
        power = "not reported" if flight.power_W is None else f"{flight.power_W:.0f}"
        thrust = (f"{d.gain[0]:.3f}", f"{d.thrust_error_N:.2f}", f"{d.after_gain[0]:.2f}")
        torques = (f"{t:.3f}" for t in d.after_gain[1:])
        rows.append([name, power, f"{flight.position_error_m[2]:.3f}", *thrust, *torques])
    return rows


def split_headings(flights: Mapping[str, FlightErrors]) -> tuple[str, ...]:
    """Of `split_rows`: a pair a column."""
    first = next(iter(flights.values())).allocation.split
    return "flight", *(f"pair {s.upper}/{s.lower}, N" for s in first)


def split_rows(flights: Mapping[str, FlightErrors]) -> list[list[str]]:
    """A row a flight: each pair's upper and lower thrust, and the lower rotor's share of both."""
    return [
        [name] + [f"{s.upper_N:.1f} + {s.lower_N:.1f} ({s.lower_share:.0%})" for s in flight.allocation.split]
        for name, flight in flights.items()
    ]


def write_report(out: Path, result: DemoResult, made: Made) -> Path:
    """Write OUT/report.html (self-contained) and OUT/demo.png; returns the page's path."""
    from coaxlink.report.pictures.demo_plot import demo_figure
    from coaxlink.report.pictures.figures import drawn

    picture = drawn(demo_figure(result, made.line()))
    files.write_atomic(out / "demo.png", picture)
    path = out / "report.html"
    files.write_atomic(path, page(result, picture, made))
    return path


def page(result: DemoResult, picture: bytes, made: Made) -> str:
    """What it is worth first, then the mixers, then what was hidden, then the words."""
    lead, *more = answer(result)
    model = result.identification
    rotor_terms = [
        (load, term, f"{value:.4g}")
        for load, terms in model.model.terms().items()
        for term, value in terms.items()
    ]
    tables_heads = ("by the rotor model", *(t.name for t in result.worths.rows))
    return render(
        "demo.html",
        title=f"coaxlink demo, seed {result.seed}",
        lead=lead,
        made=made,
        picture=PagePicture(picture, CAPTION),
        answer=more,
        flown=flown(result.flights)[1:],
        flights=PageTable(FLIGHT_HEADINGS, flight_rows(result.flights)),
        split=PageTable(split_headings(result.flights), split_rows(result.flights)),
        worth=worth.sentences(result.worths),
        worths=PageTable(tables_heads, worth.rows(result.worths.rows)),
        worth_terms=worth.terms(),
        story=story(result),
        r=refinement_parts(result.refinement, made),
        rows=model.data.samples.rows,
        rotor_errors=PageTable(ERROR_HEADS, [row for row in error_rows(model) if row[0] in COAXIAL]),
        rotor_terms=PageTable(("load", "term", "value"), rotor_terms),
        words=TERMS.items(),
    )
