"""Eighty columns: no word of a table is cut, and what is nothing but a solver's rounding is shown as 0."""

import io
import itertools
import re
import sys
from pathlib import Path

import pytest
from rich.cells import cell_len
from rich.table import Table

from coaxlink import files
from coaxlink.cli import build_app
from coaxlink.cli.shared import console as consoles
from coaxlink.cli.shared.shell import PIPE_WIDTH, console, figure, run

LINES = re.compile(r"[\s│┃┏┓┗┛┡┩├┤└┘─━┼╇┬┴╞╡═╪]+")
TINY = re.compile(r"\d(?:\.\d+)?e-\d+")
TINIER = re.compile(r"\d(?:\.\d+)?e-(?:0[6-9]|[1-9]\d)")
BROKEN = re.compile(r"(?:\.\.|±)\s*(?:│|$)", re.MULTILINE)  # an interval whose end stands below
NAMES = (
    "x8_demo.toml",
    "x8_paper.toml",
    "mixed_hexa.toml",
    "rotor_paper.toml",
    "limits.toml",
    "stand_eq17.csv",
)
X8, PAPER, HEXA, ROTOR, LIMITS, STAND = (str(files.example(n)) for n in NAMES)
SHEET = "rpm,thrust [N],power [W]\n" + "".join(
    f"{n},{n * n / 1e6},{n**3 / 3e8}\n" for n in range(1000, 6000, 500)
)
CAMPAIGN = """
flights = 12
laws = ["standard", "reduced", "fitted", "exact"]
seconds = 12
settle_s = 1
airframe = "x8_demo.toml"
mass_share = { low = 0.9, high = 1.1 }
[effects.wind]
size = { low = 0.0, high = 6.0 }
"""


class Terminal(io.StringIO):
    """A screen, as far as anybody asks."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def screens(monkeypatch):
    """What a verb prints, on a screen of 80 columns and on one that is wide enough for all."""
    narrow, wide = (consoles.PlainConsole(width=w, file=io.StringIO()) for w in (80, 2000))
    show = consoles.PlainConsole.print

    def both(_, *objects, **options):
        for screen in (narrow, wide):
            show(screen, *objects, **options)

    monkeypatch.setenv("COLUMNS", "80")

    monkeypatch.setattr(consoles.PlainConsole, "print", both)

    def said():
        texts = narrow.file.getvalue(), wide.file.getvalue()
        narrow.file, wide.file = io.StringIO(), io.StringIO()  # what comes next is looked at alone
        return texts

    return said


def held(screens, *, tiny: re.Pattern[str] = TINY) -> None:
    """What both screens say, without a cut word, a broken interval or a solver's rounding."""
    narrow, wide = screens()
    assert wide.strip(), "nothing was printed"
    assert set(LINES.split(narrow)) <= set(LINES.split(wide))
    assert not tiny.findall(wide)
    assert "\N{HORIZONTAL ELLIPSIS}" not in narrow
    assert not BROKEN.findall(narrow)
    assert all(cell_len(text) <= 80 for text in narrow.splitlines())


@pytest.mark.parametrize(
    "line",
    [
        ["compare", X8, "--rotor", ROTOR],
        ["compare", HEXA, "--battery-wh", "700"],
        ["table", X8, "--firmware", "px4", "--explain"],
        ["table", X8, "--firmware", "ardupilot", "--frame-class", "17", "--explain"],
        ["table", X8, "--firmware", "px4", "--constrain", LIMITS],
        ["allocate", X8, "--law", "exact", "--wrench", "196.2,1,1,0.5"],
        ["allocate", X8, "--law", "coaxial", "--wrench", "90,0,0,0"],
        ["airframe", X8],
        ["airframe", HEXA],
        ["init", "my.toml", "--template", "hexa-coax", "--mass", "18", "--arm", "0.4", "--spacing", "0.1"],
        ["identify", STAND],
        ["identify", STAND, "--form", "surface", "--physical"],
        ["identify", "--single", "sheet.csv", "--diameter", "0.4", "--pitch", "0.135", "--spacing", "0.1"],
    ],
    ids=lambda line: "-".join(word for word in line if "/" not in word and "." not in word),
)
def test_a_narrow_screen_has_the_words_of_a_wide_one(line, screens, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sheet.csv").write_text(SHEET)
    assert run(build_app(), line) == 0
    held(screens)


def test_the_list_of_examples(screens, monkeypatch):
    monkeypatch.setattr(sys, "stdout", Terminal())
    assert run(build_app(), ["examples"]) == 0
    held(screens)


def test_what_a_stand_lacks(screens, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    truth = str(files.example("truth_stand_spacing.toml"))
    assert run(build_app(), ["sim", "--stand", "log.csv", "--truth", truth, "--seed", "2"]) == 0
    assert run(build_app(), ["refine", "log.csv", "--rotor", ROTOR]) == 0
    held(screens)


def test_a_campaign_and_its_flights(screens, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.toml").write_text(CAMPAIGN)
    assert run(build_app(), ["campaign", "c.toml", "--workers", "1"]) == 0
    held(screens, tiny=TINIER)  # a share of the time may be 0.00005
    assert run(build_app(), ["campaign", "c.toml", "--replay", "0"]) == 0
    log = "campaign-c/cell-000000000/flight.csv"
    of = ["--airframe", X8, "--rotor", ROTOR]
    for line in (
        ["health", log, *of],
        ["health", log, log, *of],
        ["refine", log, *of],
        ["identify", log, *of],
    ):
        assert run(build_app(), line) in (0, 1)
        held(screens)


def test_what_is_on_board(screens, here, board):
    line = ["--connect", board.url]
    for verb in (
        ["upload", "t", "--dry-run"],
        ["upload", "t", "--yes"],
        ["verify", "t"],
        ["monitor", "--once"],
    ):
        assert run(build_app(), [*verb, *line]) == 0
        held(screens)
    assert run(build_app(), ["table", PAPER, "--firmware", "px4", "--explain", "--out", "new", *line]) == 0
    assert run(build_app(), ["verify", "new", *line]) == 1
    backup = next(Path("backups").glob("*.params"))
    assert run(build_app(), ["restore", str(backup), "--yes", *line]) == 0
    held(screens)


def test_every_verb_that_prints_a_table_is_here_or_flies_for_long():
    source = Path(__file__).read_text()
    long = {"demo", "loop", "reproduce", "fly", "mix"}  # their tables were looked at by hand
    silent = {"bridge"}  # writes files, prints no table
    verbs = {c.name for c in build_app().registered_commands}
    assert {v for v in verbs if f'["{v}"' not in source} == long | silent


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
