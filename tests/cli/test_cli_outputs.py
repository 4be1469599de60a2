"""No verb writes over what it reads, nor over what is no file; it says so before it computes anything."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from case_table import case_table

from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run
from coaxlink.files import example

# of each verb a line that would do something, and the options that write a file
LINES: dict[str, tuple[list[str], list[str]]] = {
    "identify": (["stand.csv"], ["--json", "--out", "--report", "--next"]),
    "refine": (["stand.csv", "--rotor", "rotor.toml"], ["--json", "--out", "--report"]),
    "health": (["stand.csv"], ["--json", "--report", "--plot"]),
    "allocate": (["air.toml", "--wrench", "200,0,0,0"], ["--json"]),
    "table": (["air.toml", "--firmware", "px4"], ["--json"]),
    "compare": (["air.toml"], ["--json", "--out", "--report"]),
    "airframe": (["air.toml"], ["--json", "--picture"]),
    "mix": (["air.toml", "--connect", "udpout:127.0.0.1:9"], ["--json"]),
    "monitor": (["--replay", "stand.csv", "--airframe", "air.toml"], ["--json"]),
    "campaign": (["air.toml"], ["--json"]),
    "sim": (["--airframe", "air.toml"], ["--log", "--truth-log", "--stand"]),
    "init": (["--from", "air.toml"], ["out"]),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name, source in (
        ("stand.csv", "stand_eq17.csv"), ("air.toml", "x8_paper.toml"), ("rotor.toml", "rotor_paper.toml"),
    ):  # fmt: skip
        shutil.copy(example(source), name)
    os.mkfifo("pipe")
    Path("hard").hardlink_to("air.toml")
    return tmp_path


@pytest.mark.slow
def test_outputs_are_looked_at_first(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    app, before = build_app(), {path: path.lstat() for path in folder.iterdir()}
    with case_table() as case:
        for verb, (line, options) in LINES.items():
            read = next(word for word in reversed(line) if "." in word and ":" not in word)
            for option in options:
                for place in (read, "pipe", "/dev/full", ".", *(["hard"] if read == "air.toml" else [])):
                    with case(f"{verb} {option} {place}"):
                        code = run(app, [verb, *line, *([place] if option == "out" else [option, place])])
                        out, err = capsys.readouterr()
                        assert (code, out) == (2, "") and len(err.splitlines()) == 1, err
                        assert "name a" in err
    assert {path: path.lstat().st_ino for path in folder.iterdir()} == {
        path: about.st_ino for path, about in before.items()
    }


def test_a_name_that_is_too_long_is_one_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = ["campaign", str(example("campaign_laws.toml")), "--dry-run", "--out", "x" * 5000]
    assert run(build_app(), line) == 2
    assert "too long" in capsys.readouterr().err
