"""Tables as they come off a stand: headings and columns of numbers, each row with its line in the file.

Nothing is interpreted here. A cell that must be a number and is not is reported with file, line and column.
Text is read in pieces: numpy's own parser takes what is plainly numbers, cell by cell goes the rest.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coaxlink import files
from coaxlink.data.layout import COMMENTS, HEAD, Layout, Row, find_layout, layout_of, split
from coaxlink.data.lines import LONGEST_QUOTE, Line, Progress, joined_quotes, read_lines
from coaxlink.data.sheet import is_sheet, read_sheet
from coaxlink.errors import InputError
from firmware_params import bounded

FIRST = 2 * HEAD  # lines that decide the layout
ABSURD = 1e20  # in any unit of a log, nanoseconds since 1970 included


@dataclass(frozen=True)
class Column:
    """One column: its numbers, NaN where a cell is none, and the first such cell."""

    values: NDArray[np.float64]  # (rows,)
    odd: tuple[int, str] | None  # row and text of the first cell that is no number
    empty: bool  # nothing stands in any row


@dataclass(frozen=True)
class TextTable:
    """Headings and columns of a file, all columns of the heading line, in its order."""

    source: Path
    headings: tuple[str, ...]
    units: tuple[str, ...]  # of a second heading line, "" where none is written
    heading_line: int
    columns: tuple[Column, ...]
    lines: NDArray[np.int64]  # (rows,) line number in the file of each row
    notes: tuple[str, ...] = field(default=())

    def column_is_empty(self, index: int) -> bool:
        """Whether no row has anything in this column."""
        return self.columns[index].empty

    def numbers(self, index: int) -> NDArray[np.float64]:
        """The column (rows,) as finite numbers. Raises InputError with line and column."""
        column = self.columns[index]
        if column.odd is not None:
            row, found = column.odd
            raise self.error(row, index, f"a number is expected, found {_quoted(found)}")
        bad = ~np.isfinite(column.values)
        if bad.any():
            row = int(np.argmax(bad))
            raise self.error(row, index, f"a finite number is expected, found {column.values[row]:g}")
        absurd = np.abs(column.values) > ABSURD
        if absurd.any():
            row = int(np.argmax(absurd))
            shown = f"{column.values[row]:g}".replace("e+", "e")
            raise self.error(row, index, f"no sensor reads {shown}")
        return column.values

    def numbers_or_none(self, index: int) -> NDArray[np.float64] | None:
        """The column (rows,) if every cell is a finite number, else None."""
        try:
            return self.numbers(index)
        except InputError:
            return None

    def error(self, row: int, index: int, problem: str) -> InputError:
        """Our one-line error at a cell."""
        return InputError(self.source, f"line {self.lines[row]}, column {self.headings[index]!r}", problem)


def is_spreadsheet(path: Path) -> bool:
    """Whether a file is a workbook, by its first bytes. Raises InputError."""
    return is_sheet(_magic(path))


def read_headings(path: Path) -> tuple[str, ...]:
    """The headings alone, from the first lines. Raises InputError."""
    if is_spreadsheet(path):
        return read_table(path).headings
    return find_layout(path, _head(path, read_lines(path))[0][:FIRST]).headings


def read_table(path: Path, progress: Progress | None = None, sheet: str | None = None) -> TextTable:
    """Read a delimited text or a spreadsheet. Raises InputError: unreadable, empty, ragged, heading twice."""
    if is_spreadsheet(path):
        rows, name = read_sheet(path, sheet)
        layout = layout_of(path, rows)
        body = _Body(path, layout)
        body.take_rows(row for row in rows if row[0] >= layout.first_line)
        return body.table((f"sheet '{name}'",))
    pieces = read_lines(path, progress)
    head, rest = _head(path, pieces)
    layout = find_layout(path, head[:FIRST])
    body = _Body(path, layout)
    lines = [line for line in head if line[0] >= layout.first_line]
    body.take(lines[:FIRST])  # these show which columns are no numbers: the rest goes fast
    body.take(lines[FIRST:])
    for piece in rest:
        body.take(piece)
    return body.table()


def _magic(path: Path) -> bytes:
    with files.reading(path):
        bounded.check_regular(path)
        with path.open("rb") as stream:
            return stream.read(8)


def _head(path: Path, pieces: Iterator[list[Line]]) -> tuple[list[Line], Iterator[list[Line]]]:
    """Enough first lines to tell the layout, quotes joined, and the pieces after them.

    A quote that is open at the end of a piece is followed into the next one.
    """
    unsplit = _unsplit_quotes(pieces)
    first: list[Line] = []
    while len(first) < HEAD:
        piece = next(unsplit, None)
        if piece is None:
            break
        first += piece
    joined = list(joined_quotes(path, first)) if any('"' in line for _, line in first) else first
    return joined, unsplit


def _unsplit_quotes(pieces: Iterable[list[Line]]) -> Iterator[list[Line]]:
    """The pieces, each cut before a line whose quote is still open at its end."""
    held: list[Line] = []
    for piece in pieces:
        lines = [*held, *piece] if held else piece
        held = []
        opened = [i for i, (_, line) in enumerate(lines) if '"' in line and line.count('"') % 2]
        if len(opened) % 2 and len(lines) - opened[-1] <= LONGEST_QUOTE:
            lines, held = lines[: opened[-1]], lines[opened[-1] :]
        yield lines
    if held:
        yield held


class _Body:
    """The rows of a file, collected piece by piece."""

    def __init__(self, path: Path, layout: Layout) -> None:
        self.path, self.layout = path, layout
        self._pieces: list[list[NDArray[np.float64]]] = [[] for _ in range(layout.width)]  # of each column
        self._lines: list[NDArray[np.int64]] = []
        self._odd: dict[int, tuple[int, str]] = {}  # first cell of a column that is no number
        self._filled = np.zeros(layout.width, bool)  # columns in which something stands
        self._rows = self._repeated = self._comments = 0

    def take(self, lines: list[Line]) -> None:
        """Rows of text lines (quotes may run over several)."""
        filled = [(n, line) for n, line in lines if line and not line.isspace()]
        if filled and not self._fast(filled):
            self.take_rows(self._split(filled))

    def _fast(self, lines: list[Line]) -> bool:
        """Take lines by numpy's parser if they are plainly numbers; else leave them, False.

        Columns already known to hold other things are not parsed again.
        """
        layout, mark = self.layout, self.layout.delimiter
        if mark == " " or (layout.decimal_comma and mark == ","):
            return False
        texts = [line for _, line in lines]
        counts = {line.count(mark) for line in texts}
        more = counts == {layout.width}  # a delimiter after the last column
        if not more and counts != {layout.width - 1}:
            return False
        if more and any(line.rpartition(mark)[2].strip() for line in texts):
            return False
        numeric = [i for i in range(layout.width) if i not in self._odd]
        if not numeric or any('"' in line for line in texts):
            return False
        for i in range(layout.width):
            if i in self._odd and not self._filled[i]:
                self._filled[i] = any(line.split(mark, i + 1)[i].strip() for line in texts)
        plain = [line.replace(".", "").replace(",", ".") for line in texts] if layout.decimal_comma else texts
        try:
            values = np.loadtxt(plain, delimiter=mark, comments=None, ndmin=2, usecols=numeric)
        except ValueError:
            return False
        self._filled[numeric] = True
        nothing = np.full(len(lines), np.nan)
        columns = [nothing] * layout.width
        for column, i in enumerate(numeric):
            columns[i] = np.ascontiguousarray(values[:, column])
        self._add(columns, np.fromiter((n for n, _ in lines), np.int64, len(lines)))
        return True

    def _split(self, lines: list[Line]) -> Iterator[Row]:
        quoted = any('"' in line for _, line in lines)
        for number, line in joined_quotes(self.path, lines) if quoted else lines:
            if line.lstrip().startswith(COMMENTS):
                self._comments += 1
            else:
                yield number, split(self.path, line, self.layout.delimiter)

    def take_rows(self, rows: Iterable[Row]) -> None:
        """Rows already split into cells."""
        width, raw = self.layout.width, self.layout.raw
        values: list[list[float]] = []
        numbers: list[int] = []
        for number, cells in rows:
            if len(cells) != width or not cells[0].strip() or not cells[0].strip()[0].isdigit():
                stripped = tuple(c.strip() for c in cells)
                while stripped and not stripped[-1]:
                    stripped = stripped[:-1]
                if not stripped:
                    continue
                if stripped in raw:
                    self._repeated += 1
                    continue
                if len(cells) < width or len(stripped) > width:
                    found = f"{width} columns are expected, found {len(cells)}"
                    raise InputError(self.path, f"line {number}", found)
            values.append([self._number(self._rows + len(values), i, cells[i]) for i in range(width)])
            numbers.append(number)
        if values:
            self._add(list(np.array(values).T.copy()), np.array(numbers, np.int64))

    def _number(self, row: int, index: int, cell: str) -> float:
        try:
            value = self.layout.number(cell)
        except ValueError:
            text = cell.strip()
            self._odd.setdefault(index, (row, text))
            self._filled[index] |= bool(text)
            return math.nan
        self._filled[index] = True
        return value

    def _add(self, columns: list[NDArray[np.float64]], lines: NDArray[np.int64]) -> None:
        for pieces, column in zip(self._pieces, columns, strict=True):
            pieces.append(column)
        self._lines.append(lines)
        self._rows += len(lines)

    def table(self, notes: tuple[str, ...] = ()) -> TextTable:
        """All that was taken. Raises InputError when there is no row."""
        layout = self.layout
        if not self._rows:
            where = f"line {layout.heading_line + 1}"
            raise InputError(self.path, where, "no rows: numbers are expected under the heading line")
        columns = []
        for i in range(layout.width):
            values = np.concatenate(self._pieces[i])
            self._pieces[i] = []  # a gigabyte is not held twice
            columns.append(Column(values, self._odd.get(i), not self._filled[i]))
        said = [*layout.notes, *notes]
        if self._repeated:
            said.append(f"headings repeated on {self._repeated} further lines, passed over")
        if self._comments:
            said.append(f"{self._comments} lines of comment passed over")
        if layout.decimal_comma:
            said.append("numbers with a decimal comma")
        return TextTable(
            self.path, layout.headings, layout.units, layout.heading_line, tuple(columns),
            np.concatenate(self._lines), tuple(said),
        )  # fmt: skip


def _quoted(text: str) -> str:
    if not text:
        return "an empty cell"
    return f"'{text[:30]}'" + ("..." if len(text) > 30 else "")
