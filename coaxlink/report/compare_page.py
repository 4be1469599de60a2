"""A comparison of mixers as one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from coaxlink.report.html import PagePicture, PageTable, render
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
    heads = ("by the rotor model", *(t.name for t in worths.rows))
    return render(
        "compare.html",
        title=f"{name}: what a table is worth",
        lead=f"{lead.rstrip('.')}.",
        said=[text[:1].upper() + text[1:] for text in (rest, *said[1:]) if text],
        picture=PagePicture(drawn(figure), CAPTION),
        worths=PageTable(heads, rows(worths.rows, *battery)),
        terms=terms(),
        envelope=envelope,
        laws=PageTable(*laws),
        made=made,
    )
