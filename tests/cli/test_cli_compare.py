"""`coaxlink compare`: every law's row, what each is known for, and a picture."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from coaxlink.cli import build_app
from coaxlink.cli._shell import run

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_rows_say_what_each_law_is_known_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, png = tmp_path / "c.json", tmp_path / "c.png"
    arguments = ["compare", str(EXAMPLES / "x8_paper.toml"), "--printed", "--rows", "80"]
    assert run(build_app(), [*arguments, "--json", str(out), "--out", str(png)]) == 0
    rows = {row["law"]: row for row in json.loads(out.read_text())["laws"]}
    assert rows["exact"]["max_error"] == pytest.approx([0, 0, 0, 0], abs=1e-6)
    assert rows["fitted"]["mean_error"][0] <= 0.05
    assert rows["reduced (paper's numbers)"]["mean_error"][0] == pytest.approx(38.8, abs=0.6)
    assert rows["standard (paper's numbers)"]["mean_error"][0] == pytest.approx(7.9, abs=0.8)
    assert rows["coaxial-printed"]["mean_error"][3] == pytest.approx(0.5, abs=0.08)
    assert rows["coaxial-printed"]["most_yaw_Nm"] == pytest.approx(0, abs=1e-6)
    assert rows["coaxial"]["max_error"] == pytest.approx([0, 0, 0, 0], abs=1e-6)
    least = min(row["power"] for law, row in rows.items() if max(row["max_error"]) < 0.5)
    assert rows["exact"]["power"] <= least * 1.001
    assert png.read_bytes().startswith(b"\x89PNG")
    assert "fitted" in capsys.readouterr().out


def test_an_unknown_airframe_is_exit_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(build_app(), ["compare", "none.toml"]) == 2
    assert "none.toml" in capsys.readouterr().err
