"""Tables as stands, spreadsheets and loggers write them: layout, encoding, marks, size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from case_table import case_table
from workbook import workbook

from coaxlink.data.layout import HEAD
from coaxlink.data.table import _Body, read_headings, read_table
from coaxlink.errors import InputError

ROWS = [[1000.5, -2.25], [2000.0, 9.0], [3000.25, 20.125]]


def write(folder: Path, data: bytes | str, name: str = "log.csv") -> Path:
    path = folder / name
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def text(mark: str = ",", end: str = "\n", comma: bool = False) -> str:
    cells = [[str(x).replace(".", ",") if comma else str(x) for x in row] for row in ROWS]
    return end.join([mark.join(["rpm", "thrust_N"]), *(mark.join(row) for row in cells)]) + end


def check(path: Path) -> None:
    table = read_table(path)
    assert table.headings == ("rpm", "thrust_N") == read_headings(path)
    np.testing.assert_array_equal(np.stack([table.numbers(0), table.numbers(1)], axis=1), ROWS)


def test_delimiters_line_ends_and_encodings(tmp_path: Path) -> None:
    with case_table() as case:
        for mark in ",;\t| ":
            for end in ("\n", "\r\n", "\r"):
                with case(f"{mark!r} {end!r}"):
                    check(write(tmp_path, text(mark, end)))
                    assert read_table(tmp_path / "log.csv").lines.tolist() == [2, 3, 4]
        for encoding in ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"):
            with case(encoding):
                content = text().replace("rpm", "Drehzahl (1/min) \u00b5")
                table = read_table(write(tmp_path, content.encode(encoding)))
                assert table.headings[0] == "Drehzahl (1/min) \u00b5" and table.numbers(1)[1] == 9.0


def test_decimal_commas(tmp_path: Path) -> None:
    for mark in ";\t":
        check(write(tmp_path, text(mark, comma=True)))
        assert "decimal comma" in " ".join(read_table(tmp_path / "log.csv").notes)
    table = read_table(write(tmp_path, 'rpm,T\n"1.000,5","-2,25"\n"2.000,0","9,0"\n'))
    assert table.numbers(0).tolist() == [1000.5, 2000.0] and table.numbers(1).tolist() == [-2.25, 9.0]
    with pytest.raises(InputError, match=r"line 2: 1,024 may be a decimal comma or thousands"):
        read_table(write(tmp_path, "rpm;thrust\n1,024;3,500\n2,048;9,125\n"))


def test_preamble_comments_units_blank_lines_and_repeated_headings(tmp_path: Path) -> None:
    content = (
        'Test stand 7, 15" propeller\n# operator: nobody\n\nrpm,thrust_N\n[1/min],[N]\n1000.5,-2.25\n\n,\n'
        "// a pause\n2000,9\nrpm,thrust_N\n[1/min],[N]\n% again\n3000.25,20.125\n"
    )
    check(write(tmp_path, content))
    table = read_table(tmp_path / "log.csv")
    assert table.units == ("1/min", "N") and table.lines.tolist() == [6, 10, 14]
    reported = " ".join(table.notes)
    assert "repeated on 2" in reported and "2 lines of comment" in reported and "units on line 5" in reported


def test_headings_in_a_comment_under_a_group_or_over_two_lines(tmp_path: Path) -> None:
    check(write(tmp_path, f"# {text()}"))  # as numpy.savetxt writes them
    grouped = read_table(write(tmp_path, "Upper,,Lower,\nrpm,N,rpm,N\n1000,3,1100,2\n"))
    assert grouped.headings == ("Upper rpm", "Upper N", "Lower rpm", "Lower N")
    two = read_table(write(tmp_path, '"rpm","thrust\n(N)"\n' + "".join(f"{a},{b}\n" for a, b in ROWS)))
    assert two.headings == ("rpm", "thrust (N)") and two.lines.tolist() == [3, 4, 5]


def test_text_columns_and_gaps_keep_their_place(tmp_path: Path) -> None:
    content = "rpm,message,gap,late\n" + "".join(f"{i},ok,,{'' if i < 9000 else 7}\n" for i in range(12000))
    table = read_table(write(tmp_path, content))
    assert table.numbers(0)[-1] == 11999 and table.numbers_or_none(1) is None
    assert table.column_is_empty(2) and not table.column_is_empty(3)
    with pytest.raises(InputError, match=r"line 2, column 'late': a number is expected, found an empty cell"):
        table.numbers(3)


def test_a_last_row_that_is_cut_off_is_left_out_and_any_other_is_asked_about(tmp_path: Path) -> None:
    rows = [f"{n},{n * n},{n}.5" for n in range(1, 60)]
    table = read_table(write(tmp_path, "\n".join(["rpm,thrust_N,torque_Nm", *rows, "60,36"])))
    assert table.numbers(0).tolist() == list(range(1, 60)) and table.numbers(2)[-1] == 59.5
    assert table.lines[-1] == 60 and "line 61 is cut off, left out" in table.notes
    with pytest.raises(InputError, match="line 11: 3 columns are expected, found 2"):
        read_table(write(tmp_path, "\n".join(["rpm,thrust_N,torque_Nm", *rows[:9], "10,10", *rows[10:]])))
    with pytest.raises(InputError, match="line 2: 3 columns are expected, found 2"):
        read_table(write(tmp_path, "rpm,thrust_N,torque_Nm\n60,36"))


def test_a_quote_goes_over_the_end_of_a_piece(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("coaxlink.data.lines.PIECE", 64)
    rows = "".join(f'{i},"a\nb"\n' for i in range(1000))
    table = read_table(write(tmp_path, f"rpm,text\n{rows}"))
    assert table.numbers(0).tolist() == list(range(1000)) and table.lines[-1] == 2000


def test_fast_and_slow_ways_agree(tmp_path: Path) -> None:
    random = np.random.default_rng(1).normal(size=(3000, 4)) * 1e3
    lines = [",".join(f"{x:.7g}" for x in row) for row in random]
    plain = read_table(write(tmp_path, "\n".join(["a,b,c,d", *lines])))
    lines[1500] = ",".join(f'"{x}"' for x in lines[1500].split(","))  # quotes: cell by cell
    quoted = read_table(write(tmp_path, "\n".join(["a,b,c,d", *lines])))
    for i in range(4):
        np.testing.assert_array_equal(plain.numbers(i), quoted.numbers(i))


def test_progress_runs_from_begin_to_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("coaxlink.data.lines.PIECE", 4096)
    shares: list[float] = []
    read_table(write(tmp_path, "a,b,c,d\n" + "1234.5,6789.25,12.125,0.5\n" * 1000), shares.append)
    assert len(shares) >= 3 and shares == sorted(shares) and shares[-1] == 1.0


def test_spreadsheets(tmp_path: Path) -> None:
    rows: list[list[object]] = [["Stand 3"], ["rpm", "thrust_N"], *ROWS]
    many = [*rows[:2], *([ROWS[1]] * 8)]
    check(write(tmp_path, workbook({"Notes": [["nothing"]], "Data": rows}), "a.xlsx"))
    two = write(tmp_path, workbook({"One": many, "Two": many}), "b.xlsx")
    with pytest.raises(InputError, match=r"several sheets hold numbers: name one with `sheet` \(One, Two\)"):
        read_table(two)
    assert read_table(two, sheet="Two").notes[-1] == "sheet 'Two'"
    with pytest.raises(InputError, match=r"`sheet`: 'Three' is not in b.xlsx"):
        read_table(two, sheet="Three")
    with pytest.raises(InputError, match="not a spreadsheet that can be read"):
        read_table(write(tmp_path, two.read_bytes()[:300], "c.xlsx"))


NO_TABLES = {
    b"\xff\xfe\x00\x9f": "not text",
    b"rpm,T\n1,\x002\n": "control code",
    b'rpm,T\n"1,2\n3,4\n': "line 2: a quote opens that never closes",
    b"rpm,T\nnone,nothing\n": "no rows of numbers",
    b"x" * 201 + b",b\n1,2\n": "line 1, column 1: a heading of at most 200",
    ",".join(f"c{i}" for i in range(2001)).encode() + b"\n" + b"1," * 2001 + b"\n": "at most 2000",
}


def test_what_is_no_table_is_one_line(tmp_path: Path) -> None:
    with case_table() as case:
        for data, expected in NO_TABLES.items():
            with case(expected):
                with pytest.raises(InputError) as caught:
                    read_table(write(tmp_path, data))
                assert expected in str(caught.value) and "\n" not in str(caught.value)


def test_numbers_are_not_read_cell_by_cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A gigabyte is only read in time if the rows behind the first ones go through numpy."""
    slow: list[int] = []
    original = _Body._number
    monkeypatch.setattr(
        _Body, "_number", lambda self, row, *a: (slow.append(row), original(self, row, *a))[1]
    )
    rows = "".join(f"{i},{i / 7:.5f},,ok\n" for i in range(50_000))
    table = read_table(write(tmp_path, f"a,b,gap,message\n{rows}"))
    assert len(table.lines) == 50_000 and table.numbers(0)[-1] == 49_999 and max(slow) < 2 * HEAD
