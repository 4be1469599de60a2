"""Eighty columns: no word of a table is cut, and what is nothing but a solver's rounding is shown as 0."""

import io
import re

import pytest
from rich.cells import cell_len
from rich.table import Table

from coaxlink import files
from coaxlink.cli import build_app
from coaxlink.cli.shared import console as consoles
from coaxlink.cli.shared.shell import PIPE_WIDTH, console, figure, run

LINES = re.compile(r"[\s│┃┏┓┗┛┡┩├┤└┘─━┼╇┬┴╞╡═╪]+")
TINY = re.compile(r"\d(?:\.\d+)?e-\d+")
BROKEN = re.compile(r"(?:\.\.|±)\s*(?:│|$)", re.MULTILINE)  # an interval whose end stands below
NAMES = ("x8_demo.toml", "rotor_paper.toml", "stand_eq17.csv")
X8, ROTOR, STAND = (str(files.example(n)) for n in NAMES)
REPORTED = [
    ["compare", X8, "--rotor", ROTOR, "--rows", "20"],
    ["table", X8, "--firmware", "px4"],
    ["table", X8, "--firmware", "ardupilot", "--frame-class", "17"],
    ["allocate", X8, "--law", "exact", "--wrench", "196.2,1,1,0.5"],
    ["airframe", X8],
    ["identify", STAND, "--form", "rcrm", "--max-order", "2"],
    ["refine", STAND, "--rotor", ROTOR],
]


@pytest.mark.slow
def test_a_narrow_screen_has_the_words_of_a_wide_one(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    show, failed = consoles.PlainConsole.print, {}
    for line in REPORTED:
        narrow, wide = (consoles.PlainConsole(width=w, file=io.StringIO()) for w in (80, 2000))

        def both(_, *objects, screens=(narrow, wide), **options):
            for screen in screens:
                show(screen, *objects, **options)

        monkeypatch.setattr(consoles.PlainConsole, "print", both)
        code = run(build_app(), line)
        monkeypatch.setattr(consoles.PlainConsole, "print", show)
        reported, whole = narrow.file.getvalue().replace(consoles.JOINED, " "), wide.file.getvalue()
        wrong = {
            "exit code": code,
            "cut words": set(LINES.split(reported)) - set(LINES.split(whole)),
            "rounding": TINY.findall(whole),
            "broken intervals": BROKEN.findall(reported),
            "long lines": [text for text in reported.splitlines() if cell_len(text) > 80],
            "nothing": not whole.strip(),
        }
        failed |= {" ".join(line): wrong} if any(wrong.values()) else {}
    assert not failed


def test_prose_breaks_between_words_and_not_inside_a_number_with_its_unit():
    console = consoles.PlainConsole(width=30, file=io.StringIO())
    console.print("the best constant gain leaves 3.60 N m of it, 95 % 0.0012 .. 0.0044, 2.0 ± 0.1")
    lines = console.file.getvalue().splitlines()
    assert all(len(line) <= 30 for line in lines)
    assert any("3.60 N m" in line for line in lines)
    assert any("0.0012 .. 0.0044" in line for line in lines) and any("2.0 ± 0.1" in line for line in lines)


def test_a_pipe_has_whole_rows_unless_columns_says_how_wide_it_is(monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    assert console().width == PIPE_WIDTH
    monkeypatch.setenv("COLUMNS", "80")
    assert console().width == 80


def test_columns_that_do_not_fit_stand_below_beside_the_first():
    names = [f"column_{n:02d}_of_many" for n in range(9)]
    table = Table("rotor", *names)
    table.add_row("1 upper", *(f"{n}.25" for n in range(9)))
    console = consoles.PlainConsole(width=80, file=io.StringIO())
    console.print(table)
    reported = console.file.getvalue()
    assert (
        all(name in reported for name in names) and reported.count("rotor") == reported.count("1 upper") > 1
    )
    assert max(map(len, reported.splitlines())) <= 80


def test_rounding_is_no_error():
    assert figure(6.53e-08) == "0" and figure(-4e-7) == "0"
    assert figure(0.00139) == "0.00139" and figure(-2.0, 2) == "-2"
