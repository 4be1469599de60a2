"""Text tables as they come off a stand: delimiter, heading line, cells with their line numbers.

Nothing is interpreted here. A cell that must be a number and is not is reported with file, line and column.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coaxlink import files
from coaxlink.errors import InputError

DELIMITERS = ",;\t"
ABSURD = 1e20  # in any unit of a log, nanoseconds since 1970 included


@dataclass(frozen=True)
class TextTable:
    """Headings and cells of a delimited file, all columns of the heading line, in its order."""

    source: Path
    headings: tuple[str, ...]
    cells: tuple[tuple[str, ...], ...]  # (rows) of (columns)
    lines: tuple[int, ...]  # (rows,) line number in the file of each row

    def column_is_empty(self, index: int) -> bool:
        """Whether no row has anything in this column."""
        return all(not row[index].strip() for row in self.cells)

    def numbers(self, index: int) -> NDArray[np.float64]:
        """The column (rows,) as finite numbers. Raises InputError with line and column."""
        values = np.empty(len(self.cells))
        for i, row in enumerate(self.cells):
            try:
                values[i] = float(row[index])
            except ValueError:
                found = row[index].strip()
                raise self.error(i, index, f"a number is expected, found {_quoted(found)}") from None
            if not math.isfinite(values[i]):
                raise self.error(i, index, f"a finite number is expected, found {row[index].strip()}")
            if abs(values[i]) > ABSURD:
                raise self.error(i, index, f"no sensor reads {row[index].strip()}")
        return values

    def numbers_or_none(self, index: int) -> NDArray[np.float64] | None:
        """The column (rows,) if every cell is a finite number, else None."""
        try:
            return self.numbers(index)
        except InputError:
            return None

    def error(self, row: int, index: int, problem: str) -> InputError:
        """Our one-line error at a cell."""
        return InputError(self.source, f"line {self.lines[row]}, column {self.headings[index]!r}", problem)


def read_table(path: Path) -> TextTable:
    """Split a delimited text file. Raises InputError: unreadable, empty, ragged, heading twice."""
    rows = [(n, line) for n, line in enumerate(files.read_text(path).splitlines(), start=1) if line.strip()]
    if not rows:
        raise InputError(path, "", "empty: a heading line and rows of numbers are expected")
    delimiter = max(DELIMITERS, key=rows[0][1].count)
    try:
        split = list(csv.reader((line for _, line in rows), delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise InputError(path, "", f"not a table of columns separated by '{delimiter}' ({error})") from error
    headings = tuple(" ".join(name.split()) for name in split[0])
    width = len(headings)
    while width and not headings[width - 1]:  # a trailing delimiter names no column
        width -= 1
    _check_headings(path, headings[:width], split[0])
    if len(rows) < 2:
        raise InputError(path, "line 2", "no rows: numbers are expected under the heading line")
    cells = []
    for (line, _), row in zip(rows[1:], split[1:], strict=True):
        if len(row) < width or any(cell.strip() for cell in row[width:]):
            raise InputError(path, f"line {line}", f"{width} columns are expected, found {len(row)}")
        cells.append(tuple(row[:width]))
    return TextTable(path, headings[:width], tuple(cells), tuple(n for n, _ in rows[1:]))


def _check_headings(path: Path, headings: tuple[str, ...], raw: list[str]) -> None:
    if not headings or all(_is_number(cell) for cell in raw if cell.strip()):
        raise InputError(path, "line 1", "column headings are expected, found numbers")
    for i, name in enumerate(headings):
        if name and name in headings[:i]:
            raise InputError(path, f"line 1, column {name!r}", "the heading stands there twice")


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _quoted(text: str) -> str:
    if not text:
        return "an empty cell"
    return f"'{text[:30]}'" + ("..." if len(text) > 30 else "")
