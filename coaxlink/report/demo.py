"""The demo's result: as JSON and as terminal tables. `demo_page.py` makes the page of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from coaxlink.studies.demo import DemoResult
from coaxlink.studies.flight_errors import FlightErrors


def to_json(result: DemoResult) -> dict[str, Any]:
    """As `demo --json` writes it; `before` and `after` are held-out errors of the touched channels."""
    from coaxlink.report.demo_words import flown
    from coaxlink.report.worth import to_json as worth_json

    found = result.refinement.effects
    channels = result.refinement.channels
    touched = [c for c in channels if any(c in e.channels for e in found)] or list(channels)
    verified = all(u["result"] == "verified" for u in result.uploads.values())
    return {
        "seed": result.seed,
        "identify": result.identification.as_json(),
        "flown": flown(result.flights),
        "worth": worth_json(result.worths),
        "upload": {"result": "verified" if verified else "failed", **result.uploads},
        "flights": {name.split()[0]: errors.to_json() for name, errors in result.flights.items()},
        "live": result.live,
        "hidden_flight": result.hidden.to_json(),
        "hidden_effect_found": ", ".join(e.name for e in found) or None,
        "before": {c: channels[c].rmse_before for c in touched},
        "after": {c: channels[c].rmse_after for c in touched},
        "refine": result.refinement.to_json(),
    }


FLIGHT_HEADINGS = (
    "flight", "power, W", "height, m", "thrust gain", "thrust, N", "after gain, N", "roll, N m", "pitch, N m",
    "yaw, N m",
)  # fmt: skip


def flight_rows(flights: Mapping[str, FlightErrors]) -> list[list[str]]:
    """A row a flight: power, height error, gain of thrust, allocation error without and with best gains."""
    rows = []
    for name, flight in flights.items():
        d = flight.allocation
        rows.append(
            [
                name,
                "not reported" if flight.power_W is None else f"{flight.power_W:.0f}",
                f"{flight.position_error_m[2]:.3f}",
                f"{d.gain[0]:.3f}",
                f"{d.thrust_error_N:.2f}",
                f"{d.after_gain[0]:.2f}",
                *(f"{t:.3f}" for t in d.after_gain[1:]),
            ]
        )
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


def tables(result: DemoResult) -> Iterator[Any]:
    """The mixers' flights and what a table is worth; then what was hidden, before and after it was found."""
    from coaxlink.report.demo_words import flown, story
    from coaxlink.report.refine import tables as refine_tables
    from coaxlink.report.worth import sentences

    yield "\n".join(flown(result.flights))
    yield _table(
        "Flights, nothing hidden: mean |meant - delivered|, torques after the best gains",
        FLIGHT_HEADINGS,
        flight_rows(result.flights),
    )
    yield _table(
        "Thrust split per pair: upper + lower rotor (lower share)",
        split_headings(result.flights),
        split_rows(result.flights),
    )
    yield "\n".join(("By the rotor model, beyond these flights:", *sentences(result.worths)))
    yield "\n".join(story(result))
    yield from refine_tables(result.refinement)


def _table(title: str, headings: tuple[str, ...], rows: list[list[str]]) -> Any:
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None, header_style="bold")
    for n, heading in enumerate(headings):
        table.add_column(heading, justify="left" if n == 0 else "right")
    for row in rows:
        table.add_row(*row)
    return table
