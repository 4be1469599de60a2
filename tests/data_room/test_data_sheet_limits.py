"""Workbooks that would take all memory, minutes or the reader's life to read: refused in one line."""

import io
import signal
import zipfile
from pathlib import Path

import pytest
from case_table import case_table
from workbook import workbook

from coaxlink.data import sheet, sheet_reader
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
    monkeypatch.setattr(sheet_reader, "MOST_CELLS", 20_000)
    monkeypatch.setattr(sheet_reader, "MOST_BYTES", 1 << 20)
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
            with case(name), pytest.raises(sheet_reader.SheetProblem, match=expected):
                sheet_reader.check_bounds(path)
    path.write_bytes(spoiled('<row r="900"><c r="A900"><v>2</v></c><c r="B900"><v>1</v></c></row>'))
    assert len(read_table(path).headings) == 2


def test_a_panic_of_the_reader_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class PanicException(BaseException):  # pyo3's name
        pass

    def panics(_path: str) -> None:
        raise PanicException("index out of\nbounds")

    path = tmp_path / "s.xlsx"
    path.write_bytes(workbook({"Data": ROWS}))
    monkeypatch.setattr(sheet_reader, "limit", lambda *_: None)
    monkeypatch.setattr("python_calamine.CalamineWorkbook.from_path", panics, raising=False)
    sheet_reader.main("1", "1", str(path))
    assert "not a spreadsheet that can be read (index out of bounds)" in capsys.readouterr().out


READER_THAT = {
    "takes all memory": "held = bytearray(2 << 30)",
    "takes all time": "while True: pass",
    "is killed": f"import os; os.kill(os.getpid(), {int(signal.SIGKILL)})",
    "dies": "import os; os.abort()",
    "says half": "print('{\"name\": ', end='', flush=True); import os; os._exit(3)",
}


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self").exists(), reason="where the system limits memory")
def test_a_reader_over_its_limits_or_dead_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, reader = tmp_path / "s.xlsx", tmp_path / "reader.py"
    path.write_bytes(workbook({"Data": ROWS}))
    own = Path(sheet_reader.__file__).read_text()
    monkeypatch.setattr(sheet_reader, "__file__", str(reader))
    monkeypatch.setattr(sheet, "MOST_S", 1)
    with case_table() as case:
        for what, does in READER_THAT.items():
            reader.write_text(own.replace("    check_bounds(path)\n", f"    {does}\n", 1))
            with case(what), pytest.raises(InputError, match="save the table as CSV") as caught:
                read_table(path)
            assert "\n" not in str(caught.value)
