"""A comparison of mixers as one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from coaxlink.mixer.worth import Worth
from coaxlink.report.html import PagePicture, PageTable, render
from coaxlink.report.made import Made
from coaxlink.report.pictures.figures import drawn
from coaxlink.report.worth import rows, sentences, terms, used
from coaxlink.tables.worth import Worths

CAPTION = (
    "Above: ceiling, yaw authority and hover power of every table and law; filled where no other is better "
    "in all three, ringed where it is in use. Below: how hard the vehicle sinks in a hard turn, over its load"
)


def compare_page(
    name: str,
    figure: Any,
    worths: Worths,
    shown: Sequence[Worth],
    laws: tuple[Sequence[str], Sequence[Sequence[str]]],
    made: Made,
    battery: tuple[float | None, float],
) -> str:
    """The page; `laws`: headings and rows of the table of laws; `battery`: Wh and the drive's efficiency."""
    reported = [text.replace("`", "") for text in sentences(worths)] or [f"All laws on {name}."]
    lead, _, rest = reported[0].partition(". ")
    heads = ("by the rotor model", *(f"* {t.name}" if t.name == worths.used else t.name for t in shown))
    return render(
        "compare.html",
        title=f"{name}: what a table is worth",
        lead=f"{lead.rstrip('.')}.",
        reported=[text for text in (rest, *reported[1:]) if text],
        picture=PagePicture(drawn(figure), CAPTION),
        worths=PageTable(heads, rows(shown, *battery)),
        terms=f"* {used(worths)}. {terms()}",
        laws=PageTable(*laws),
        made=made,
    )
