"""Every verb ends in a documented exit code and one line on stderr, never a traceback."""

import os
import pkgutil
import shlex
import subprocess
import sys
import time
from pathlib import Path

import pytest
import shellingham
import typer
from case_table import case_table

import coaxlink
import coaxlink.cli
from coaxlink.airframe import load_airframe
from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run, say
from coaxlink.errors import CheckFailed, InputError, LinkError, SafetyRefusal
from coaxlink.files import example
from sim.vehicle import read_vehicle


def shell(error):
    app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None)

    @app.command()
    def fail(number: int = 0) -> None:
        if error:
            raise error

    @app.command()
    def other() -> None: ...

    return app


def test_errors_become_one_line_and_an_exit_code(capsys):
    with case_table() as case:
        for error, code, line in (
            (CheckFailed("2 parameters differ"), 1, "coaxlink: 2 parameters differ"),
            (
                InputError("a.csv", "line 3", "a number expected"),
                2,
                "coaxlink: a.csv: line 3: a number expected",
            ),
            (LinkError("udpin:0.0.0.0:1", "no heartbeat"), 3, "coaxlink: udpin:0.0.0.0:1: no heartbeat"),
            (SafetyRefusal("armed"), 4, "coaxlink: refused: armed"),
            (KeyboardInterrupt(), 130, "coaxlink: interrupted"),
        ):
            with case(f"{error}, {code}, {line}"):
                assert run(shell(error), ["fail"]) == code
                assert capsys.readouterr().err == line + "\n"


@pytest.mark.parametrize("arguments", [["fail", "--number", "x"], ["nonsense"], ["fail", "--no-such"]])
def test_wrong_use_is_one_line_and_exit_2(capsys, arguments):
    assert run(shell(None), arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("coaxlink: ")
    assert error.count("\n") == 1


def test_on_a_screen_a_remark_breaks_between_words_and_a_command_never(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "20")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    say("- rotor 6 lost a fifth of its thrust")
    say("next: coaxlink refine a.csv --airframe b.toml")
    assert capsys.readouterr().err.splitlines() == [
        "- rotor 6 lost a", "  fifth of its", "  thrust", "next: coaxlink refine a.csv --airframe b.toml"
    ]  # fmt: skip


def test_success_is_zero(capsys):
    assert run(shell(None), ["fail"]) == 0
    assert capsys.readouterr().err == ""


def test_a_bug_is_said_to_be_one_and_kept_whole_in_a_file(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert run(shell(ZeroDivisionError("a\x1b[2J\nb")), ["fail"]) == 70
    error = capsys.readouterr().err
    (details,) = tmp_path.iterdir()
    assert error == (
        "coaxlink: this is a fault of coaxlink, please report it: "
        f"ZeroDivisionError: a\\x1b[2J; details in {details}\n"
    )
    assert "raise error" in details.read_text()


def test_the_help_comes_unasked_and_by_its_short_name(capsys):
    assert run(build_app(), []) == 2
    unasked = capsys.readouterr().err
    assert unasked.startswith("Usage: coaxlink") and "identify" in unasked
    for arguments in (["-h"], ["--help"], ["upload", "-h"]):
        assert run(build_app(), arguments) == 0
        assert capsys.readouterr().out.startswith("Usage: coaxlink")


def test_the_list_of_verbs_is_whole_sentences_at_80_columns(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert run(build_app(), ["--help"]) == 0
    groups = capsys.readouterr().out.split("\n\n")[3:]
    assert [g.partition(":")[0] for g in groups] == ["Measure", "Table", "Board", "Fly", "Logs", "Study"]
    verbs = [line for group in groups for line in group.strip().splitlines()[1:]]
    assert len(verbs) > 20 and all(line.endswith(".") and not line.endswith("..") for line in verbs)
    modules = {m.name for m in pkgutil.iter_modules(coaxlink.cli.__path__) if not m.ispkg}
    assert sorted(line.split()[0] for line in verbs) == sorted(modules)


@pytest.mark.slow
def test_a_verb_is_loaded_when_it_is_called():
    code = (
        "import contextlib, sys\nfrom coaxlink.cli import main\n"
        "for words in (['--help'], ['--version'], ['restore', '--help']):\n"
        "    with contextlib.suppress(SystemExit):\n        main(words)\n"
        "    names = [m.split('.') for m in sys.modules if m.startswith('coaxlink.cli.')]\n"
        "    print('loaded', *(n[2] for n in names if n[2] != 'shared'))\n"
    )
    reported = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    loaded = [line.split()[1:] for line in reported.splitlines() if line.startswith("loaded")]
    assert loaded[:2] == [[], []] and set(loaded[2]) == {"restore", "upload"}  # what it shares options with


def test_the_version_needs_no_verb(capsys):
    assert run(build_app(), ["--version"]) == 0
    assert capsys.readouterr().out == f"coaxlink {coaxlink.__version__}\n"
    assert run(build_app(), ["--verbose", "--version"]) == 0
    report = capsys.readouterr().out.splitlines()
    assert report[0] == f"coaxlink {coaxlink.__version__}" and report[1].startswith("Python 3.")
    assert any(line.startswith("pymavlink 2.") for line in report)
    assert run(build_app(), ["--verbose"]) == 2
    assert capsys.readouterr().err == "coaxlink: Missing command.\n"


@pytest.mark.parametrize(
    ("line", "values"),
    [
        ("table x.toml --law ", "fitted balanced reduced standard curved"),
        ("table x.toml --firmware p", "px4"),
        ("bridge x.toml --firmware ", "px4 ardupilot"),
        ("identify --form s", "srm"),
        ("mix x.toml --law ex", "exact"),
        ("allocate x.toml --law ", "standard reduced coaxial exact fitted"),
    ],
)
@pytest.mark.slow
def test_values_complete(line, values):
    words = f"coaxlink {line}"
    env = {
        **os.environ,
        "_COAXLINK_COMPLETE": "complete_bash",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split(" ")) - 1),
    }
    reported = subprocess.run([sys.executable, "-m", "coaxlink"], env=env, capture_output=True, text=True)
    assert reported.stdout.split() == values.split()


def test_a_vehicle_s_file_says_where_it_is(capsys, tmp_path):
    """What is typed goes before it; where neither says, one line does."""
    plain = example("x8_paper.toml").read_text()
    (tmp_path / "x8.toml").write_text(f'{plain}\n[defaults]\nconnect = "udpout:127.0.0.1"\n')
    (tmp_path / "none.toml").write_text(plain)
    (tmp_path / "odd.toml").write_text(f'{plain}\n[defaults]\nconect = "udpout:127.0.0.1:9"\n')
    rotor = ["--rotor", str(example("rotor_paper.toml"))]
    for file, words, reported in (
        ("x8", [], "udpout:127.0.0.1: a port"),
        ("x8", ["--connect", "tcp:"], "tcp:: "),
        ("none", [], "--connect: an address is expected, or once for all [defaults] connect in"),
        ("odd", [], "defaults.conect"),
    ):
        assert run(build_app(), ["mix", str(tmp_path / f"{file}.toml"), *rotor, *words]) == 2
        assert reported in capsys.readouterr().err
    kept = tmp_path / "tables" / "vehicle"
    kept.mkdir(parents=True)
    (kept / "airframe.toml").write_bytes((tmp_path / "x8.toml").read_bytes())
    (tmp_path / "tables" / "x8.params").write_text("1\t1\tCA_ROTOR0_CT\t6.5\t9\n")
    for verb in ("upload", "verify"):
        assert run(build_app(), [verb, str(tmp_path / "tables")]) == 2
        assert "udpout:127.0.0.1: a port" in capsys.readouterr().err
    assert read_vehicle(tmp_path / "x8.toml").name == load_airframe(tmp_path / "x8.toml").name


@pytest.mark.slow
def test_completion_knows_verbs_and_options(tmp_path):
    """As a shell asks for it, in a process of its own; and it installs itself for bash."""
    command = [sys.executable, "-m", "coaxlink"]
    env = {**os.environ, "HOME": str(tmp_path), "_COAXLINK_COMPLETE": "complete_bash"}
    for words, at, found in (("coaxlink up", 1, "upload"), ("coaxlink upload --conn", 2, "--connect")):
        complete = env | {"COMP_WORDS": words, "COMP_CWORD": str(at)}
        assert subprocess.run(command, env=complete, capture_output=True, text=True).stdout.split() == [found]
    del env["_COAXLINK_COMPLETE"]
    # a shell of our own: the one that began the tests may have ended
    in_bash = ["bash", "-c", '"$@" --install-completion; exit $?', "-", *command]
    assert subprocess.run(in_bash, env=env, capture_output=True).returncode == 0
    assert "_COAXLINK_COMPLETE" in (tmp_path / ".bash_completions" / "coaxlink.sh").read_text()


@pytest.mark.parametrize(
    ("shell_found", "reported"), [(("tcsh", "/bin/tcsh"), "found tcsh"), (None, "found none")]
)
def test_a_shell_that_cannot_be_completed_for_is_one_line(capsys, monkeypatch, shell_found, reported):
    def detect():
        if shell_found is None:
            raise shellingham.ShellDetectionFailure
        return shell_found

    monkeypatch.setattr(shellingham, "detect_shell", detect)
    assert run(build_app(), ["--install-completion"]) == 2
    assert capsys.readouterr().err == (
        "coaxlink: --install-completion: one of bash, zsh, fish, powershell, pwsh is expected to start it, "
        f"{reported}\n"
    )


@pytest.mark.slow
def test_ctrl_c_leaves_one_line_at_every_moment():
    """At many moments from the first line on: whether it comes in time is the machine's affair."""
    script = (
        "import os, signal, sys, threading\n"
        "from coaxlink import _start\n"  # before it is loaded the interpreter has the word
        "after = float(sys.argv.pop(1))\n"
        "threading.Timer(after, os.kill, (os.getpid(), signal.SIGINT)).start()\n"
        "_start.main()\n"
    )
    cut_short = 0
    for step in range(12):
        arguments = [str(0.03 * step), "identify", "example", "--form", "srm"]
        done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True)
        assert "Traceback" not in done.stderr, (step, done.stderr)
        assert done.returncode in (0, 130), (step, done.stderr)
        if done.returncode == 130:
            assert done.stderr.endswith("coaxlink: interrupted\n")
            cut_short += 1
    assert cut_short  # at the first moments nothing can be done yet


@pytest.mark.slow
def test_ctrl_c_ends_what_only_reads_in_the_middle_of_an_import():
    """At once, not when the import is over."""
    script = (
        "import os, signal, sys, threading, time, importlib.abc\n"
        "from coaxlink import _start\n"
        "class Slow(importlib.abc.MetaPathFinder):\n"
        "    def find_spec(self, name, path, target=None):\n"
        "        if name == 'coaxlink.health.premises':\n"
        "            threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()\n"
        "            end = time.monotonic() + 30.0\n"
        "            while time.monotonic() < end:\n"
        "                sum(range(1000))\n"
        "sys.meta_path.insert(0, Slow())\n"
        "_start.main()\n"
    )
    began = time.monotonic()
    done = subprocess.run([sys.executable, "-c", script, "health", "x.csv"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "coaxlink: interrupted\n")
    assert time.monotonic() - began < 30.0


def test_ctrl_c_is_not_lost_where_the_interpreter_ignores_exceptions():
    """It evaluates annotations before a verb begins; there a KeyboardInterrupt was printed and forgotten."""
    script = (
        "import os, signal, sys, typer.main\n"
        "from coaxlink import _start\n"
        "class Gone:\n"
        "    def __del__(self):\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "        sum(range(1000))\n"
        "made = typer.main.get_command\n"
        "typer.main.get_command = lambda app: (Gone(), made(app))[1]\n"
        "_start.main()\n"
    )
    done = subprocess.run([sys.executable, "-c", script, "examples"], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "coaxlink: interrupted\n")


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_streams_that_are_closed_or_full_are_one_line():
    command = f"{shlex.quote(sys.executable)} -m coaxlink"
    rows = [
        ("examples >&-", 2, "standard output is closed"),
        ("examples >/dev/full", 2, "cannot be written (No space left on device)"),
        ("--version >/dev/full", 2, "cannot be written (No space left on device)"),
        ("allocate nothing.toml --wrench 1,0,0,0 >/dev/full", 2, "nothing.toml"),
        ("allocate nothing.toml --wrench 1,0,0,0 2>/dev/full", 2, None),
        ("examples 2>/dev/full", 0, None),
        ("examples >&- 2>&-", 2, None),
        ("examples 2>&- <&-", 0, None),
    ]
    with case_table() as case:
        for unbuffered in ("", "1"):
            for line, code, reported in rows:
                with case(f"{line} {unbuffered}"):
                    done = subprocess.run(
                        ["bash", "-o", "pipefail", "-c", f"{command} {line}"],
                        env={**os.environ, "PYTHONUNBUFFERED": unbuffered}, capture_output=True, text=True,
                    )  # fmt: skip
                    assert done.returncode == code, done.stderr
                    if reported is not None:
                        assert len(done.stderr.splitlines()) == 1 and reported in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("loaded", ["from coaxlink.cli import build_app", ""])
def test_a_verb_runs_in_another_thread_which_may_set_no_handlers(loaded):
    script = f"""
import threading
import coaxlink
{loaded}
def verb():
    from coaxlink.cli import build_app
    from coaxlink.cli.shared.shell import run, say
    print("ended with", run(build_app(), ["refine", "nowhere.csv"]))
thread = threading.Thread(target=verb)
thread.start()
thread.join()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout.endswith("ended with 2\n") and "nowhere.csv" in done.stderr, done.stderr
