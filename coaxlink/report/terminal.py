"""The one look of a table in the terminal."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table


def table(
    title: str,
    heads: Sequence[str],
    rows: Iterable[Sequence[Any]],
    *,
    left: int = 1,
    boxed: bool = False,
    sections: Collection[int] = (),
    caption: str = "",
) -> Table:
    """A rich table: the first `left` columns are words, the others numbers; a line before rows `sections`."""
    from rich import box
    from rich.table import Table

    made = Table(
        title=title or None,
        title_justify="left",
        caption=caption or None,
        caption_justify="left",
        box=box.HEAVY_HEAD if boxed else None,
        pad_edge=boxed,
    )
    for n, head in enumerate(heads):
        made.add_column(head, justify="left" if n < left else "right")
    for n, row in enumerate(rows):
        if n in sections:
            made.add_section()
        made.add_row(*row)
    return made


def grouped(rows: Sequence[Sequence[Any]]) -> list[int]:
    """Where a row's first cell says something: the first of a group of rows that share it."""
    return [n for n, row in enumerate(rows) if row[0]]
