"""Eighty columns: no word of a table is cut, and what is nothing but a solver's rounding is shown as 0."""

import io
import itertools
import re

import pytest
from rich.table import Table

from coaxlink import files
from coaxlink.cli import build_app
from coaxlink.cli.shared import console as consoles
from coaxlink.cli.shared.shell import figure, run

LINES = re.compile(r"[\s│┃┏┓┗┛┡┩├┤└┘─━┼╇┬┴╞╡═╪]+")
TINY = re.compile(r"\d(?:\.\d+)?e-\d+")
X8, ROTOR = (str(files.example(n)) for n in ("x8_demo.toml", "rotor_paper.toml"))


@pytest.fixture
def screens(monkeypatch):
    """What a verb prints, on a screen of 80 columns and on one that is wide enough for all."""
    narrow, wide = (consoles.PlainConsole(width=w, file=io.StringIO()) for w in (80, 2000))
    show = consoles.PlainConsole.print

    def both(_, *objects, **options):
        for console in (narrow, wide):
            show(console, *objects, **options)

    monkeypatch.setattr(consoles.PlainConsole, "print", both)
    return lambda: (narrow.file.getvalue(), wide.file.getvalue())


@pytest.mark.parametrize(
    "line",
    [
        ["compare", X8, "--rotor", ROTOR],
        ["table", X8, "--firmware", "px4", "--explain"],
        ["allocate", X8, "--law", "exact", "--wrench", "196.2,1,1,0.5"],
        ["airframe", X8],
        ["examples"],
    ],
    ids=lambda line: "-".join(word for word in line if "/" not in word and "." not in word),
)
def test_a_narrow_screen_has_the_words_of_a_wide_one(line, screens, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(build_app(), line) == 0
    narrow, wide = screens()
    assert set(LINES.split(narrow)) <= set(LINES.split(wide))
    assert not TINY.findall(wide)
    if line[0] != "examples":  # lines that name a file stay in one piece
        tables = [text for text in narrow.splitlines() if re.search("[│┃━─]", text)]
        assert all(len(text) <= 80 for text in tables)


def test_columns_that_do_not_fit_stand_below_beside_the_first():
    names = [f"column_{n:02d}_of_many" for n in range(9)]
    table = Table("rotor", *names)
    table.add_row("1 upper", *(f"{n}.25" for n in range(9)))
    console = consoles.PlainConsole(width=80, file=io.StringIO())
    console.print(table)
    said = console.file.getvalue()
    assert all(name in said for name in names) and said.count("rotor") == said.count("1 upper") > 1
    assert max(map(len, said.splitlines())) <= 80


def test_rounding_is_no_error():
    assert figure(6.53e-08) == "0" and figure(-4e-7) == "0"
    assert figure(0.00139) == "0.00139" and figure(-2.0, 2) == "-2"


def test_a_table_of_one_column_wider_than_the_screen_ends() -> None:
    console = consoles.PlainConsole(width=80, file=io.StringIO())
    for columns in (1, 2, 3):
        table = Table(*(f"column {n}" for n in range(columns)))
        table.add_row(*("x" * 10_000 for _ in range(columns)))
        parts = list(itertools.islice(consoles.fitted(console, table), 9))
        assert 1 <= len(parts) <= columns
        assert all(sum(c.width or 0 for c in part.columns) <= 80 for part in parts if len(part.columns) > 1)
