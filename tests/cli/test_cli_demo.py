"""The demo end to end, judged by what only the simulated world knows."""

import json
import re

import pytest

from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run
from coaxlink.fly import trajectory
from sim.truth import hidden_truth

SEED = 4
RIM = trajectory.RIM
SHORT = trajectory.FlightPlan(
    (
        trajectory.Hold("hover", trajectory.HOVER, 3.0),
        trajectory.Move("to the circle", trajectory.HOVER, RIM, 3.0),
        trajectory.Circle("circle", 2.0, -4.5, 5.0, 1),
        trajectory.Circle("fast circle", 2.0, -4.5, 3.6, 1),
    )
)
TERMS = ("wrench", "allocation error", "residual", "held out", "noise floor", "NRMSE", "R-CRM", "LASSO")


@pytest.mark.slow
def test_the_demo_flies_and_finds_what_the_world_hides(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(trajectory, "paper_flight", trajectory.mixer_flight)
    monkeypatch.setattr(trajectory, "mixer_flight", lambda: SHORT)  # CI flies the whole of it, by the README
    result, out = tmp_path / "demo.json", tmp_path / "demo"
    arguments = ["demo", "--seed", str(SEED), "--out", str(out), "--json", str(result), "--speed", "20"]
    assert run(build_app(), arguments) == 0

    demo = json.loads(result.read_text())
    assert demo["identify"]["channels"]["coaxial_thrust"]["r"] > 0.999
    assert demo["upload"]["result"] == "verified"
    assert demo["upload"]["fitted"]["changed"]
    assert demo["hidden_effect_found"] == hidden_truth(SEED, rotors=8).effects[0].name
    assert demo["before"].keys() == demo["after"].keys()
    assert all(demo["after"][channel] < demo["before"][channel] for channel in demo["before"])

    standard, fitted, live = (demo["flights"][name] for name in ("standard", "fitted", "live"))
    assert standard["split"][0]["lower_share"] < 0.40 < fitted["split"][0]["lower_share"]
    assert live["thrust_error_N"] < standard["thrust_error_N"]
    assert max(f["height_error_m"] for f in (standard, fitted, live)) < 0.3
    # nothing is hidden from the mixers: what the fitted table misses is the noise, near enough
    assert fitted["thrust_error_N"] < 2 * fitted["floor"]["thrust_N"] < 0.1 * standard["thrust_error_N"]
    assert fitted["after_gain"]["thrust_N"] < 0.5 * standard["after_gain"]["thrust_N"]
    assert 0.9 < fitted["power_W"] / standard["power_W"] < 0.98

    assert (out / "demo.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    page = (out / "report.html").read_text()
    worth = demo["worth"]["summary"][0]
    assert worth.startswith("The fitted table saves") and worth in page and "What a table is worth" in page
    first = demo["flown"][0]
    assert first.startswith("The fitted table flew") and "less battery power" in first
    assert page.index(first) < page.index('src="data:image/png') < page.index("<h2>")
    assert page.index(first) < page.index("Something is hidden")
    assert [term for term in TERMS if not re.search(f"<dt>[^<]*{term}", page)] == []
    assert str(tmp_path / "demo" / "hidden.tlog") == demo["refine"]["source"]
    assert 'src="http' not in page
    assert (out / "tables" / "fitted").is_dir()
    screen = capsys.readouterr()
    lines = screen.out.splitlines()
    assert first in " ".join(screen.out.split()) and len(lines) < 20
    assert "gives up" in screen.out and "docs/tutorial.md" in lines[-2]
    assert f"--seed {SEED}" in screen.err


def test_a_place_that_cannot_be_written_is_one_line(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert run(build_app(), ["demo", "--seed", "1", "--out", str(tmp_path / "file")]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert "cannot be written" in lines[-1]
