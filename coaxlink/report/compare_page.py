"""A comparison of mixers as one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from coaxlink.report.document import answer, document, how_made, html_table, picture
from coaxlink.report.html import escape
from coaxlink.report.made import Made
from coaxlink.report.pictures.figures import drawn
from coaxlink.report.worth import rows, sentences, terms
from coaxlink.tables.worth import Worths

CAPTION = (
    "Left: thrust delivered minus demanded, over the thrust demanded, in level flight. Middle: mean error of "
    "each law over the envelope. Right: what the fitted table trades as its upper rotors carry more"
)


def compare_page(
    name: str,
    figure: Any,
    worths: Worths,
    laws: tuple[Sequence[str], Sequence[Sequence[str]]],
    envelope: str,
    made: Made,
    battery: tuple[float | None, float],
) -> str:
    """The page; `laws`: headings and rows of the table of laws; `battery`: Wh and the drive's efficiency."""
    said = [text.replace("`", "") for text in sentences(worths)]
    lead, _, rest = (said[0] if said else f"All laws on {name}.").partition("; ")
    return document(
        f"{name}: what a table is worth",
        [
            answer(f"{lead.rstrip('.')}."),
            *(f"<p>{escape(text[:1].upper() + text[1:])}</p>" for text in (rest, *said[1:]) if text),
            picture(drawn(figure), CAPTION),
            "<h2>For whoever flies it</h2>",
            html_table(("by the rotor model", *(t.name for t in worths.rows)), rows(worths.rows, *battery)),
            f'<p class="dim">{escape(terms())}</p>',
            "<h2>Every law, before any integrator</h2>",
            f'<p class="dim">{escape(envelope)}</p>',
            html_table(*laws),
            *how_made(made),
        ],
    )
