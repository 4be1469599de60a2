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
from coaxlink.data.layout import COMMENTS, HEAD, Row, TableLayout, find_layout, layout_of, split, stripped
from coaxlink.data.lines import Line, Progress, read_lines
from coaxlink.data.marks import refuse_foreign
from coaxlink.data.sheet import is_sheet, read_sheet
from coaxlink.errors import InputError
from firmware_params import bounded

FIRST = 2 * HEAD  # lines that decide the layout
SEVERAL = 3  # rows that end at the same cell: a logger's way; fewer are a line that was cut
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

    def is_numbers(self, index: int) -> bool:
        """Whether most cells of a column are numbers."""
        return bool(np.isfinite(self.columns[index].values).mean() > 0.5)

    def numbers(self, index: int, most: float = ABSURD) -> NDArray[np.float64]:
        """The column (rows,) as finite numbers, `most` at most. Raises InputError with line and column."""
        values, odd = self.columns[index].values, self.columns[index].odd
        if odd is not None:
            raise self._cell_error(odd[0], index, f"a number is expected, found {_quoted(odd[1])}")
        wrong = ~(np.abs(values) <= most)
        if wrong.any():
            row = int(np.argmax(~np.isfinite(values) if not np.isfinite(values).all() else wrong))
            if np.isfinite(values[row]):
                shown = f"{values[row]:g}".replace("e+", "e")
                raise self._cell_error(row, index, f"no sensor reads {shown}")
            raise self._cell_error(row, index, f"a finite number is expected, found {values[row]:g}")
        return values

    def numbers_or_none(self, index: int) -> NDArray[np.float64] | None:
        """The column (rows,) if every cell is a finite number, else None."""
        try:
            return self.numbers(index)
        except InputError:
            return None

    def heading_error(self, heading: str, problem: str) -> InputError:
        """Our one-line error at a heading, or at the line of headings where it is ""."""
        column = f", column {heading!r}" if heading else ""
        return InputError(self.source, f"line {self.heading_line}{column}", problem)

    def _cell_error(self, row: int, index: int, problem: str) -> InputError:
        return InputError(self.source, f"line {self.lines[row]}, column {self.headings[index]!r}", problem)


def is_spreadsheet(path: Path) -> bool:
    """Whether a file is a workbook, by its first bytes. Raises InputError."""
    with files.reading(path):
        bounded.check_regular(path)
        with path.open("rb") as stream:
            return is_sheet(stream.read(8))


def read_headings(path: Path, sheet: str | None = None) -> tuple[str, ...]:
    """The headings alone, from the first lines. Raises InputError."""
    if is_spreadsheet(path):
        return read_table(path, sheet=sheet).headings
    refuse_foreign(path)
    return find_layout(path, _head(read_lines(path))[:FIRST]).headings


def read_table(path: Path, progress: Progress | None = None, sheet: str | None = None) -> TextTable:
    """Read a delimited text or a spreadsheet. Raises InputError: unreadable, empty, ragged, heading twice."""
    if is_spreadsheet(path):
        rows, name = read_sheet(path, sheet)
        layout = layout_of(path, rows)
        body = _Body(path, layout)
        body.take_rows(row for row in rows if row[0] >= layout.first_line)
        return body.table((f"sheet '{name}'",))
    refuse_foreign(path)
    pieces = read_lines(path, progress)
    head = _head(pieces)
    layout = find_layout(path, head[:FIRST])
    body = _Body(path, layout)
    lines = [line for line in head if line[0] >= layout.first_line]
    body.take(lines[:FIRST])  # these show which columns are no numbers: the rest goes fast
    for piece in (lines[FIRST:], *pieces):
        body.take(piece)
    return body.table()


def _head(pieces: Iterator[list[Line]]) -> list[Line]:
    """Whole pieces, until there are lines enough to tell the layout."""
    first: list[Line] = []
    for piece in pieces:
        first += piece
        if len(first) >= HEAD:
            break
    return first


class _Body:
    """The rows of a file, collected piece by piece."""

    def __init__(self, path: Path, layout: TableLayout) -> None:
        self.path, self.layout, self.width = path, layout, len(layout.headings)
        self._pieces: list[NDArray[np.float64]] = []  # each (columns, rows of the piece)
        self._lines: list[NDArray[np.int64]] = []
        self._odd: dict[int, tuple[int, str]] = {}  # first cell of a column that is no number
        self._filled = np.zeros(self.width, bool)  # columns in which something stands
        self._short: dict[int, list[int]] = {}  # lines of rows that end early, by their cells
        self._rows = self._repeated = self._comments = 0

    def take(self, lines: list[Line]) -> None:
        """Rows of text lines."""
        filled = [(n, line) for n, line in lines if line and not line.isspace()]
        if filled and not self._fast(filled):
            self.take_rows(self._split(filled))

    def _fast(self, lines: list[Line]) -> bool:
        """Take lines by numpy's parser if they are plainly numbers; else leave them, False.

        Columns already known to hold other things are not parsed again.
        """
        width, mark, comma = self.width, self.layout.delimiter, self.layout.decimal_comma
        numeric = [i for i in range(width) if i not in self._odd]
        if mark == " " or (comma and mark == ",") or not numeric:
            return False
        texts = [line for _, line in lines]
        counts = {line.count(mark) for line in texts}
        if any('"' in line for line in texts) or counts not in ({width - 1}, {width}):
            return False
        if counts == {width} and any(line.rpartition(mark)[2].strip() for line in texts):
            return False  # more than a delimiter after the last column
        for i in self._odd:
            if not self._filled[i]:
                self._filled[i] = any(line.split(mark, i + 1)[i].strip() for line in texts)
        plain = [line.replace(".", "").replace(",", ".") for line in texts] if comma else texts
        try:
            values = np.loadtxt(plain, delimiter=mark, comments=None, ndmin=2, usecols=numeric)
        except ValueError:
            return False
        self._filled[numeric] = True
        piece = np.full((width, len(lines)), np.nan)
        piece[numeric] = values.T
        self._add(piece, [n for n, _ in lines])
        return True

    def _split(self, lines: list[Line]) -> Iterator[Row]:
        for number, line in lines:
            if line.lstrip().startswith(COMMENTS):
                self._comments += 1
            else:
                yield number, split(self.path, line, self.layout.delimiter)

    def take_rows(self, rows: Iterable[Row]) -> None:
        """Rows already split into cells."""
        values: list[list[float]] = []
        numbers: list[int] = []
        for number, cells in rows:
            if len(cells) != self.width or not cells[0].strip()[:1].isdigit():
                shown = stripped(cells)
                if not shown:
                    continue
                if tuple(shown) in self.layout.raw:
                    self._repeated += 1
                    continue
                if (
                    len(shown) > self.width and self.width - 1 in self._odd
                ):  # commas in a last column of words
                    cells = [*cells[: self.width - 1], self.layout.delimiter.join(shown[self.width - 1 :])]
                elif len(shown) > self.width:
                    raise self._odd_width(number, len(cells))
                elif len(cells) < self.width:
                    self._short.setdefault(len(cells), []).append(number)
                    cells = [*cells, *[""] * (self.width - len(cells))]
            values.append([self._number(self._rows + len(values), i, cells[i]) for i in range(self.width)])
            numbers.append(number)
        if values:
            self._add(np.array(values).T, numbers)

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

    def _add(self, piece: NDArray[np.float64], lines: list[int]) -> None:
        self._pieces.append(piece)
        self._lines.append(np.array(lines, np.int64))
        self._rows += len(lines)

    def _odd_width(self, line: int, cells: int) -> InputError:
        return InputError(self.path, f"line {line}", f"{self.width} columns are expected, found {cells}")

    def table(self, notes: tuple[str, ...] = ()) -> TextTable:
        """All that was taken. Raises InputError when there is no row."""
        layout, torn = self.layout, self._without_torn_end()
        if not self._rows:
            where = f"line {layout.heading_line + 1}"
            raise InputError(self.path, where, "no rows: numbers are expected under the heading line")
        for cells, cut in self._short.items():
            if len(cut) < SEVERAL:
                raise self._odd_width(cut[0], cells)
        columns = tuple(
            Column(np.concatenate([p[i] for p in self._pieces]), self._odd.get(i), not self._filled[i])
            for i in range(self.width)
        )
        reported = [*layout.notes, *notes, *torn]
        if self._repeated:
            reported.append(f"headings repeated on {self._repeated} further lines, passed over")
        if self._short:
            rows, least = sum(map(len, self._short.values())), min(self._short)
            missing = ", ".join(layout.headings[least:])
            reported.append(f"{rows} rows end before the heading does; empty there: {missing}")
        if self._comments:
            reported.append(f"{self._comments} lines of comment passed over")
        if layout.decimal_comma:
            reported.append("numbers with a decimal comma")
        return TextTable(
            self.path, layout.headings, layout.units, layout.heading_line, columns,
            np.concatenate(self._lines), tuple(reported),
        )  # fmt: skip

    def _without_torn_end(self) -> list[str]:
        """Leave out a last row that alone ends early, as where power was cut: its last number may be, too."""
        last = int(self._lines[-1][-1]) if self._lines else 0
        if self._rows < 2 or list(self._short.values()) != [[last]]:
            return []
        self._short, self._rows = {}, self._rows - 1
        self._pieces[-1], self._lines[-1] = self._pieces[-1][:, :-1], self._lines[-1][:-1]
        self._odd = {i: (row, text) for i, (row, text) in self._odd.items() if row < self._rows}
        return [f"line {last} is cut off, left out"]


def _quoted(text: str) -> str:
    if not text:
        return "an empty cell"
    return f"'{text[:30]}'" + ("..." if len(text) > 30 else "")
