"""Tables as stands, spreadsheets and loggers write them: layout, encoding, marks, size."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from stand_files import sheet

from coaxlink.data.layout import HEAD, Row
from coaxlink.data.table import _Body, read_headings, read_table
from coaxlink.errors import InputError

ROWS = [[1000.5, -2.25], [2000.0, 9.0], [3000.25, 20.125]]


def write(folder: Path, data: bytes, name: str = "log.csv") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def text(mark: str = ",", end: str = "\n", comma: bool = False, head: tuple[str, ...] = ()) -> str:
    cells = [[str(x).replace(".", ",") if comma else str(x) for x in row] for row in ROWS]
    lines = [*head, mark.join(["rpm", "thrust (N)"]), *(mark.join(row) for row in cells)]
    return end.join(lines) + end


def check(path: Path) -> None:
    table = read_table(path)
    assert table.headings == ("rpm", "thrust (N)") == read_headings(path)
    np.testing.assert_array_equal(np.stack([table.numbers(0), table.numbers(1)], axis=1), ROWS)


@pytest.mark.parametrize("mark", [",", ";", "\t", "|", " "])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_delimiters_and_line_ends(tmp_path: Path, mark: str, end: str) -> None:
    content = text(mark, end).replace("thrust (N)", "thrust_N")
    table = read_table(write(tmp_path, content.encode()))
    assert table.headings == ("rpm", "thrust_N")
    assert table.numbers(1).tolist() == [r[1] for r in ROWS] and table.lines.tolist() == [2, 3, 4]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
def test_encodings(tmp_path: Path, encoding: str) -> None:
    content = text().replace("rpm", "Drehzahl (1/min) \u00b5")
    table = read_table(write(tmp_path, content.encode(encoding)))
    assert table.headings[0] == "Drehzahl (1/min) \u00b5" and table.numbers(1).tolist()[1] == 9.0


@pytest.mark.parametrize("mark", [";", "\t"])
def test_decimal_commas(tmp_path: Path, mark: str) -> None:
    check(write(tmp_path, text(mark, comma=True).encode()))
    assert "decimal comma" in " ".join(read_table(tmp_path / "log.csv").notes)


def test_a_decimal_comma_in_quotes_and_points_between_thousands(tmp_path: Path) -> None:
    rows = '"1.000,5","-2,25"\n"2.000,0","9,0"\n'
    table = read_table(write(tmp_path, f"rpm,T\n{rows}".encode()))
    assert table.numbers(0).tolist() == [1000.5, 2000.0] and table.numbers(1).tolist() == [-2.25, 9.0]


def test_a_comma_that_may_be_either_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"line 2: 1,024 may be a decimal comma or thousands"):
        read_table(write(tmp_path, b"rpm;thrust\n1,024;3,500\n2,048;9,125\n"))


def test_preamble_comments_units_blank_lines_and_repeated_headings(tmp_path: Path) -> None:
    content = (
        'Test stand 7, 15" propeller\n# operator: nobody\n\nrpm,thrust (N)\n[1/min],[N]\n1000.5,-2.25\n\n,\n'
        "// a pause\n2000,9\nrpm,thrust (N)\n[1/min],[N]\n% again\n3000.25,20.125\n"
    )
    check(write(tmp_path, content.encode()))
    table = read_table(tmp_path / "log.csv")
    assert table.units == ("1/min", "N") and table.lines.tolist() == [6, 10, 14]
    said = " ".join(table.notes)
    assert "repeated on 2" in said and "2 lines of comment" in said and "units on line 5" in said


def test_headings_in_a_comment(tmp_path: Path) -> None:
    check(write(tmp_path, ("# " + text()).encode()))  # as numpy.savetxt writes them


def test_group_headings_over_the_headings(tmp_path: Path) -> None:
    content = "Upper,,Lower,\nrpm,N,rpm,N\n1000,3,1100,2\n"
    assert read_table(write(tmp_path, content.encode())).headings == (
        "Upper rpm",
        "Upper N",
        "Lower rpm",
        "Lower N",
    )


def test_a_heading_over_two_lines_in_quotes(tmp_path: Path) -> None:
    content = '"rpm","thrust\n(N)"\n' + "".join(f"{a},{b}\n" for a, b in ROWS)
    check(write(tmp_path, content.encode()))
    assert read_table(tmp_path / "log.csv").lines.tolist() == [3, 4, 5]


def test_text_columns_and_gaps_keep_their_place(tmp_path: Path) -> None:
    content = "rpm,message,gap,late\n" + "".join(f"{i},ok,,{'' if i < 9000 else 7}\n" for i in range(12000))
    table = read_table(write(tmp_path, content.encode()))
    assert table.numbers(0)[-1] == 11999 and table.numbers_or_none(1) is None
    assert table.column_is_empty(2) and not table.column_is_empty(3)
    with pytest.raises(InputError, match=r"line 2, column 'late': a number is expected, found an empty cell"):
        table.numbers(3)


def test_fast_and_slow_ways_agree(tmp_path: Path) -> None:
    random = np.random.default_rng(1).normal(size=(3000, 4)) * 1e3
    lines = [",".join(f"{x:.7g}" for x in row) for row in random]
    plain = read_table(write(tmp_path, ("a,b,c,d\n" + "\n".join(lines)).encode()))
    lines[1500] = ",".join(f'"{x}"' for x in lines[1500].split(","))  # quotes: cell by cell
    quoted = read_table(write(tmp_path, ("a,b,c,d\n" + "\n".join(lines)).encode(), "q.csv"))
    for i in range(4):
        np.testing.assert_array_equal(plain.numbers(i), quoted.numbers(i))


def test_progress_runs_from_begin_to_end(tmp_path: Path) -> None:
    shares: list[float] = []
    row = b"1234.5,6789.25,12.125,0.5\n"
    read_table(write(tmp_path, b"a,b,c,d\n" + row * 800_000), shares.append)
    assert len(shares) >= 3 and shares == sorted(shares) and shares[-1] == 1.0


def test_spreadsheets(tmp_path: Path) -> None:
    rows: list[list[object]] = [["Stand 3"], ["rpm", "thrust (N)"], *ROWS]
    many = [*rows[:2], *([ROWS[1]] * 8)]
    check(sheet(tmp_path / "a.xlsx", {"Notes": [["nothing"]], "Data": rows}))
    two = sheet(tmp_path / "b.xlsx", {"One": many, "Two": many})
    with pytest.raises(InputError, match=r"several sheets hold numbers: name one with `sheet` \(One, Two\)"):
        read_table(two)
    assert read_table(two, sheet="Two").notes[-1] == "sheet 'Two'"
    with pytest.raises(InputError, match=r"`sheet`: 'Three' is not in b.xlsx"):
        read_table(two, sheet="Three")
    (tmp_path / "c.xlsx").write_bytes(two.read_bytes()[:300])
    with pytest.raises(InputError, match="not a spreadsheet that can be read"):
        read_table(tmp_path / "c.xlsx")


@pytest.mark.parametrize(
    "data, expected",
    [
        (b"\xff\xfe\x00\x9f", "not text"),
        (b"rpm,T\n1,\x002\n", "control code"),
        (b'rpm,T\n"1,2\n3,4\n', "line 2: a quote opens that never closes"),
        (b"rpm,T\nnone,nothing\n", "no rows of numbers"),
        (b"x" * 201 + b",b\n1,2\n", "line 1, column 1: a heading of at most 200"),
        (",".join(f"c{i}" for i in range(2001)).encode() + b"\n" + b"1," * 2001 + b"\n", "at most 2000"),
    ],
)
def test_what_is_no_table_is_one_line(tmp_path: Path, data: bytes, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        read_table(write(tmp_path, data))
    assert expected in str(caught.value) and "\n" not in str(caught.value)


def test_numbers_are_not_read_cell_by_cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A gigabyte is only read in time if the rows behind the first ones go through numpy."""
    slow: list[int] = []
    original = _Body.take_rows

    def counted(self: _Body, rows: Iterable[Row]) -> None:
        taken = list(rows)
        slow.append(len(taken))
        original(self, taken)

    monkeypatch.setattr(_Body, "take_rows", counted)
    rows = "".join(f"{i},{i / 7:.5f},,ok\n" for i in range(50_000))
    table = read_table(write(tmp_path, f"a,b,gap,message\n{rows}".encode()))
    assert len(table.lines) == 50_000 and table.numbers(0)[-1] == 49_999 and sum(slow) <= 2 * HEAD
