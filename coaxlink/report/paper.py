"""The paper's ledger for the terminal, as Markdown and as a page. Numbers come from the claims."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

from coaxlink.report.html import PagePicture, PageTable, render
from coaxlink.report.made import Made
from coaxlink.report.pictures.figures import drawn, new_figure, plain_axis, stamped
from coaxlink.report.terminal import table
from coaxlink.studies.paper import Claim, Ledger
from coaxlink.studies.paper.ledger import CONTRADICTED, IN_PART, NOT_CHECKED, NOT_HAD, REPRODUCED

VERDICT_HEADS = ("entry", "what", "verdict")
LINE_HEADS = ("what", "printed", "computed", "unit")
SHADES = {  # told apart in grey print too
    REPRODUCED: "#1f5f8b", IN_PART: "#7fb2d5", CONTRADICTED: "#c4703f",
    NOT_HAD: "#8a8f98", NOT_CHECKED: "#d8dde5",
}  # fmt: skip
LOW, HIGH = 0.0, 2.0  # of the picture's axis
HEAD = """# The paper against its own numbers

Berra, Trujillo Soto and Heredia, *Aerodynamic Interaction Minimization in Coaxial Multirotors via Optimized
Control Allocation*, Drones 2024, 8(9), 446. Made by

    coaxlink reproduce --markdown docs/paper.md

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
    """The ledger as docs/paper.md."""
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


def paper_page(ledger: Ledger, made: Made) -> str:
    """One self-contained page: what holds, claim by claim, with printed and computed values."""
    caption = "A dot a number that is printed and computed; entries without dots have none of both"
    verdicts = [(claim.id, claim.title, claim.verdict) for claim in ledger.claims]
    return render(
        "paper.html",
        title="The paper against its own numbers",
        lead=sentence(ledger),
        made=made,
        picture=PagePicture(drawn(_figure(ledger, made.line())), caption),
        verdicts=PageTable(VERDICT_HEADS, verdicts, wide=(1,)),
        claims=[(claim, PageTable(LINE_HEADS, list(line_rows(claim)))) for claim in ledger.claims],
    )


def sentence(ledger: Ledger) -> str:
    """How many entries hold, and how many do not."""
    counts = Counter(e.verdict for e in ledger.claims)
    said = ", ".join(f"{counts[v]} {v}" for v in SHADES if counts[v])
    return f"Of {len(ledger.claims)} tables, figures, equations and statements of the paper: {said}."


def _figure(ledger: Ledger, stamp: str) -> object:
    """Computed over printed of every number that has both, an entry a row: 1 where they agree."""
    figure = new_figure(8.0, 0.8 + 0.28 * len(ledger.claims))
    axis = figure.subplots()
    for i, claim in enumerate(ledger.claims):
        pairs = [(line.printed, line.computed) for line in claim.lines]
        ratios = [c / p for p, c in pairs if p and c is not None]
        inside = [min(max(r, LOW), HIGH) for r in ratios]
        axis.plot(inside, [i] * len(inside), "o", ms=4, alpha=0.6, color=SHADES.get(claim.verdict, "#222222"))
    axis.axvline(1.0, color="#8a8f98", lw=1, ls="--")
    axis.set_yticks(range(len(ledger.claims)), [e.id for e in ledger.claims], fontsize=8)
    axis.set_ylim(len(ledger.claims) - 0.5, -0.5)
    axis.set_xlim(LOW - 0.05, HIGH + 0.05)
    axis.set_xlabel(
        f"computed over printed (1: they agree; beyond {LOW:g} and {HIGH:g} at the edge)", fontsize=9
    )
    plain_axis(axis)
    return stamped(figure, stamp)
