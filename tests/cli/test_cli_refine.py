"""`coaxlink refine` on a stand CSV: files out, exit codes, one-line errors."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
import tomllib

import numpy as np
import pytest
import residual_rig

from coaxlink import files
from coaxlink.cli import main


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("refine")
    columns = residual_rig.run(seed=2, spacing=0.5)
    rows = np.stack(list(columns.values()), axis=1)
    np.savetxt(out / "stand.csv", rows, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    return out


def run(*arguments):
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    return ended.value.code


@pytest.mark.slow
def test_everything_is_written(folder, capsys):
    paper = files.example("rotor_paper.toml")
    code = run(
        "refine", folder / "stand.csv", "--rotor", paper,
        "--out", folder / "better.toml", "--report", folder / "r.html", "--json", folder / "r.json",
    )  # fmt: skip
    shown = capsys.readouterr()
    assert code == 0 and "found: rotor_spacing" in shown.out
    document = json.loads((folder / "r.json").read_text())
    assert document["kind"] == "stand" and [e["name"] for e in document["effects"]] == ["rotor_spacing"]
    shown = document["channels"]["lower_thrust"]
    assert shown["rmse_after"] < shown["rmse_before"]
    better = tomllib.loads((folder / "better.toml").read_text())
    assert better["effects"][0]["name"] == "rotor_spacing" and better["upper"]["thrust_N"]["u_u^2"] == 55.9517
    page = (folder / "r.html").read_text()
    assert "Found: rotor spacing" in page and page.count("data:image/png;base64,") == 2
    assert "http" not in page  # self-contained
    code = run("refine", folder / "stand.csv", "--rotor", folder / "better.toml")
    assert code == 0 and "found" not in capsys.readouterr().out


def test_a_place_that_cannot_be_written_is_said_before_the_work(folder, capsys):
    (folder / "file").write_text("in the way")
    places = ("--json", folder / "r2.json", "--out", folder / "file" / "b.toml")
    code = run("refine", folder / "stand.csv", *places)
    reported = capsys.readouterr().err.strip().splitlines()
    assert code == 2 and len(reported) == 1 and "b.toml" in reported[0] and "cannot be written" in reported[0]
    assert not (folder / "r2.json").exists()


# stops where it is told to, says so by a file, and waits for Ctrl-C
STOPPING = """
import importlib, pathlib, sys, time
module, _, name = sys.argv[1].partition(":")
def stop(*_, **__):
    pathlib.Path(sys.argv[2]).touch()
    time.sleep(100.0)
setattr(importlib.import_module(module), name, stop)
from coaxlink.cli import main
main(sys.argv[3:])
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "stage",
    ["coaxlink.data:read_stand_log", "coaxlink.residual:refine_stand", "coaxlink.report.page:page"],
)
def test_an_interrupted_refine_leaves_the_files_of_before(tmp_path, stage):
    folder, reached = tmp_path / "here", tmp_path / "reached"
    folder.mkdir()
    columns = residual_rig.run(seed=0, air=1.0)
    log = np.stack(list(columns.values()), axis=1)
    np.savetxt(folder / "s.csv", log, delimiter=",", header=",".join(columns), comments="", fmt="%.7g")
    names = ("b.toml", "r.html", "r.json")
    for name in names:
        (folder / name).write_text("the one before")
    places = [str(folder / name) for name in names]
    verb = [sys.executable, "-c", STOPPING, stage, str(reached), "refine", str(folder / "s.csv")]
    verb += ["--out", places[0], "--report", places[1], "--json", places[2]]
    process = subprocess.Popen(verb, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    while not reached.exists() and process.poll() is None:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, reported = process.communicate(timeout=600.0)
    assert process.returncode == 130 and reported.strip().endswith("coaxlink: interrupted")
    assert sorted(p.name for p in folder.iterdir()) == ["b.toml", "r.html", "r.json", "s.csv"]
    assert {(folder / name).read_text() for name in names} == {"the one before"}


def test_bad_input_is_one_line(folder, capsys):
    (folder / "short.csv").write_text("time_s,motor1\n0,0.5\n0.1,0.5\n")
    assert run("refine", folder / "short.csv", "--json", folder / "no.json") == 2
    reported = capsys.readouterr().err.strip().splitlines()
    assert len(reported) == 1 and "short.csv" in reported[0] and "column" in reported[0]
    assert not (folder / "no.json").exists()
    assert run("refine", folder / "short.csv", folder / "stand.csv") == 2
    assert "one kind at a time" in capsys.readouterr().err
