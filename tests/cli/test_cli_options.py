"""The library names parameters, the command line names options, and one table stands between them."""

import ast
import re
from pathlib import Path

import pytest
import typer
from case_table import case_table

import coaxlink
from coaxlink.cli import build_app
from coaxlink.cli.shared.options import OPTIONS, by_option

ROOT = Path(coaxlink.__file__).parent
OPTION = re.compile(r"(?<![\w<!-])--[a-z][a-z-]*(?![\w-]*:)")
NAMED = re.compile(r"`([a-z]\w*)`")
# no library: a stylesheet, the terminal program's own screen, a document that says which verb makes it
VERBS = ("cli/",)
NOT_LIBRARY = {
    "report/document.py",
    "report/demo_words.py",
    "monitor/screen/app.py",
    "monitor/screen/pages.py",
    "report/paper.py",
    "report/loop.py",
}


def texts(path):
    """Every string of a source file but its docstrings, with its line."""
    tree = ast.parse(path.read_text())
    reported = {
        id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in reported:
            yield node.lineno, node.value


def library():
    for path in sorted(ROOT.rglob("*.py")):
        name = path.relative_to(ROOT).as_posix()
        if not name.startswith(VERBS) and name not in NOT_LIBRARY:
            yield name, path


@pytest.mark.slow
def test_no_text_of_the_library_speaks_of_an_option():
    found = [
        f"{name}:{line}: {text}"
        for name, path in library()
        for line, text in texts(path)
        if OPTION.search(text) and not name.startswith("studies/")  # which start `coaxlink sim`
    ]
    assert not found, "\n".join(found)


@pytest.mark.slow
def test_every_parameter_that_a_text_names_has_its_option():
    named = {n for _, path in library() for _, text in texts(path) for n in NAMED.findall(text)}
    assert named - set(OPTIONS) == set()
    conditions = {"voltage_V", "height_m", "climb_m_s", "air_density_kg_m3"}  # put in by their names
    assert set(OPTIONS) - named - conditions == set()


def options_of(command):
    found = {name for p in command.params for name in getattr(p, "opts", ())}
    for other in getattr(command, "commands", {}).values():
        found |= options_of(other)
    return found


def test_every_option_in_the_table_is_one_of_a_verb():
    known = options_of(typer.main.get_command(build_app()))
    assert {o for text in OPTIONS.values() for o in re.findall(r"--[a-z-]+", text)} <= known


def test_a_verb_says_it_in_its_own_words():
    with case_table() as case:
        for reported, shown in (
            ("`upper`: rotor numbers are expected", "--upper: rotor numbers are expected"),
            ("a map states it (`columns`): x", "a map states it (--columns MAP.toml): x"),
            (
                "or `restore` my backups/b 1.json over udpin:127.0.0.1:14550",
                "or coaxlink restore my backups/b 1.json --connect udpin:127.0.0.1:14550",
            ),
            ("column `speed` of their file", "column `speed` of their file"),
        ):
            with case(f"{reported}, {shown}"):
                assert by_option(reported) == shown
