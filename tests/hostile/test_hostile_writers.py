"""No name breaks out of the field it stands in: every writer against one list of hostile names."""

import html.parser
import io
import json
import re
import tomllib
import unicodedata

import lupa
import pytest
import typer
from case_table import case_table
from hostile_names import NAMES
from rich.table import Table

from coaxlink import files
from coaxlink.cli.shared.console import PlainConsole
from coaxlink.cli.shared.shell import console, run, say, talk
from coaxlink.errors import CheckFailed, InputError, LinkError, SafetyRefusal
from coaxlink.report.html import escape, html_table
from coaxlink.report.pictures.label import label
from coaxlink.tables.files import file_name
from firmware_params import ardupilot, px4
from firmware_params.ardupilot.scripts import matrix_script, script_factors
from firmware_params.errors import ParamsFileError, TableError
from firmware_params.reading import read_params
from sim.errors import SimulationError

FACTORS = [(-0.5, 0.5, 0.5, 1.0), (0.5, -0.5, 0.5, 0.9), (0.5, 0.5, -0.5, 1.0), (-0.5, -0.5, -0.5, 0.9)]


def harmless(text, lines=None):
    """Every character prints, and there are so many lines, where that is said."""
    body = text.removesuffix("\n")
    assert lines is None or body.count("\n") == lines - 1
    assert all(
        unicodedata.category(c)[0] not in "C" and c not in "\u2028\u2029" for c in body.replace("\n", "")
    )
    return True


def param_file(name, folder):
    path = folder / "x.param"
    ardupilot.write_param_file(path, {"SCR_ENABLE": 1.0}, [f"coaxlink bridge of {name}", name])
    rows = [line for line in re.split(r"[\r\n\v\f\x1c-\x1e\x85\u2028\u2029]", path.read_text()) if line]
    assert len(rows) == 3 and all(row.startswith("#") for row in rows[:2]) and rows[2] == "SCR_ENABLE,1"
    assert harmless(path.read_text(), 3)
    assert read_params(path).params == {"SCR_ENABLE": 1.0}


def params_file(name, folder):
    path = folder / "x.params"
    px4.write_params_file(path, {"CA_AIRFRAME": 0}, header=[f"Vehicle: {name}", name])
    assert harmless(path.read_text().replace("\t", " "), 3)
    assert read_params(path).params == {"CA_AIRFRAME": 0}


def parameter_of_that_name(name, folder):
    for write, value in ((ardupilot.write_param_file, 1.0), (px4.write_params_file, 1.0)):
        with pytest.raises(TableError, match="no name of a parameter") as error:
            write(folder / "x", {name: value})
        assert harmless(str(error.value), 1)
    assert list(folder.iterdir()) == []


def lua_of(text):
    """A script as Lua reads it: parsed whole, the comments gone."""
    lua = lupa.LuaRuntime(register_eval=False)
    assert lua.eval("load")(text.encode("utf-8", "backslashreplace").decode("latin-1")), text[:300]
    return [line for line in text.split("\n") if line and not line.startswith("--")]


def script(name, folder):
    plain, hostile = (matrix_script(FACTORS, title=title) for title in ("X8", f"{name}, fitted law"))
    assert lua_of(hostile) == lua_of(plain) and script_factors(hostile) == script_factors(plain)
    assert harmless(hostile, len(plain.split("\n")) - 1)


def toml(name, folder):
    files.write_toml(folder / "r.toml", {"name": name, "of": [{"file": name}], f"k{name}": 1})
    document = tomllib.loads((folder / "r.toml").read_text())
    assert document == files.read_toml(folder / "r.toml") and len(document) == 3
    assert harmless(document["name"], 1) and document["of"][0]["file"] == document["name"]


def json_file(name, folder):
    files.write_json(folder / "r.json", {"name": name, name: 1})
    raw = (folder / "r.json").read_bytes()
    assert raw.isascii() and not re.search(rb"[\x00-\x09\x0b-\x1f\x7f]", raw)
    assert json.loads(raw) == {"name": name, name: 1}


def tags(text):
    """Tags and their attributes as a browser takes them."""
    found = []
    page = html.parser.HTMLParser()
    page.handle_starttag = lambda tag, attributes: found.append((tag, [name for name, _ in attributes]))
    page.feed(text)
    page.close()
    return found


def page(name, folder):
    assert tags(html_table((name,), [(name,)])) == tags(html_table(("a",), [("b",)]))
    assert tags(f'<img alt="{escape(name)}">') == [("img", ["alt"])]
    assert harmless(escape(name))


def figure(name, folder):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(2, 1))
    FigureCanvasAgg(drawn)
    drawn.subplots().set_title(label(name))
    content = io.BytesIO()
    drawn.savefig(content, format="svg")  # a warning about a missing glyph would fail the test
    assert harmless(label(name), 1) and b"<script" not in content.getvalue()


def status_line(name, folder):
    screen = PlainConsole(file=io.StringIO(), width=20_000)
    with screen.status(f"reading {name}") as status:
        screen.print(status.renderable)
        status.update(f"[bold]{name}")
        screen.print(status.renderable)
    shown = screen.file.getvalue()
    assert harmless(shown) and "[bold]" in shown
    assert "[/red]" not in name or shown.count("[/red]") == 2


def errors(name, folder):
    for error in (
        InputError(name, name, name),
        CheckFailed(name),
        LinkError(name, name),
        SafetyRefusal(name),
        TableError(name),
        ParamsFileError(name, 3, name),
        SimulationError(name, name, name),
    ):
        assert harmless(str(error), 1) and len(str(error)) < 1100


def name_of_a_file(name, folder):
    made = file_name(name)
    file = folder / f"{made}.params"
    assert file.resolve().parent == folder.resolve()
    files.write_atomic(file, "x")
    assert [p.name for p in folder.iterdir()] == [f"{made}.params"]
    assert harmless(made, 1) and not made.startswith((".", "-"))


WRITERS = (
    param_file, params_file, parameter_of_that_name, script, toml, json_file, page, figure, status_line,
    errors, name_of_a_file,
)  # fmt: skip


@pytest.mark.slow
def test_no_writer_lets_a_name_out_of_its_field(tmp_path):
    with case_table() as case:
        for writer in WRITERS:
            for number, (what, name) in enumerate(NAMES.items()):
                folder = tmp_path / f"{writer.__name__}-{number}"
                folder.mkdir()
                with case(f"{writer.__name__}: {what}"):
                    writer(name, folder)


def test_the_terminal_prints_names_and_obeys_nothing(capsys):
    app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None)

    @app.command()
    def verb(number: int = 0) -> None: ...

    with case_table() as case:
        for what, name in NAMES.items():
            out = console()
            out.print(f"{name}: fitted law")
            table = Table(name or "x", title=name)
            table.add_row(name)
            out.print(table)
            say(f"wrote {name}")
            talk().print(name)
            printed = capsys.readouterr()
            with case(what):
                assert harmless(printed.out) and harmless(printed.err)
                for tag in ("[/red]", "[link=https://evil.example]", "[@click=app.quit]", ":warning:"):
                    if tag in name:
                        assert printed.out.count(tag) == 4 and printed.err.count(tag) == 2
                assert run(app, ["--number", name]) == 2
                error = capsys.readouterr().err
                assert error.startswith("coaxlink: ") and harmless(error, 1)
