"""Rich consoles to which text is text: no markup, no emoji codes, no control characters of a file's or a
vehicle's. What is meant to be bold is a `rich.text.Text`. Narrow screens keep a number beside its unit."""

from __future__ import annotations

import copy
import dataclasses
import re
import textwrap
from collections.abc import Iterator, Sequence
from typing import Any

from rich.cells import cell_len
from rich.console import Console, RenderableType
from rich.status import Status
from rich.table import Column, Table
from rich.text import Text

from coaxlink.cli.shared.options import by_option
from firmware_params.plain import plain_lines

# blanks inside one thing: 3.6 N m, 0.1 .. 0.4, 2.0 ± 0.1
INSIDE = re.compile(
    r"(?<=\d) (?=(?:N|W|kg|g|V|A|Wh|m|s|ms|us|Hz|rpm|degrees|times|m/s)\b)|(?<=\bN) (?=m\b)"
    r"|(?<=\d) (?=(?:\.\.|±) )|(?<= \.\.) (?=[-+]?\d)|(?<= ±) (?=\d)"
)
WORD = re.compile(r"[^\W\d_]{3}")
JOINED = "\N{NO-BREAK SPACE}"


class PlainConsole(Console):
    """A console that interprets nothing in a string but the parameters that the library names."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, highlight=False, markup=False, emoji=False)

    def print(self, *objects: Any, **options: Any) -> None:
        """As Rich prints; a table with too many columns for the screen goes on below, beside its first."""
        for table in (o for o in objects if isinstance(o, Table)):
            for part in _parts(self, table):
                super().print(part, **options)
        rest = [o for o in objects if not isinstance(o, Table)]
        if not options.get("soft_wrap"):
            rest = [wrapped(by_option(o), self.width) if isinstance(o, str) else o for o in rest]
        if rest or not objects:
            super().print(*rest, **options)

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
    lines: list[str] = []
    for line in INSIDE.sub(JOINED, text).split("\n"):
        long = cell_len(line) > width
        lines += (
            textwrap.wrap(line, width, break_long_words=False, break_on_hyphens=False) if long else [line]
        )
    return "\n".join(lines).replace(JOINED, " ")


def _parts(console: Console, table: Table) -> Iterator[Table]:
    """As many columns as fit with their words whole, each time beside the first."""
    wide = console.options.update(max_width=10_000)
    if console.measure(table, options=wide).maximum <= console.width or len(table.columns) < 2:
        yield table
        return
    size = [_needs(column, console.width // 2) for column in table.columns]
    padding = max(table._get_padding_width(n) for n in range(len(size))) + (1 if table.box else 0)
    start = 1
    while start < len(size):
        stop = len(size)
        while (
            stop > start + 1 and sum(size[n][0] + padding for n in (0, *range(start, stop))) >= console.width
        ):
            stop -= 1
        chosen = (0, *range(start, stop))
        part = copy.copy(table)
        widths = _shared([size[n] for n in chosen], console.width - 1 - padding * len(chosen))
        part.columns = [
            dataclasses.replace(table.columns[n], _index=k, overflow="fold", width=widths[k])
            for k, n in enumerate(chosen)
        ]
        part.title = table.title if start == 1 else None
        yield part
        start = stop


def _needs(column: Column, most: int) -> tuple[int, int]:
    """Characters without cutting a word or parting a number from its unit; and on one line."""
    lines = [line for cell in (column.header, *column.cells) for line in str(cell).split("\n")]
    whole = [piece for line in lines for piece in (line.split() if WORD.search(line) else [line])]
    return min(max(map(cell_len, whole), default=1), most) or 1, max(map(cell_len, lines), default=1)


def _shared(size: Sequence[tuple[int, int]], room: int) -> list[int]:
    """Width of each column: what it needs, and what is left goes to those that break the most."""
    widths = [least for least, _ in size]
    while sum(widths) < room and any(w < line for w, (_, line) in zip(widths, size, strict=True)):
        lines = [line / w if w < line else 0.0 for w, (_, line) in zip(widths, size, strict=True)]
        widths[lines.index(max(lines))] += 1
    return widths


class _PlainStatus(Status):
    def update(self, status: RenderableType | None = None, **options: Any) -> None:
        super().update(None if status is None else _text(status), **options)


def _text(status: RenderableType) -> RenderableType:
    return Text(plain_lines(by_option(status))) if isinstance(status, str) else status
