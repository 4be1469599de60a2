"""A workbook read within limits in a process of its own: `python sheet_reader.py BYTES SECONDS FILE [SHEET]`.

Run by its path with the standard library and python-calamine only (a sheet costs 50 ms, not the start of
coaxlink), so that a workbook which takes all memory, all time or its reader's life takes only this process.
On stdout one JSON object: `name` and `rows` of the chosen sheet, or `problem` with its `source` and `where`.

A few kB of zip may hold a sheet of 17,000 million cells, and its reader makes room for the whole rectangle:
cells are counted first, as the reader lays them out, rows by columns to the last that is named or counted.
"""

from __future__ import annotations

import contextlib
import json
import re
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

MOST_CELLS = 2_000_000  # a stand's hour at 10 Hz with 50 columns
MOST_BYTES = 256 << 20  # unpacked, all parts together; of XML a cell takes 40
MOST_LETTERS = 64_000_000  # of all cells: 32 each, and a number with all its digits has 18
MOST_PARTS = 1000
PIECE = 1 << 20
FEW = 6  # rows of numbers: no sheet with fewer can be identified from
UNREADABLE = "not a spreadsheet that can be read"
_XLSX = re.compile(rb"<(?:\w+:)?(row|c)(?=[\s/>])([^>]*)>")
_ODS = re.compile(rb"<table:table-(row|cell)(?=[\s/>])([^>]*)>")
_REFERENCE = re.compile(rb"""\br=["']([A-Za-z]*)(\d*)["']""")
_REPEATED = re.compile(rb"""number-(?:columns|rows)-repeated=["'](\d+)["']""")
_LONGEST_TAG = 1 << 16
Row = tuple[int, list[str]]


class SheetProblem(Exception):
    """What is wrong, where in the workbook, and with what if not with the file."""

    def __init__(self, problem: str, where: str = "", source: str = "") -> None:
        super().__init__(problem)
        self.problem, self.where, self.source = problem, where, source


def read(path: Path, name: str | None) -> tuple[str, list[Row]]:
    """The chosen sheet's name and its rows in which something stands. Raises SheetProblem."""
    from python_calamine import CalamineWorkbook

    check_bounds(path)
    book = CalamineWorkbook.from_path(str(path))
    names = list(book.sheet_names)
    if name is not None and name not in names:
        raise SheetProblem(f"'{name}' is not in {path.name} (found {', '.join(names)})", source="`sheet`")
    sheets = {n: _read(book, n) for n in ([name] if name else names)}
    counts = {n: _rows_of_numbers(rows) for n, rows in sheets.items()}
    full = [n for n in sheets if counts[n] >= FEW] or [n for n in sheets if counts[n]]
    if len(full) > 1:
        raise SheetProblem(f"several sheets hold numbers: name one with `sheet` ({', '.join(full)})")
    chosen = full[0] if full else next(iter(sheets), "")
    if not sheets.get(chosen):
        raise SheetProblem("empty: a heading line and rows of numbers are expected")
    return chosen, sheets[chosen]


def _read(book: Any, name: str) -> list[Row]:
    sheet = book.get_sheet_by_name(name)
    refuse_extent(f"sheet '{name}'", sheet.total_height, sheet.total_width)
    rows, letters = [], 0
    for i, cells in enumerate(sheet.to_python(skip_empty_area=False), start=1):
        if any(c not in ("", None) for c in cells):
            row = ["" if c is None else repr(c) if isinstance(c, float) else str(c) for c in cells]
            letters += sum(map(len, row))
            if letters > MOST_LETTERS:
                raise SheetProblem(f"at most {MOST_LETTERS} letters are read", f"sheet '{name}'")
            rows.append((i, row))
    return rows


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


def check_bounds(path: Path) -> None:
    """Raises SheetProblem for a workbook that would take too much to read. What is no zip is left alone."""
    try:
        with zipfile.ZipFile(path) as archive:
            parts = archive.infolist()
            total = sum(part.file_size for part in parts)
            if total > MOST_BYTES or len(parts) > MOST_PARTS:
                problem = f"at most {MOST_BYTES >> 20} MB unpacked are read, found {total >> 20} MB"
                raise SheetProblem(f"{problem} in {len(parts)} parts: save the table as CSV")
            for part in parts:
                name = part.filename
                if name.endswith(".bin") and name.startswith("xl/"):
                    raise SheetProblem("a binary workbook (xlsb): save it as xlsx or CSV")
                if name.startswith("xl/worksheets/"):
                    refuse_extent(name, *_xlsx_extent(_pieces(archive, name)))
                elif name == "content.xml":
                    refuse_extent(name, *_ods_extent(_pieces(archive, name)))
    except zipfile.BadZipFile as error:
        if path.read_bytes()[:2] == b"PK":
            raise SheetProblem(f"{UNREADABLE} ({error})") from error
    except (OSError, NotImplementedError, RuntimeError, EOFError) as error:  # encrypted, packed otherwise
        raise SheetProblem(f"{UNREADABLE} ({error})") from error


def refuse_extent(where: str, rows: int, columns: int) -> None:
    """Raises SheetProblem where a sheet of so many rows and columns is too large."""
    if rows * columns > MOST_CELLS:
        problem = (
            f"at most {MOST_CELLS} cells are read, found {rows} rows by {columns} columns or "
            "more: delete what stands far from the table, or save it as CSV"
        )
        raise SheetProblem(problem, where)


def _pieces(archive: zipfile.ZipFile, name: str) -> Iterator[bytes]:
    """A part's XML in pieces that end between tags."""
    rest = b""
    with archive.open(name) as stream:
        while piece := stream.read(PIECE):
            text = rest + piece
            cut = text.rfind(b"<")
            if len(text) - cut > _LONGEST_TAG:
                cut = len(text)
            yield text[:cut]
            rest = text[cut:]
    yield rest


def _xlsx_extent(pieces: Iterator[bytes]) -> tuple[int, int]:
    """Rows and columns; a row or cell without a reference follows the one before."""
    row = column = rows = columns = 0
    for piece in pieces:
        for tag, attributes in _XLSX.findall(piece):
            named = _REFERENCE.search(attributes) if attributes else None
            letters, digits = named.groups() if named else (b"", b"")
            if tag == b"row":
                row, column = int(digits[:9]) if digits else row + 1, 0
            else:
                column = _column(letters) if letters else column + 1
                row = int(digits[:9]) if digits else row
            if row > rows:
                rows = row
            if column > columns:
                columns = column
        if rows * columns > MOST_CELLS:
            break
    return rows, columns


def _column(letters: bytes) -> int:
    number = 0
    for letter in letters[:7].upper():
        number = 26 * number + letter - 64
    return number


def _ods_extent(pieces: Iterator[bytes]) -> tuple[int, int]:
    """Rows and columns to the last in which something stands: repeated empty ones fill every such sheet."""
    rows = columns = before = repeated = column = 0  # rows before this one, and how often it stands there
    for piece in pieces:
        for tag, attributes in _ODS.findall(piece):
            found = _REPEATED.search(attributes)
            count = int(found[1][:9]) if found else 1
            if tag == b"row":
                before, repeated, column = before + repeated, count, 0
                continue
            column += count
            if b"value" in attributes or not attributes.rstrip().endswith(b"/"):
                rows, columns = max(rows, before + repeated), max(columns, column)
    return rows, columns


def limit(most_bytes: int, seconds: int) -> None:
    """Let this process have so much memory and processor time; where the system has no such limits, all."""
    with contextlib.suppress(ImportError, OSError, ValueError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
        resource.setrlimit(resource.RLIMIT_AS, (most_bytes, most_bytes))


def main(most_bytes: str, seconds: str, file: str, sheet: str | None = None) -> None:
    limit(int(most_bytes), int(seconds))
    try:
        name, rows = read(Path(file), sheet)
        answer = json.dumps({"name": name, "rows": rows})
    except SheetProblem as error:
        answer = json.dumps({"problem": error.problem, "where": error.where, "source": error.source})
    except MemoryError:
        raise  # the caller says what the limit is
    except BaseException as error:  # a panic of the reader, written in Rust, is no Exception
        text = " ".join(str(error).split())[:120] or type(error).__name__
        answer = json.dumps({"problem": f"{UNREADABLE} ({text})", "where": "", "source": ""})
    sys.stdout.write(answer)


if __name__ == "__main__":
    main(*sys.argv[1:])
