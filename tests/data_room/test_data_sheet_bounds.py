"""Workbooks that would take all memory or minutes to read: refused in one line before they are opened."""

import io
import zipfile
from pathlib import Path

import pytest
from case_table import case_table
from workbook import workbook

from coaxlink.data import sheet_bounds
from coaxlink.data.table import read_table
from coaxlink.errors import InputError

ROWS = [["upper_rpm", "upper_thrust_N"], *([1000.0 + k, 10.0 + k] for k in range(12))]
ODS = (
    '<table:table table:name="a"><table:table-row><table:table-cell office:value="1"'
    ' table:number-columns-repeated="16384"/></table:table-row><table:table-row table:number-rows-repeated='
    '"1048576"><table:table-cell office:value-type="float" office:value="1"/></table:table-row></table:table>'
)


def spoiled(cells: str) -> bytes:
    """A sound workbook with more XML at its sheet's end."""
    out = io.BytesIO()
    sound = zipfile.ZipFile(io.BytesIO(workbook({"Data": ROWS})))
    with sound, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sound.namelist():
            text = sound.read(name).decode()
            archive.writestr(name, text.replace("</sheetData>", f"{cells}</sheetData>"))
    return out.getvalue()


def zipped(**parts: str) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in parts.items():
            archive.writestr(name.replace("_", "."), text)
    return out.getvalue()


def test_large_sheets_are_refused_before_they_are_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sheet_bounds, "MOST_CELLS", 20_000)
    monkeypatch.setattr(sheet_bounds, "MOST_BYTES", 1 << 20)
    path = tmp_path / "s.xlsx"
    with case_table() as case:
        for name, data, expected in (
            (
                "a cell far away",
                spoiled('<row><c r="XFD1048576"><v>1</v></c></row>'),
                "by 16384 columns or more",
            ),
            ("before one nearby", spoiled('<row><c r="XFD9"/><c r="A900000"/></row>'), "900000 rows"),
            (
                "a row far away",
                spoiled('<row r="1048576"><c><v>1</v></c></row>'),
                "1048576 rows by 2 columns",
            ),
            (
                "many rows",
                spoiled("<row><c><v>1</v></c></row>" * 10_001),
                "10014 rows by 2 columns or more",
            ),
            ("unpacked", spoiled(" " * (2 << 20)), "at most 1 MB unpacked"),
            ("repeated cells", zipped(content_xml=ODS), "1048577 rows by 16384 columns"),
            ("torn", workbook({"Data": ROWS})[:900], "not a spreadsheet that can be read"),
        ):
            path.write_bytes(data)
            with case(name), pytest.raises(InputError, match=expected) as caught:
                read_table(path)
            assert "\n" not in str(caught.value)
    path.write_bytes(spoiled('<row r="900"><c r="A900"><v>2</v></c><c r="B900"><v>1</v></c></row>'))
    assert len(read_table(path).headings) == 2


def test_a_panic_of_the_reader_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class PanicException(BaseException):  # pyo3's name
        pass

    def panics(_path: str) -> None:
        raise PanicException("index out of bounds")

    path = tmp_path / "s.xlsx"
    path.write_bytes(workbook({"Data": ROWS}))
    monkeypatch.setattr("python_calamine.CalamineWorkbook.from_path", panics, raising=False)
    with pytest.raises(InputError, match="index out of bounds"):
        read_table(path)
