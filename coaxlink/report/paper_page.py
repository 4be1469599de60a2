"""The paper's ledger as one self-contained HTML page."""

from __future__ import annotations

from collections import Counter

from coaxlink.report.document import answer, document, folded, how_made, html_table, picture
from coaxlink.report.html import escape
from coaxlink.report.made import Made
from coaxlink.report.paper import line_rows
from coaxlink.report.pictures.figures import drawn, stamped
from coaxlink.studies.paper import Ledger
from coaxlink.studies.paper.ledger import CONTRADICTED, IN_PART, NOT_CHECKED, NOT_HAD, REPRODUCED

SHADES = {  # told apart in grey print too
    REPRODUCED: "#1f5f8b", IN_PART: "#7fb2d5", CONTRADICTED: "#c4703f",
    NOT_HAD: "#8a8f98", NOT_CHECKED: "#d8dde5",
}  # fmt: skip
PAPER = (
    "Berra, Trujillo Soto and Heredia, Aerodynamic Interaction Minimization in Coaxial Multirotors via "
    "Optimized Control Allocation, Drones 2024, 8(9), 446. Printed: what the paper prints; computed: what "
    "coaxlink makes of it."
)


def paper_page(ledger: Ledger, made: Made) -> str:
    """The page: what holds, entry by entry, with printed and computed values."""
    parts = [
        answer(sentence(ledger)),
        f'<p class="dim">{escape(PAPER)}</p>',
        picture(
            drawn(_figure(ledger, made.line())),
            "A dot a number that is printed and computed; entries without dots have none of both",
        ),
        html_table(
            ("entry", "what", "verdict"), [(e.id, e.title, e.verdict) for e in ledger.entries], wide=(1,)
        ),
    ]
    for entry in ledger.entries:
        parts.append(f"<h2>{escape(entry.title)}: {escape(entry.verdict)}</h2>")
        parts.append(f"<p>{escape(entry.why[:1].upper() + entry.why[1:])}.</p>")
        if entry.lines:
            table = html_table(("what", "printed", "computed", "unit"), list(line_rows(entry)))
            parts.append(folded(f"{len(entry.lines)} numbers of {entry.id}", table))
    return document("The paper against its own numbers", [*parts, *how_made(made)])


def sentence(ledger: Ledger) -> str:
    """How many entries hold, and how many do not."""
    counts = Counter(e.verdict for e in ledger.entries)
    said = ", ".join(f"{counts[v]} {v}" for v in SHADES if counts[v])
    return f"Of {len(ledger.entries)} tables, figures, equations and statements of the paper: {said}."


def _figure(ledger: Ledger, stamp: str) -> object:
    """Computed over printed of every number that has both, an entry a row: 1 where they agree."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 0.8 + 0.28 * len(ledger.entries)), layout="constrained")
    axis = figure.subplots()
    for i, entry in enumerate(ledger.entries):
        pairs = [(line.printed, line.computed) for line in entry.lines]
        ratios = [c / p for p, c in pairs if p and c is not None]
        inside = [min(max(r, LOW), HIGH) for r in ratios]
        axis.plot(inside, [i] * len(inside), "o", ms=4, alpha=0.6, color=SHADES.get(entry.verdict, "#222222"))
    axis.axvline(1.0, color="#8a8f98", lw=1, ls="--")
    axis.set_yticks(range(len(ledger.entries)), [e.id for e in ledger.entries], fontsize=8)
    axis.set_ylim(len(ledger.entries) - 0.5, -0.5)
    axis.set_xlim(LOW - 0.05, HIGH + 0.05)
    axis.set_xlabel(
        f"computed over printed (1: they agree; beyond {LOW:g} and {HIGH:g} at the edge)", fontsize=9
    )
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.25, lw=0.6)
    return stamped(figure, stamp)


LOW, HIGH = 0.0, 2.0  # of the picture's axis
