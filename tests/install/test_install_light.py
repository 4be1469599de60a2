"""What a companion computer's light install can do, what it says of the rest, and what is loaded when."""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from coaxlink.files import example
from sim.testing import standin

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
X8 = str(example("x8_paper.toml"))
HEAVY = ("cvxpy", "llvmlite", "matplotlib", "mavsdk", "numba", "scipy", "sim")


def together(folder: Path, commands: list[list[str]], *options: str) -> list[tuple[int, str, str]]:
    """(exit code, stdout, stderr) of each command line, all in one process that lacks something."""
    (folder / "commands.json").write_text(json.dumps(commands))
    reported = subprocess.run(
        [sys.executable, str(HERE / "light_process.py"), str(folder / "commands.json"), *options],
        capture_output=True, text=True, cwd=folder,
    )  # fmt: skip
    assert reported.returncode == 0, reported.stderr
    return [(code, out, talk) for code, out, talk in json.loads(reported.stdout)]


def test_the_light_list_is_a_part_of_the_full_one():
    full = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    light = tomllib.loads((ROOT / "companion" / "pyproject.toml").read_text())["project"]
    every = set(full["dependencies"])
    assert set(light["dependencies"]) < every
    assert light["requires-python"] == full["requires-python"] and light["scripts"] == full["scripts"]


@pytest.mark.slow
def test_it_makes_a_table_uploads_verifies_watches_mixes_and_restores(tmp_path, monkeypatch):
    monkeypatch.setenv("COAXLINK_STATE", str(tmp_path / "state"))
    with standin("--firmware", "px4") as port, standin("--firmware", "px4:1.13") as old:
        line, live = (["--connect", f"udpout:127.0.0.1:{p}"] for p in (port, old))
        commands = [
            ["allocate", X8, "--wrench", "196.1,0,0,0", "--law", "exact"],
            ["table", X8, "--firmware", "ardupilot", "--law", "standard", "--out", "ap"],
            ["table", X8, "--firmware", "px4", "--law", "reduced", "--out", "tables", *line],
            ["upload", "tables", *line, "--yes"],
            ["verify", "tables", *line],
            ["monitor", *line, "--once", "--seconds", "1"],
            ["mix", X8, *live, "--dry-run", "--seconds", "1", "--json", "mix.json"],
        ]
        for command, (code, _, talk) in zip(commands, together(tmp_path, commands), strict=True):
            assert code == 0, f"{command}: {talk}"
        backup = next((tmp_path / "backups").glob("*.params"))
        assert [r[0] for r in together(tmp_path, [["restore", str(backup), *line, "--yes"]])] == [0]
    assert json.loads((tmp_path / "mix.json").read_text())["law"] == "exact"


@pytest.mark.slow
def test_what_is_left_out_is_one_line_that_says_what_to_install(tmp_path):
    commands = {
        "scipy": ["table", X8, "--firmware", "px4", "--out", "t"],
        "matplotlib": ["airframe", X8, "--picture", "x.png"],
        "coaxlink": ["sim", "--firmware", "px4"],
        "threadpoolctl": ["refine", "example"],
    }
    answers = together(tmp_path, list(commands.values()))
    for package, (code, _, talk) in zip(commands, answers, strict=True):
        last = talk.strip().splitlines()[-1]
        assert code == 2 and f"pip install {package}" in last, talk
        assert "Traceback" not in talk


@pytest.mark.slow
def test_on_windows_files_and_lines_work_and_the_simulated_world_says_where_it_does(tmp_path, monkeypatch):
    """As far as can be told here: nothing is called that Windows lacks. CI runs the real one."""
    monkeypatch.setenv("COAXLINK_STATE", str(tmp_path / "state"))
    with standin("--firmware", "px4") as port:
        line = ["--connect", f"udpout:127.0.0.1:{port}"]
        commands = {
            ("--help",): 0,
            ("examples",): 0,
            ("allocate", X8, "--wrench", "196.1,0,0,0"): 0,
            ("table", X8, "--firmware", "px4", "--law", "reduced", "--out", "tables"): 0,
            ("upload", "tables", *line, "--yes"): 0,
            ("verify", "tables", *line): 0,
            ("monitor", *line, "--once", "--seconds", "1"): 0,
            ("sim", "--firmware", "px4"): 2,
        }
        answers = together(tmp_path, [list(c) for c in commands], "--windows")
    for (command, code), (found, _, talk) in zip(commands.items(), answers, strict=True):
        assert found == code, f"{command}: {talk}"
    assert "WSL" in answers[-1][2].splitlines()[-1]


@pytest.mark.slow
def test_help_loads_nothing_heavy():
    each = ["main(['--help'])"] + [
        f"main([{verb!r}, '--help'])" for verb in ("mix", "upload", "monitor", "table", "identify")
    ]
    code = "".join(f"with contextlib.suppress(SystemExit): {call}\n" for call in each)
    loaded = _loaded(f"import contextlib\nfrom coaxlink.cli import main\n{code}")
    assert "coaxlink" in loaded and not loaded & {*HEAVY, "numpy", "pymavlink", "textual"}


@pytest.mark.slow
def test_the_live_path_loads_nothing_heavy():
    rooms = (
        "live.mixer",
        "uploading.worker",
        "live.effects",
        "mixer",
        "monitor.screen.app",
        "library",
        "vehicle",
    )
    loaded = _loaded("".join(f"import coaxlink.{room}\n" for room in rooms))
    assert "textual" in loaded and not loaded & set(HEAVY)


def _loaded(code: str) -> set[str]:
    """Top-level modules that are there after the code ran in a process of its own."""
    script = f"{code}\nimport sys\nprint('\\n' + ' '.join(sys.modules))"
    reported = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return {name.partition(".")[0] for name in reported.stdout.splitlines()[-1].split()}
