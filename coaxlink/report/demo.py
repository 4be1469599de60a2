"""The demo's result as terminal tables, and as one page with its picture."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coaxlink import files

if TYPE_CHECKING:
    from coaxlink.residual.delivered import Delivered
    from coaxlink.residual.result import Refinement
    from coaxlink.rotor.identification import Identification


@dataclass(frozen=True)
class FlightErrors:
    """One flight against what was meant: the rows of the paper's Table 4, and who carried the weight."""

    delivered: Delivered
    position_error_m: tuple[
        float, float, float
    ]  # mean |wanted - flown| north, east, down in hover and circle

    def to_json(self) -> dict[str, Any]:
        """As `demo --json` writes it."""
        d = self.delivered
        return {
            "thrust_error_N": d.thrust_error_N,
            "torque_error_Nm": list(d.torque_error_Nm),
            "position_error_m": list(self.position_error_m),
            "height_error_m": self.position_error_m[2],
            "split": [
                {"upper": s.upper, "lower": s.lower, "upper_N": s.upper_N, "lower_N": s.lower_N,
                 "lower_share": s.lower_share}
                for s in d.split
            ],
            "seconds": d.seconds,
            "thrust_ci_N": list(d.intervals[0]),
            "torque_ci_Nm": [list(i) for i in d.intervals[1:]],
            "floor": {"thrust_N": d.floor[0], "torque_Nm": list(d.floor[1:])},
        }  # fmt: skip


@dataclass(frozen=True)
class DemoResult:
    """All that the demo did; the renderers only format it."""

    seed: int
    identification: Identification
    uploads: dict[str, dict[str, Any]]
    flights: dict[str, FlightErrors]
    live: dict[str, Any]  # the live mixer's own account
    refinement: Refinement

    def to_json(self) -> dict[str, Any]:
        """As `demo --json` writes it; `before` and `after` are held-out errors of the touched channels."""
        found = self.refinement.effects
        channels = self.refinement.channels
        touched = [c for c in channels if any(c in e.channels for e in found)] or list(channels)
        verified = all(u["result"] == "verified" for u in self.uploads.values())
        return {
            "seed": self.seed,
            "identify": self.identification.as_json(),
            "upload": {"result": "verified" if verified else "failed", **self.uploads},
            "flights": {name.split()[0]: errors.to_json() for name, errors in self.flights.items()},
            "live": self.live,
            "hidden_effect_found": ", ".join(e.name for e in found) or None,
            "before": {c: channels[c].rmse_before for c in touched},
            "after": {c: channels[c].rmse_after for c in touched},
            "refine": self.refinement.to_json(),
        }


def flight_rows(flights: Mapping[str, FlightErrors]) -> list[list[str]]:
    """A row a flight: the paper's Table 4 columns."""
    rows = []
    for name, flight in flights.items():
        d, p = flight.delivered, flight.position_error_m
        rows.append(
            [
                name,
                f"{d.thrust_error_N:.2f}",
                *(f"{t:.3f}" for t in d.torque_error_Nm),
                *(f"{x:.3f}" for x in p),
            ]
        )
    return rows


FLIGHT_HEADINGS = (
    "flight", "thrust N", "roll N m", "pitch N m", "yaw N m", "north m", "east m", "height m",
)  # fmt: skip


def split_rows(flights: Mapping[str, FlightErrors]) -> list[list[str]]:
    """A row an arm and flight: upper and lower thrust, and the lower rotor's share."""
    rows = []
    for name, flight in flights.items():
        for split in flight.delivered.split:
            arm = f"{split.upper} over {split.lower}"
            share = f"{100 * split.lower_share:.1f} %"
            rows.append([name, arm, f"{split.upper_N:.1f}", f"{split.lower_N:.1f}", share])
    return rows


SPLIT_HEADINGS = ("flight", "arm", "upper N", "lower N", "lower share")


def tables(result: DemoResult) -> Iterator[Any]:
    """Rich tables of the flights, the split per arm, and the residual before and after."""
    from coaxlink.report.refine import tables as refine_tables
    from coaxlink.report.refine import verdict

    yield _table(
        "Flights: mean |meant - delivered|, mean |wanted - flown|",
        FLIGHT_HEADINGS,
        flight_rows(result.flights),
    )
    yield _table("Thrust split per arm", SPLIT_HEADINGS, split_rows(result.flights))
    yield f"what the world hides, from the logs of all flights: {verdict(result.refinement)}"
    yield from refine_tables(result.refinement)


def _table(title: str, headings: tuple[str, ...], rows: list[list[str]]) -> Any:
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None, header_style="bold")
    for n, heading in enumerate(headings):
        table.add_column(heading, justify="left" if n == 0 else "right")
    for row in rows:
        table.add_row(*row)
    return table


def write_report(out: Path, result: DemoResult) -> Path:
    """Write OUT/report.html (self-contained) and OUT/residual.png; returns the page's path."""
    from coaxlink.report.page import html_table, page
    from coaxlink.report.residual_plots import save_overview

    rotor = [
        (load, term, f"{value:.4g}")
        for load, terms in result.identification.model.terms().items()
        for term, value in terms.items()
    ]
    sections = (
        ("Flights: mean |meant - delivered| and mean |wanted - flown|",
         html_table(FLIGHT_HEADINGS, flight_rows(result.flights))),
        ("Thrust split per arm", html_table(SPLIT_HEADINGS, split_rows(result.flights))),
        ("The rotor model that was flown, from the stand", html_table(("load", "term", "value"), rotor)),
    )  # fmt: skip
    save_overview(result.refinement, out / "residual.png")
    path = out / "report.html"
    files.write_atomic(path, page(result.refinement, f"coaxlink demo, seed {result.seed}", sections))
    return path
