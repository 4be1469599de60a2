"""The demo end to end, judged by what only the simulated world knows."""

import json

import pytest

from coaxlink.cli import build_app
from coaxlink.cli._shell import run
from sim.truth import hidden_truth

SEED = 4


@pytest.mark.timeout(300)
def test_the_demo_flies_and_finds_what_the_world_hides(tmp_path, capsys):
    result, out = tmp_path / "demo.json", tmp_path / "demo"
    arguments = ["demo", "--seed", str(SEED), "--out", str(out), "--json", str(result), "--speed", "10"]
    assert run(build_app(), arguments) == 0

    demo = json.loads(result.read_text())
    assert demo["identify"]["channels"]["coaxial_thrust"]["r"] > 0.999
    assert demo["upload"]["result"] == "verified"
    assert demo["upload"]["reduced"]["changed"]
    assert demo["hidden_effect_found"] == hidden_truth(SEED, rotors=8).effects[0].name
    assert demo["before"].keys() == demo["after"].keys()
    assert all(demo["after"][channel] < demo["before"][channel] for channel in demo["before"])

    standard, reduced, live = (demo["flights"][name] for name in ("standard", "reduced", "live"))
    assert standard["split"][0]["lower_share"] < 0.40 < reduced["split"][0]["lower_share"]
    assert live["thrust_error_N"] < reduced["thrust_error_N"] < standard["thrust_error_N"]
    assert max(f["height_error_m"] for f in (standard, reduced, live)) < 0.3

    assert (out / "residual.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    page = (out / "report.html").read_text()
    assert demo["hidden_effect_found"] in page
    assert 'src="http' not in page
    assert (out / "tables" / "reduced").is_dir()
    screen = capsys.readouterr()
    assert "Thrust split per arm" in screen.out
    assert f"--seed {SEED}" in screen.err


def test_a_place_that_cannot_be_written_is_one_line(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert run(build_app(), ["demo", "--seed", "1", "--out", str(tmp_path / "file")]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert "cannot be written" in lines[-1]
