"""How large a workbook becomes, told before it is opened: a few kB of zip may hold a sheet of 17,000 million
cells, and its reader makes room for the whole rectangle.

Cells are counted as the reader lays them out: rows by columns, to the last that is named or counted.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterator
from pathlib import Path

from coaxlink.errors import InputError

MOST_CELLS = 2_000_000  # a stand's hour at 10 Hz with 50 columns; ten seconds and 1 GB to read
MOST_BYTES = 256 << 20  # unpacked, all parts together; of XML a cell takes 40
MOST_PARTS = 1000
PIECE = 1 << 20
_XLSX = re.compile(rb"<(?:\w+:)?(row|c)(?=[\s/>])([^>]*)>")
_ODS = re.compile(rb"<table:table-(row|cell)(?=[\s/>])([^>]*)>")
_REFERENCE = re.compile(rb"""\br=["']([A-Za-z]*)(\d*)["']""")
_REPEATED = re.compile(rb"""number-(?:columns|rows)-repeated=["'](\d+)["']""")
_LONGEST_TAG = 1 << 16


def check_bounds(path: Path) -> None:
    """Raises InputError for a workbook that would take too much to read. What is no zip is left alone."""
    try:
        with zipfile.ZipFile(path) as archive:
            parts = archive.infolist()
            total = sum(part.file_size for part in parts)
            if total > MOST_BYTES or len(parts) > MOST_PARTS:
                problem = f"at most {MOST_BYTES >> 20} MB unpacked are read, found {total >> 20} MB"
                raise InputError(path, "", f"{problem} in {len(parts)} parts: save the table as CSV")
            for part in parts:
                name = part.filename
                if name.endswith(".bin") and name.startswith("xl/"):
                    raise InputError(path, "", "a binary workbook (xlsb): save it as xlsx or CSV")
                if name.startswith("xl/worksheets/"):
                    refuse_extent(path, name, *_xlsx_extent(_pieces(archive, name)))
                elif name == "content.xml":
                    refuse_extent(path, name, *_ods_extent(_pieces(archive, name)))
    except zipfile.BadZipFile as error:
        if path.read_bytes()[:2] == b"PK":
            raise InputError(path, "", f"not a spreadsheet that can be read ({error})") from error
    except (OSError, NotImplementedError, RuntimeError, EOFError) as error:  # encrypted, packed otherwise
        raise InputError(path, "", f"not a spreadsheet that can be read ({error})") from error


def refuse_extent(path: Path, where: str, rows: int, columns: int) -> None:
    """Raises InputError where a sheet of so many rows and columns is too large."""
    if rows * columns > MOST_CELLS:
        problem = (
            f"at most {MOST_CELLS} cells are read, found {rows} rows by {columns} columns or "
            "more: delete what stands far from the table, or save it as CSV"
        )
        raise InputError(path, where, problem)


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
