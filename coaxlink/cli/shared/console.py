"""Rich consoles to which text is text: no markup, no emoji codes, no control characters of a file's or a
vehicle's. What is meant to be bold is a `rich.text.Text`. Tables keep whole words on narrow screens."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rich.console import Console, RenderableType
from rich.measure import Measurement
from rich.status import Status
from rich.table import Table
from rich.text import Text

from coaxlink.cli.shared.options import by_option
from firmware_params.plain import plain_lines


class PlainConsole(Console):
    """A console that interprets nothing in a string but the parameters that the library names."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, highlight=False, markup=False, emoji=False)

    def print(self, *objects: Any, **options: Any) -> None:
        """As Rich prints, but no word of a table is cut in two."""
        parts = [p for o in objects for p in (fitted(self, o) if isinstance(o, Table) else (o,))]
        if len(parts) > len(objects):
            for part in parts:
                super().print(part, **options)
        else:
            super().print(*parts, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """A string as it stands; also those of tables, their headings and titles."""
        return super().render_str(
            plain_lines(by_option(text)), **{**options, "markup": False, "emoji": False}
        )

    def status(self, status: RenderableType, **options: Any) -> Status:
        """A status line whose texts are plain as well."""
        return _PlainStatus(_text(status), console=self, **options)


def fitted(console: Console, table: Table) -> Iterator[Table]:
    """The table with columns as wide as their longest word at least; where that is more than the screen has,
    further columns stand below, each time beside the first."""
    wanted = [_measured(console, table, n) for n in range(len(table.columns))]
    fits = sum(m.maximum for m in wanted) + _edges(table, range(len(wanted))) <= console.width
    if fits or len(wanted) < 2:
        yield table
        return
    start = 1
    while start < len(wanted):
        stop = len(wanted)
        while stop > start + 1 and _needed(table, wanted, [0, *range(start, stop)]) > console.width:
            stop -= 1
        yield _part(console, table, wanted, [0, *range(start, stop)])
        start = stop


def _measured(console: Console, table: Table, n: int) -> Measurement:
    """Longest word and longest line of a column, without its padding."""
    column = table.columns[n]
    cells = [*(() if not table.show_header else (column.header,)), *column.cells]
    sizes = [Measurement.get(console, console.options.update(width=10_000), cell) for cell in cells]
    most = console.width // 2  # a longer word is none of ours and folds, or two columns had no room
    words = [min(m.minimum, most) if m.maximum else 0 for m in sizes]
    return Measurement(max(words, default=0), max((m.maximum for m in sizes), default=0))


def _edges(table: Table, columns: Sequence[int]) -> int:
    """Width of padding and lines of a table of these columns."""
    lines = (2 if table.show_edge else 0) + len(columns) - 1 if table.box else 0
    return lines + sum(table._get_padding_width(n) for n in columns)


def _needed(table: Table, wanted: Sequence[Measurement], columns: Sequence[int]) -> int:
    return sum(wanted[n].minimum for n in columns) + _edges(table, columns)


def _part(console: Console, table: Table, wanted: Sequence[Measurement], chosen: Sequence[int]) -> Table:
    """These columns of the table; room beyond the longest words goes to the columns that lack most."""
    width = {n: wanted[n].minimum for n in chosen}
    room = console.width - _edges(table, chosen) - sum(width.values())
    while room > 0:
        poorest = max(chosen, key=lambda n: wanted[n].maximum - width[n])
        if wanted[poorest].maximum <= width[poorest]:
            break
        width[poorest] += 1
        room -= 1
    part = Table(box=table.box, show_header=table.show_header, show_edge=table.show_edge)
    part.title = table.title if len(chosen) < 2 or chosen[1] == 1 else None
    part.title_justify, part.padding, part.show_lines = table.title_justify, table.padding, table.show_lines
    part.pad_edge, part.collapse_padding = table.pad_edge, table.collapse_padding
    for n in chosen:
        old = table.columns[n]
        part.add_column(
            old.header, justify=old.justify, style=old.style, width=max(width[n], 1), overflow="fold"
        )
    for k, row in enumerate(table.rows):
        part.add_row(
            *(table.columns[n]._cells[k] for n in chosen), end_section=row.end_section, style=row.style
        )
    return part


class _PlainStatus(Status):
    def update(self, status: RenderableType | None = None, **options: Any) -> None:
        super().update(None if status is None else _text(status), **options)


def _text(status: RenderableType) -> RenderableType:
    return Text(plain_lines(by_option(status))) if isinstance(status, str) else status
