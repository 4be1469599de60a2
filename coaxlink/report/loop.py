"""The loop's result: two flights, what lies between them, and their errors side by side."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coaxlink import files
from coaxlink.report.refine import number

if TYPE_CHECKING:
    from coaxlink.report.demo import FlightErrors
    from coaxlink.residual.result import Refinement

HEADINGS = ("mean |meant - delivered|", "before (95 %)", "after (95 %)", "ratio", "noise")
CHANNELS = ("thrust, N", "roll, N m", "pitch, N m", "yaw, N m")


@dataclass(frozen=True)
class LoopResult:
    """All that the loop did; the renderers only format it."""

    seed: int
    way: str  # table or live: how both flights were mixed
    before: FlightErrors
    after: FlightErrors
    log_before: str
    log_after: str
    refinement: Refinement
    compensated: Mapping[str, str]  # effect -> what was done
    not_compensated: Mapping[str, str]  # effect -> why nothing was
    table_before: FlightErrors  # of the first flight, by table; `before` unless the way is live
    seconds: float  # wall time of it all

    def to_json(self) -> dict[str, Any]:
        """As `loop --json` writes it."""
        return {
            "seed": self.seed,
            "way": self.way,
            "before": self.before.to_json(),
            "effects": self.refinement.to_json()["effects"],
            "after": self.after.to_json(),
            "compensated": dict(self.compensated),
            "not_compensated": dict(self.not_compensated),
            "table_before": self.table_before.to_json(),
            "log_before": self.log_before,
            "log_after": self.log_after,
            "seconds": self.seconds,
            "refine": self.refinement.to_json(),
        }


def rows(result: LoopResult) -> list[list[str]]:
    """A row a channel, then the height that was held."""
    out = []
    before, after = result.before.delivered, result.after.delivered
    pairs = zip(
        CHANNELS,
        (before.thrust_error_N, *before.torque_error_Nm),
        before.intervals,
        (after.thrust_error_N, *after.torque_error_Nm),
        after.intervals,
        after.floor,
        strict=True,
    )
    for name, old, old_ci, new, new_ci, floor in pairs:
        was, now = f"{number(old)} ({_span(old_ci)})", f"{number(new)} ({_span(new_ci)})"
        out.append([name, was, now, f"{new / old:.2f}", number(floor)])
    high, then = (f.position_error_m[2] for f in (result.before, result.after))
    out.append(["height held, m", number(high), number(then), f"{then / high:.2f}", ""])
    return out


def _span(interval: tuple[float, float]) -> str:
    return f"{number(interval[0])}–{number(interval[1])}"


def lines(result: LoopResult) -> Iterator[str]:
    """What was done about each effect, in words."""
    if result.way == "live":
        yield "both flights mixed live: a table cannot hold all of this"
    for name, what in result.compensated.items():
        yield f"compensated: {name}: {what}"
    for name, why in result.not_compensated.items():
        yield f"not compensated: {name}: {why}"


def table(result: LoopResult) -> Any:
    """The flights' errors as a rich table, 80 columns wide at most."""
    from rich.table import Table

    title = "both flights: mean |meant - delivered| over the whole plan"
    made = Table(title=title, title_justify="left", box=None, header_style="bold", pad_edge=False)
    for n, heading in enumerate(HEADINGS):
        made.add_column("" if n == 0 else heading, justify="left" if n == 0 else "right", no_wrap=True)
    for row in rows(result):
        made.add_row(*row)
    return made


def write_report(path: Path, result: LoopResult) -> None:
    """Write the page (self-contained)."""
    from coaxlink.report.page import html_table, page

    said = "".join(f"<li>{_escaped(line)}</li>" for line in lines(result))
    sections = (("Flights before and after", html_table(HEADINGS, rows(result)) + f"<ul>{said}</ul>"),)
    files.write_atomic(path, page(result.refinement, f"coaxlink loop, seed {result.seed}", sections))


def _escaped(text: str) -> str:
    from html import escape

    return escape(text)
