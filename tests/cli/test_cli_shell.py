"""Every verb ends in a documented exit code and one line on stderr, never a traceback."""

import pytest
import typer

from coaxlink.cli._shell import run
from coaxlink.errors import CheckFailed, InputError, LinkError, SafetyRefusal


def shell(error):
    app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None)

    @app.command()
    def fail(number: int = 0) -> None:
        if error:
            raise error

    @app.command()
    def other() -> None: ...

    return app


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (CheckFailed("2 parameters differ"), 1, "coaxlink: 2 parameters differ"),
        (InputError("a.csv", "line 3", "a number expected"), 2, "coaxlink: a.csv: line 3: a number expected"),
        (LinkError("udpin:0.0.0.0:1", "no heartbeat"), 3, "coaxlink: udpin:0.0.0.0:1: no heartbeat"),
        (SafetyRefusal("armed"), 4, "coaxlink: refused: armed"),
        (KeyboardInterrupt(), 130, "coaxlink: interrupted"),
    ],
)
def test_errors_become_one_line_and_an_exit_code(capsys, error, code, line):
    assert run(shell(error), ["fail"]) == code
    assert capsys.readouterr().err == line + "\n"


@pytest.mark.parametrize("arguments", [["fail", "--number", "x"], ["nonsense"], ["fail", "--no-such"]])
def test_wrong_use_is_one_line_and_exit_2(capsys, arguments):
    assert run(shell(None), arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("coaxlink: ")
    assert error.count("\n") == 1


def test_success_is_zero(capsys):
    assert run(shell(None), ["fail"]) == 0
    assert capsys.readouterr().err == ""


def test_a_bug_is_said_to_be_one_and_kept_whole_in_a_file(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert run(shell(ZeroDivisionError("a\x1b[2J\nb")), ["fail"]) == 70
    error = capsys.readouterr().err
    (kept,) = tmp_path.iterdir()
    assert error == (
        "coaxlink: this is a fault of coaxlink, please report it: "
        f"ZeroDivisionError: a\\x1b[2J; details in {kept}\n"
    )
    assert "raise error" in kept.read_text()
