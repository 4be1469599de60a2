"""Rich consoles to which text is text: no markup, no emoji codes, no control characters of a file's or a
vehicle's. What is meant to be bold is a `rich.text.Text`. Tables keep whole words on narrow screens."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from rich.cells import cell_len
from rich.console import Console, RenderableType
from rich.status import Status
from rich.table import Table
from rich.text import Text

from coaxlink.cli.shared.options import by_option
from firmware_params.plain import plain_lines

# blanks inside one thing: 3.6 N m, 0.1 .. 0.4, 2.0 ± 0.1
INSIDE = re.compile(
    r"(?<=\d) (?=(?:N|W|kg|g|V|A|Wh|m|s|ms|us|Hz|rpm|degrees|times|m/s)\b)|(?<=\bN) (?=m\b)"
    r"|(?<=\d) (?=(?:\.\.|±) )|(?<= \.\.) (?=[-+]?\d)|(?<= ±) (?=\d)"
)


class PlainConsole(Console):
    """A console that interprets nothing in a string but the parameters that the library names."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, highlight=False, markup=False, emoji=False)

    def print(self, *objects: Any, **options: Any) -> None:
        """As Rich prints, but no word of a table is cut in two, and no number parted from its unit."""
        if not options.get("soft_wrap"):
            objects = tuple(wrapped(by_option(o), self.width) if isinstance(o, str) else o for o in objects)
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


def wrapped(text: str, width: int) -> str:
    """Lines no longer than the screen, broken between words but not between a number and its unit.

    >>> wrapped("the best one leaves 3.60 N m", 25)
    'the best one leaves\\n3.60 N m'
    """
    joined = INSIDE.sub("\N{NO-BREAK SPACE}", text)
    lines = (
        textwrap.wrap(line, width, break_long_words=False, break_on_hyphens=False, drop_whitespace=True)
        if cell_len(line) > width
        else [line]
        for line in joined.split("\n")
    )
    return "\n".join(line for some in lines for line in some).replace("\N{NO-BREAK SPACE}", " ")


def fitted(console: Console, table: Table) -> Iterator[Table]:
    """The table with columns as wide as their longest word at least; where that is more than the screen has,
    further columns stand below, each time beside the first."""
    wanted = [_measured(console, table, n) for n in range(len(table.columns))]
    fits = sum(w.line for w in wanted) + _edges(table, range(len(wanted))) <= console.width
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


class Wanted(NamedTuple):
    """Characters that a column needs and would like, without its padding, and what it looks like between."""

    word: int  # its longest word: no narrower
    line: int  # its longest cell, or heading, on one line
    lines: tuple[int, ...]  # of all its cells, by width from `word` to `line`


def _measured(console: Console, table: Table, n: int) -> Wanted:
    column = table.columns[n]
    cells = [str(cell) for cell in (*((column.header,) if table.show_header else ()), *column.cells)]
    pieces = [_pieces(line) for cell in cells for line in cell.split("\n")]
    most = console.width // 2  # a longer word is none of ours and folds, or two columns had no room
    word = min(max((p for line in pieces for p in line), default=0), most)
    line = max((sum(line) + len(line) - 1 for line in pieces), default=0)
    width = max(word, 1)
    return Wanted(word, line, tuple(sum(_height(p, w) for p in pieces) for w in range(width, line + 1)))


def _pieces(line: str) -> list[int]:
    """Lengths of what is not broken: words, and a number with its interval or its unit, or a term, as one."""
    if not re.search(r"[^\W\d_]{3}", line):
        return [cell_len(line.strip())]
    return [cell_len(word) for word in line.split()]


def _height(pieces: Sequence[int], width: int) -> int:
    """Lines that pieces of these lengths fill at this width."""
    lines, at = 1, 0
    for size in pieces:
        if at and at + 1 + size > width:
            lines, at = lines + 1, 0
        at += size + (1 if at else 0)
    return lines


def _edges(table: Table, columns: Sequence[int]) -> int:
    """Width of padding and lines of a table of these columns."""
    lines = (2 if table.show_edge else 0) + len(columns) - 1 if table.box else 0
    return lines + sum(table._get_padding_width(n) for n in columns)


def _needed(table: Table, wanted: Sequence[Wanted], columns: Sequence[int]) -> int:
    return sum(wanted[n].word for n in columns) + _edges(table, columns)


def _widths(wanted: Sequence[Wanted], chosen: Sequence[int], room: int) -> dict[int, int]:
    """Width of each column so that all their cells together fill the fewest lines."""
    best: dict[int, tuple[int, tuple[int, ...]]] = {0: (0, ())}  # room taken: lines, widths so far
    for n in chosen:
        further: dict[int, tuple[int, tuple[int, ...]]] = {}
        for taken, (lines, widths) in best.items():
            for more, height in enumerate(wanted[n].lines or (0,)):
                width = max(wanted[n].word, 1) + more
                found = (lines + height, (*widths, width))
                if taken + width <= room and found < further.get(taken + width, (10**9, ())):
                    further[taken + width] = found
        best = further
    # nothing fits: words longer than the screen, which fold
    widths = min(best.values())[1] if best else tuple(max(wanted[n].word, 1) for n in chosen)
    return dict(zip(chosen, widths, strict=True))


def _heading(header: RenderableType, width: int) -> RenderableType:
    """A heading that has to break does so before its unit: "roll / N m", not "roll N / m"."""
    if isinstance(header, str) and len(header) > width and "\n" not in header and header.endswith(" N m"):
        return f"{header.removesuffix(' N m')}\nN m"
    return header


def _part(console: Console, table: Table, wanted: Sequence[Wanted], chosen: Sequence[int]) -> Table:
    """These columns of the table, as wide as the screen lets them be."""
    width = _widths(wanted, chosen, console.width - _edges(table, chosen))
    part = Table(box=table.box, show_header=table.show_header, show_edge=table.show_edge)
    part.title = table.title if len(chosen) < 2 or chosen[1] == 1 else None
    part.title_justify, part.padding, part.show_lines = table.title_justify, table.padding, table.show_lines
    part.pad_edge, part.collapse_padding = table.pad_edge, table.collapse_padding
    for n in chosen:
        old = table.columns[n]
        part.add_column(
            _heading(old.header, width[n]),
            justify=old.justify,
            style=old.style,
            width=max(width[n], 1),
            overflow="fold",
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
