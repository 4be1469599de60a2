"""`coaxlink refine` on a flight CSV: files out, exit codes, one-line errors."""

from __future__ import annotations

import json
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from coaxlink import files
from coaxlink.cli import main

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "residual"))
from residual_world import fly


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("refine")
    (columns,) = fly([{"drag": 0.06}], seconds=40.0)
    names = list(columns)
    rows = np.stack([columns[n] for n in names], axis=1)
    np.savetxt(out / "flight.csv", rows, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    text = files.example("x8_paper.toml").read_text()
    (out / "x8.toml").write_text(text.replace("mass_kg", "motor_lag_s = 0.02\nmass_kg", 1))
    (out / "rotor_paper.toml").write_text(files.example("rotor_paper.toml").read_text())
    return out


def run(*arguments):
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    return ended.value.code


def test_everything_is_written(folder, capsys):
    code = run(
        "refine", folder / "flight.csv", "--airframe", folder / "x8.toml",
        "--out", folder / "better.toml", "--report", folder / "r.html", "--json", folder / "r.json",
    )  # fmt: skip
    shown = capsys.readouterr()
    assert code == 0 and "found: rotor_drag" in shown.out
    document = json.loads((folder / "r.json").read_text())
    assert [e["name"] for e in document["effects"]] == ["rotor_drag"]
    assert document["channels"]["force_x"]["rmse_after"] < document["channels"]["force_x"]["rmse_before"]
    better = tomllib.loads((folder / "better.toml").read_text())
    assert better["effects"][0]["name"] == "rotor_drag" and better["upper"]["thrust_N"]["u_u^2"] == 55.9517
    page = (folder / "r.html").read_text()
    assert "found: rotor_drag" in page and page.count("data:image/png;base64,") == 2
    assert "http" not in page.replace("http-equiv", "")  # self-contained
    code = run(
        "refine", folder / "flight.csv", "--airframe", folder / "x8.toml", "--rotor", folder / "better.toml"
    )
    assert code == 0 and "nothing to explain" in capsys.readouterr().out


def test_bad_input_is_one_line(folder, capsys):
    (folder / "short.csv").write_text("time_s,motor1\n0,0.5\n0.1,0.5\n")
    assert run("refine", folder / "short.csv", "--json", folder / "no.json") == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1 and "short.csv" in said[0] and "column" in said[0]
    assert not (folder / "no.json").exists()
