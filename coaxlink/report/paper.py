"""The paper's ledger for the terminal, and as Markdown. Numbers come from the claims."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from coaxlink.report.terminal import table
from coaxlink.studies.paper import Claim, Ledger

VERDICT_HEADS = ("entry", "what", "verdict")
LINE_HEADS = ("what", "printed", "computed", "unit")
HEAD = """# The paper against its own numbers

Berra, Trujillo Soto and Heredia, *Aerodynamic Interaction Minimization in Coaxial Multirotors via Optimized
Control Allocation*, Drones 2024, 8(9), 446. Made by

    coaxlink reproduce --markdown LEDGER.md

"printed" is what the paper prints, "computed" what coaxlink makes of it; nothing computed is copied from
print. Contradiction 11 needs a real stand log (`--pair LOG`).
"""


def tables(ledger: Ledger) -> Iterator[Any]:
    """Rich tables: the verdicts, then every claim's numbers."""
    verdicts = [(claim.id, claim.title, claim.verdict) for claim in ledger.claims]
    yield table("The paper against its own numbers", VERDICT_HEADS, verdicts, left=3, boxed=True)
    for claim in ledger.claims:
        if claim.lines:
            title = f"{claim.id}: {claim.title}"
            yield table(title, LINE_HEADS, line_rows(claim), boxed=True, caption=claim.why)


def markdown(ledger: Ledger) -> str:
    """The ledger as a page."""
    parts = [HEAD, "| entry | what | verdict |", "|---|---|---|"]
    parts += [f"| [{e.id}](#{e.id}) | {e.title} | {e.verdict} |" for e in ledger.claims]
    for claim in ledger.claims:
        parts += ["", *_section(claim)]
    return "\n".join(parts) + "\n"


def _section(claim: Claim) -> Iterator[str]:
    yield f"## {claim.id}"
    yield f"\n**{claim.title}: {claim.verdict}.** {claim.why[:1].upper()}{claim.why[1:]}."
    if claim.lines:
        yield "\n| | printed | computed | |\n|---|---:|---:|---|"
        for line in claim.lines:
            yield f"| {line.what} | {_number(line.printed)} | {_number(line.computed)} | {line.unit} |"


def line_rows(claim: Claim) -> Iterator[tuple[str, str, str, str]]:
    """A row a number: what it is, printed, computed, unit."""
    for line in claim.lines:
        yield line.what, _number(line.printed), _number(line.computed), line.unit


def _number(value: float | None) -> str:
    if value is None:
        return ""
    return "0" if abs(value) < 5e-10 else f"{value:.4g}"
