"""The paper's ledger for the terminal and as a page. Numbers come from the entries."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from coaxlink.studies.paper import Entry, Ledger

HEAD = """# The paper against its own numbers

Berra, Trujillo Soto and Heredia, *Aerodynamic Interaction Minimization in Coaxial Multirotors via Optimized
Control Allocation*, Drones 2024, 8(9), 446. Made by

    coaxlink reproduce --markdown docs/paper.md

"printed" is what the paper prints, "computed" what coaxlink makes of it; nothing computed is copied from
print. Contradiction 11 needs a real stand log (`--pair LOG`).
"""


def tables(ledger: Ledger) -> Iterator[Any]:
    """Rich tables: the verdicts, then every entry's numbers."""
    from rich.table import Table

    verdicts = Table(
        "entry", "what", "verdict", title="The paper against its own numbers", title_justify="left"
    )
    for entry in ledger.entries:
        verdicts.add_row(entry.id, entry.title, entry.verdict)
    yield verdicts
    for entry in ledger.entries:
        if not entry.lines:
            continue
        rows = Table(
            title=f"{entry.id}: {entry.title}",
            title_justify="left",
            caption=entry.why,
            caption_justify="left",
        )
        rows.add_column("what")
        for heading in ("printed", "computed"):
            rows.add_column(heading, justify="right")
        rows.add_column("unit")
        for cells in line_rows(entry):
            rows.add_row(*cells)
        yield rows


def markdown(ledger: Ledger) -> str:
    """The ledger as docs/paper.md."""
    parts = [HEAD, "| entry | what | verdict |", "|---|---|---|"]
    parts += [f"| [{e.id}](#{e.id}) | {e.title} | {e.verdict} |" for e in ledger.entries]
    for entry in ledger.entries:
        parts += ["", *_section(entry)]
    return "\n".join(parts) + "\n"


def _section(entry: Entry) -> Iterator[str]:
    yield f"## {entry.id}"
    yield f"\n**{entry.title}: {entry.verdict}.** {entry.why[:1].upper()}{entry.why[1:]}."
    if entry.lines:
        yield "\n| | printed | computed | |\n|---|---:|---:|---|"
        for line in entry.lines:
            yield f"| {line.what} | {_number(line.printed)} | {_number(line.computed)} | {line.unit} |"


def line_rows(entry: Entry) -> Iterator[tuple[str, str, str, str]]:
    """A row a number: what it is, printed, computed, unit."""
    for line in entry.lines:
        yield line.what, _number(line.printed), _number(line.computed), line.unit


def _number(value: float | None) -> str:
    if value is None:
        return ""
    return "0" if abs(value) < 5e-10 else f"{value:.4g}"
