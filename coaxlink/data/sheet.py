"""Spreadsheets (xlsx, xls, ods) as rows of text cells; python-calamine is imported only when one is read."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

from coaxlink.data.layout import Row
from coaxlink.data.quiet import one_line, silenced
from coaxlink.data.sheet_bounds import check_bounds, refuse_extent
from coaxlink.errors import InputError

MAGIC = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1")  # zip (xlsx, ods), OLE (xls)
FEW = 6  # rows of numbers: no sheet with fewer can be identified from


def is_sheet(head: bytes) -> bool:
    """Whether a file that begins so is a spreadsheet."""
    return head.startswith(MAGIC)


def read_sheet(path: Path, name: str | None = None) -> tuple[list[Row], str]:
    """Rows in which something stands, and the sheet's name: the one requested, or the only one with numbers.

    Raises InputError: not a spreadsheet, no such sheet, several that have numbers.
    """
    from python_calamine import CalamineError, CalamineWorkbook

    check_bounds(path)
    try:
        with silenced():  # a panic of the reader, written in Rust, is told on stderr
            book = CalamineWorkbook.from_path(str(path))
            names = list(book.sheet_names)
            if name is not None and name not in names:
                raise InputError("`sheet`", "", f"'{name}' is not in {path.name} (found {', '.join(names)})")
            sheets = {n: _read(path, book, n) for n in ([name] if name else names)}
    except InputError:
        raise
    except (CalamineError, OSError, ValueError, MemoryError) as error:
        raise InputError(path, "", f"not a spreadsheet that can be read ({one_line(error)})") from error
    except BaseException as error:  # pyo3's PanicException is no Exception
        if type(error).__name__ != "PanicException":
            raise
        raise InputError(path, "", f"not a spreadsheet that can be read ({one_line(error)})") from error
    counts = {n: _rows_of_numbers(rows) for n, rows in sheets.items()}
    full = [n for n in sheets if counts[n] >= FEW] or [n for n in sheets if counts[n]]
    if len(full) > 1:
        raise InputError(path, "", f"several sheets hold numbers: name one with `sheet` ({', '.join(full)})")
    chosen = full[0] if full else next(iter(sheets), "")
    if not sheets.get(chosen):
        raise InputError(path, "", "empty: a heading line and rows of numbers are expected")
    return sheets[chosen], chosen


def _read(path: Path, book: Any, name: str) -> list[Row]:
    sheet = book.get_sheet_by_name(name)
    refuse_extent(path, f"sheet '{name}'", sheet.total_height, sheet.total_width)
    return _rows(sheet.to_python(skip_empty_area=False))


def _rows(cells: list[list[Any]]) -> list[Row]:
    return [
        (i, ["" if c is None else repr(c) if isinstance(c, float) else str(c) for c in row])
        for i, row in enumerate(cells, start=1)
        if any(c not in ("", None) for c in row)
    ]


def _rows_of_numbers(rows: list[Row]) -> int:
    """Rows with at least two numbers, as far as they tell: FEW at most."""
    found = 0
    for _, row in rows:
        numbers = 0
        for cell in row:
            with contextlib.suppress(ValueError):
                float(cell)
                numbers += 1
        found += numbers >= 2
        if found == FEW:
            break
    return found
