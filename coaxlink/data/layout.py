"""How a table stands in a file: delimiter, decimal mark, heading line, a line of units, comments.

Known by the file's first lines; nothing about rotors is known here.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from coaxlink.data.aliases import QUANTITIES, plain
from coaxlink.data.lines import Line
from coaxlink.errors import InputError

DELIMITERS = (",", ";", "\t", "|", " ")
COMMENTS = ("#", "//", "%")
MOST_COLUMNS, LONGEST_HEADING = 2000, 200  # real loggers write some hundred, and 60 characters
HEAD = 400  # lines that may come before the first row of numbers
_UNIT = re.compile(r"[\[(].*[\])]|[a-z%°/·⋅*.\-^²³0-9 µμ]{1,8}|-|", re.IGNORECASE)
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
_COMMA = re.compile(r"[+-]?(\d{1,3}(\.\d{3})+|\d*),\d+([eE][+-]?\d+)?")
_CONTEXT_UNITS = {"pwm", "pa", "hpa", "°c", "c", "k", "m", "mm", "-"}  # no quantity of ours
_UNITS = _CONTEXT_UNITS.union(*(quantity.units for quantity in QUANTITIES.values()))
Row = tuple[int, list[str]]  # line number, cells


@dataclass(frozen=True)
class TableLayout:
    """Where the columns are and what they are called."""

    headings: tuple[str, ...]
    units: tuple[str, ...]  # of a second heading line, "" where there is none
    heading_line: int  # number in the file
    first_line: int  # of the first row of numbers
    delimiter: str = ","
    decimal_comma: bool = False
    raw: tuple[tuple[str, ...], ...] = ()  # the heading lines as they stand, to know them again further down
    notes: tuple[str, ...] = ()

    def number(self, text: str) -> float:
        """A cell as a number; "50%" is 50. Raises ValueError."""
        return _number(text.rstrip().removesuffix("%"), self.decimal_comma)


def find_layout(path: Path, lines: Sequence[Line]) -> TableLayout:
    """The layout of a delimited text from its first lines. Raises InputError."""
    rest = [(n, line) for n, line in lines if line.strip(" \t;,|")]
    if not rest:
        raise InputError(path, "", "empty: a heading line and rows of numbers are expected")
    best = (-1, -1), ",", [(n, [line]) for n, line in rest]
    for delimiter in DELIMITERS:
        rows = [(n, split(path, _uncommented(line), delimiter, strict=False)) for n, line in rest]
        score = _score(rows)
        if (score[0] > best[0][0]) if delimiter == " " else (score > best[0]):
            best = score, delimiter, rows
    _, delimiter, rows = best
    commented = {n for n, line in rest if line.lstrip().startswith(COMMENTS)}
    layout = layout_of(path, rows, commented, decimal_comma=_decimal_comma(path, rows))
    return replace(layout, delimiter=delimiter)


def split(path: Path, line: str, delimiter: str, *, strict: bool = True) -> list[str]:
    """The cells of one line. Raises InputError where quotes do not match."""
    if delimiter == " ":
        return line.split()
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter, strict=strict))
    except csv.Error as error:
        shown = {"\t": "a tab"}.get(delimiter, f"'{delimiter}'")
        raise InputError(path, "", f"not a table of columns separated by {shown} ({error})") from error


def _uncommented(line: str) -> str:
    """A line without the mark of a comment before it: some loggers write their headings as a comment."""
    text = line.lstrip()
    mark = next((m for m in COMMENTS if text.startswith(m)), "")
    return text.lstrip(mark).strip() if mark else line


def layout_of(
    path: Path,
    rows: Sequence[Row],
    commented: set[int] | frozenset[int] = frozenset(),
    *,
    decimal_comma: bool = False,
) -> TableLayout:
    """The layout of rows already split: the headings are the last text above the first numbers.

    Raises InputError.
    """
    first = next(
        (i for i, row in enumerate(rows) if row[0] not in commented and _is_data(row[1], decimal_comma)), None
    )
    if first is None:
        raise _no_numbers(path, rows, commented)
    number, cells = rows[first]
    width = len(stripped(cells))
    above = [
        row for row in rows[:first] if len(stripped(row[1])) > 1 or row[0] not in commented or width == 1
    ]
    wide = [row for row in above if len(stripped(row[1])) >= width] or above
    if not wide:
        raise InputError(path, f"line {number}", "column headings are expected, found numbers")
    top, units = wide[-1], [""] * len(wide[-1][1])
    raw = [top[1]]
    if len(wide) > 1 and _are_units(top[1]) and not _are_units(wide[-2][1]):
        units, top = top[1], wide[-2]
        raw = [units, top[1]]
    headings, group = _grouped(top, above)
    while headings and not headings[-1]:  # a trailing delimiter names no column
        headings.pop()
    _check(path, headings, top[0])
    units = [" ".join(u.split()).strip("[]() ") for u in units]
    units = [("" if u == "-" else u) for u in units[: len(headings)]] + [""] * (len(headings) - len(units))
    notes = []
    before = sum(1 for row in rows[:first] if row[0] < (group or top[0]))
    if before:
        notes.append(f"headings on line {top[0]}, {before} lines above them passed over")
    if group:
        notes.append(f"headings of lines {group} and {top[0]} put together")
    if any(units):
        notes.append(f"units on line {wide[-1][0]}")
    return TableLayout(
        tuple(headings), tuple(units), top[0], number, "", decimal_comma,
        tuple(tuple(stripped(r)) for r in raw), tuple(notes),
    )  # fmt: skip


def _no_numbers(path: Path, rows: Sequence[Row], commented: set[int] | frozenset[int]) -> InputError:
    """Headings without numbers, or no row of which a cell is one."""
    top = next((row for row in rows if row[0] not in commented and len(row[1]) > 1), rows[0])
    after = [row for row in rows if row[0] > top[0]]
    if not after:
        return InputError(path, f"line {top[0] + 1}", "no rows: numbers are expected under the heading line")
    return InputError(path, f"line {after[0][0]}", "no rows of numbers follow the heading line")


def stripped(cells: Sequence[str]) -> list[str]:
    """Cells without the white space around them and the empty ones at the end."""
    out = [cell.strip() for cell in cells]
    while out and not out[-1]:
        out.pop()
    return out


def _grouped(top: Row, above: Sequence[Row]) -> tuple[list[str], int]:
    """Headings; where they repeat under a line of group headings (Upper,,,Lower), both together."""
    names = [" ".join(c.split()) for c in top[1]]
    filled = [n for n in names if n]
    over = [row for row in above if row[0] < top[0] and len(stripped(row[1])) > 1]
    if len(set(filled)) == len(filled) or not over:
        return names, 0
    line, groups = over[-1]
    held, joined = "", []
    for i, name in enumerate(names):
        held = " ".join(groups[i].split()) if i < len(groups) and groups[i].strip() else held
        joined.append(f"{held} {name}".strip() if name else "")
    return joined, line


def _are_units(cells: Sequence[str]) -> bool:
    """Whether a line is one of units: short words or words in brackets, repeated as units are."""
    filled = [c.strip() for c in cells if c.strip()]
    if not filled or not all(_UNIT.fullmatch(c) for c in filled):
        return False
    bracketed = sum(c[0] in "[(" for c in filled)
    known = sum(_is_unit(c.strip("[]() ")) for c in filled)
    return bracketed == len(filled) or known > 0.5 * len(filled)


def _is_unit(word: str) -> bool:
    word = plain(word)
    return word in _UNITS or re.sub(r"[\s.*\-]", "", word) in _UNITS


def _is_data(cells: Sequence[str], decimal_comma: bool) -> bool:
    """Whether at least half of what stands in a line is numbers."""
    filled = [c.strip() for c in cells if c.strip()]
    count = sum(_is_number(c, decimal_comma) for c in filled)
    return bool(filled) and count >= 1 and 2 * count >= len(filled)


def _number(cell: str, decimal_comma: bool) -> float:
    """1.234,5 is 1234.5 with a decimal comma. Raises ValueError."""
    return float(cell.replace(".", "").replace(",", ".") if decimal_comma and "," in cell else cell)


def _is_number(cell: str, decimal_comma: bool) -> bool:
    try:
        _number(cell, decimal_comma)
    except ValueError:
        return False
    return True


def _score(rows: Sequence[Row]) -> tuple[int, int]:
    """Numbers less other cells in the lines of the commonest width, and the widest line."""
    gain: dict[int, int] = {}
    for _, cells in rows:
        filled = stripped(cells)
        if len(filled) > 1 and _is_data(filled, True):
            numbers = sum(_is_number(c, True) for c in filled if c)
            gain[len(filled)] = gain.get(len(filled), 0) + 2 * numbers - sum(bool(c) for c in filled)
    return max(gain.values(), default=0), max(len(cells) for _, cells in rows)


def _decimal_comma(path: Path, rows: Sequence[Row]) -> bool:
    """Whether numbers have a decimal comma. Raises InputError where 1,024 may be either."""
    cells = [(n, c.strip()) for n, row in rows for c in row if "," in c]
    commas = [(n, c) for n, c in cells if _COMMA.fullmatch(c)]
    if not commas:
        return False
    if any(not _THOUSANDS.fullmatch(c) for _, c in commas):
        return True
    line, cell = commas[0]
    raise InputError(
        path, f"line {line}", f"{cell} may be a decimal comma or thousands: write the numbers with a point"
    )


def _check(path: Path, headings: Sequence[str], line: int) -> None:
    if len(headings) > MOST_COLUMNS:
        raise InputError(
            path, f"line {line}", f"at most {MOST_COLUMNS} columns are read, found {len(headings)}"
        )
    used: set[str] = set()
    for i, name in enumerate(headings, start=1):
        if len(name) > LONGEST_HEADING:
            found = f"a heading of at most {LONGEST_HEADING} characters is expected, found {len(name)}"
            raise InputError(path, f"line {line}, column {i}", found)
        if name and name in used:
            raise InputError(path, f"line {line}, column {name!r}", "the heading stands there twice")
        used.add(name)
