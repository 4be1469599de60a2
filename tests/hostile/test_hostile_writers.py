"""No name breaks out of the field it stands in: every writer against one list of hostile names."""

import dataclasses
import html.parser
import io
import json
import re
import tomllib
import unicodedata

import lupa
import pytest
from hostile_names import NAMES
from rich.table import Table

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.cli.shared.console import PlainConsole
from coaxlink.cli.shared.shell import console, run, say, talk
from coaxlink.errors import CheckFailed, InputError, LinkError, SafetyRefusal
from coaxlink.live.scripts.onboard import onboard_script
from coaxlink.report.html import escape, html_table
from coaxlink.report.pictures.label import label
from coaxlink.rotor import load_rotor_model
from coaxlink.tables.files import file_name
from coaxlink.vehicle import Vehicle
from firmware_params import ardupilot, px4
from firmware_params.ardupilot.scripts import matrix_script, script_factors
from firmware_params.errors import ParamsFileError, TableError
from sim.errors import WorldError

each = pytest.mark.parametrize("name", NAMES.values(), ids=NAMES.keys())
FACTORS = [(-0.5, 0.5, 0.5, 1.0), (0.5, -0.5, 0.5, 0.9), (0.5, 0.5, -0.5, 1.0), (-0.5, -0.5, -0.5, 0.9)]


def harmless(text, lines=1):
    """Every character prints, and there are so many lines."""
    body = text.removesuffix("\n")
    assert body.count("\n") == lines - 1
    assert all(
        unicodedata.category(c)[0] not in "C" and c not in "\u2028\u2029" for c in body.replace("\n", "")
    )
    return True


@each
def test_a_param_file_holds_its_parameters_and_no_other(tmp_path, name):
    path = tmp_path / "x.param"
    ardupilot.write_param_file(path, {"SCR_ENABLE": 1.0}, [f"coaxlink bridge of {name}", name])
    rows = [line for line in re.split(r"[\r\n\v\f\x1c-\x1e\x85\u2028\u2029]", path.read_text()) if line]
    assert len(rows) == 3 and all(row.startswith("#") for row in rows[:2]) and rows[2] == "SCR_ENABLE,1"
    assert harmless(path.read_text(), 3)
    assert ardupilot.read_param_file(path).params == {"SCR_ENABLE": 1.0}


@each
def test_a_params_file_holds_its_parameters_and_no_other(tmp_path, name):
    path = tmp_path / "x.params"
    px4.write_params_file(path, {"CA_AIRFRAME": 0}, header=[f"Vehicle: {name}", name])
    assert harmless(path.read_text().replace("\t", " "), 3)
    assert px4.read_params_file(path).params == {"CA_AIRFRAME": 0}


@each
def test_no_parameter_has_such_a_name(tmp_path, name):
    for write, value in ((ardupilot.write_param_file, 1.0), (px4.write_params_file, 1.0)):
        with pytest.raises(TableError, match="no name of a parameter") as error:
            write(tmp_path / "x", {name: value})
        assert harmless(str(error.value))
    assert list(tmp_path.iterdir()) == []


def lua_of(text, **known):
    """A script as Lua reads it: parsed whole, the comments gone."""
    lua = lupa.LuaRuntime(register_eval=False)
    assert lua.eval("load")(text.encode("utf-8", "backslashreplace").decode("latin-1")), text[:300]
    return [line for line in text.split("\n") if line and not line.startswith("--")]


@each
def test_a_matrix_script_is_the_same_but_for_its_comment(name):
    plain, hostile = (matrix_script(FACTORS, title=title) for title in ("X8", f"{name}, fitted law"))
    assert lua_of(hostile) == lua_of(plain)
    assert script_factors(hostile) == script_factors(plain)
    assert harmless(hostile, len(plain.split("\n")) - 1)


@pytest.fixture(scope="module")
def vehicle():
    frame = load_airframe(files.example("x8_paper.toml"))
    model = load_rotor_model(frame.rotor_model)
    return frame, model, onboard_script(Vehicle(frame, model))


@each
def test_an_onboard_script_is_the_same_but_for_its_comment(vehicle, name):
    frame, model, plain = vehicle
    hostile = onboard_script(Vehicle(dataclasses.replace(frame, name=name), model))
    assert lua_of(hostile) == lua_of(plain)


@each
def test_toml_comes_back_plain(tmp_path, name):
    files.write_toml(tmp_path / "r.toml", {"name": name, "of": [{"file": name}], f"k{name}": 1})
    document = tomllib.loads((tmp_path / "r.toml").read_text())
    assert document == files.read_toml(tmp_path / "r.toml")
    assert len(document) == 3
    assert harmless(document["name"]) and document["of"][0]["file"] == document["name"]


@each
def test_json_is_ascii_and_comes_back(tmp_path, name):
    files.write_json(tmp_path / "r.json", {"name": name, name: 1})
    raw = (tmp_path / "r.json").read_bytes()
    assert raw.isascii() and not re.search(rb"[\x00-\x09\x0b-\x1f\x7f]", raw)
    assert json.loads(raw) == {"name": name, name: 1}


class Page(html.parser.HTMLParser):
    """Tags and text as a browser takes them."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.text = [], ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_data(self, data):
        self.text += data


@each
def test_html_is_text_to_a_browser(name):
    plain = Page(html_table(("a",), [("b",)]))
    assert [t for t, _ in Page(html_table((name,), [(name,)])).tags] == [t for t, _ in plain.tags]
    (image,) = Page(f'<img alt="{escape(name)}">').tags
    assert list(image[1]) == ["alt"]
    assert harmless(escape(name), escape(name).count("\n") + 1)


@each
def test_a_figure_draws_it(name):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(2, 1))
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    axis.set_xlabel(label(name))
    axis.set_title(label(name))
    for format in ("png", "svg"):
        content = io.BytesIO()
        figure.savefig(content, format=format)  # a warning about a missing glyph would fail the test
    assert harmless(label(name)) and b"<script" not in content.getvalue()


@each
def test_the_terminal_prints_it_and_obeys_nothing(capsys, name):
    out = console()
    out.print(f"{name}: fitted law")
    table = Table(name or "x", title=name)
    table.add_row(name)
    out.print(table)
    say(f"wrote {name}")
    talk().print(name)
    captured = capsys.readouterr()
    for text in (captured.out, captured.err):
        assert harmless(text, text.removesuffix("\n").count("\n") + 1)
    for tag in ("[/red]", "[link=https://evil.example]", "[@click=app.quit]", ":warning:"):
        if tag in name:
            assert captured.out.count(tag) == 4 and captured.err.count(tag) == 2


@each
def test_a_status_line_shows_it(name):
    screen = PlainConsole(file=io.StringIO(), width=20_000)
    with screen.status(f"reading {name}") as status:
        screen.print(status.renderable)
        status.update(f"[bold]{name}")
        screen.print(status.renderable)
    shown = screen.file.getvalue()
    assert harmless(shown, shown.removesuffix("\n").count("\n") + 1)
    assert "[bold]" in shown and ("[/red]" not in name or shown.count("[/red]") == 2)


@each
@pytest.mark.parametrize(
    "error",
    [
        lambda n: InputError(n, n, n),
        lambda n: CheckFailed(n),
        lambda n: LinkError(n, n),
        lambda n: SafetyRefusal(n),
        lambda n: TableError(n),
        lambda n: ParamsFileError(n, 3, n),
        lambda n: WorldError(n, n, n),
    ],
)
def test_an_error_is_one_line(name, error):
    assert harmless(str(error(name))) and len(str(error(name))) < 1100


@each
def test_a_wrong_option_is_one_line(capsys, name):
    import typer

    app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None)

    @app.command()
    def verb(number: int = 0) -> None: ...

    assert run(app, ["--number", name]) == 2
    error = capsys.readouterr().err
    assert error.startswith("coaxlink: ") and harmless(error)


@each
def test_a_name_of_a_file_stays_in_its_folder(tmp_path, name):
    made = file_name(name)
    file = tmp_path / "out" / f"{made}.params"
    assert file.resolve().parent == (tmp_path / "out").resolve()
    files.write_atomic(file, "x")
    assert [p.name for p in (tmp_path / "out").iterdir()] == [f"{made}.params"]
    assert harmless(made) and not made.startswith((".", "-"))
