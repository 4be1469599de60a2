"""docs/start.md as a new user follows it: own CSV and own airframe to a verified table, on a stand-in."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from coaxlink.cli import main
from coaxlink.rotor import load_rotor_model
from sim.testing import standin

PAGE = Path(__file__).parents[2] / "docs" / "start.md"
URL = "udpin:0.0.0.0:14550"
MAX_RPM = 5500.0


def commands():
    """The lines of every block under <!-- run -->."""
    blocks = re.findall(r"<!-- run -->\n```sh\n(.*?)```", PAGE.read_text(), re.DOTALL)
    return [line for block in blocks for line in block.splitlines() if line.strip()]


def loads(upper, lower):
    """A pair of this test's own: thrust in N and torque in N m at shares of full speed."""
    above, below = 58.0 * upper**2 + 6.0 * upper, 56.0 * lower**2 + 6.0 * lower
    below = below - 26.0 * upper * lower
    return above, below, 1.35 * upper**2 + 0.2 * upper, 1.3 * lower**2 + 0.2 * lower - 0.25 * upper * lower


def write_stand(path):
    """As the page shows it: semicolons, decimal commas, kgf, N cm."""
    heading = re.search(r"^time \[s\];.*$", PAGE.read_text(), re.MULTILINE)
    rng = np.random.default_rng(5)
    rows, t = [heading[0]], 0.0
    for upper in np.linspace(0.2, 0.95, 9):
        for lower in np.linspace(0.2, 0.95, 9):
            above, below, above_q, below_q = loads(upper, lower)
            volts = 25.0 - 0.3 * (upper + lower)
            amps = [
                q * MAX_RPM * u * np.pi / 30 / 0.8 / volts for q, u in ((above_q, upper), (below_q, lower))
            ]
            numbers = [
                t, MAX_RPM * upper, MAX_RPM * lower,
                (above + rng.normal(0, 0.1)) / 9.80665, (below + rng.normal(0, 0.1)) / 9.80665,
                100 * (above_q + rng.normal(0, 0.003)), 100 * (below_q + rng.normal(0, 0.003)), volts, *amps,
            ]  # fmt: skip
            rows.append(";".join(f"{x:.4f}".replace(".", ",") for x in numbers))
            t += 2.0
    path.write_text("\n".join(rows) + "\n")


@pytest.mark.timeout(600)
def test_every_command_of_the_page_does_what_it_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COAXLINK_STATE", str(tmp_path / "state"))
    write_stand(tmp_path / "my_stand.csv")
    said = {}
    with standin("--firmware", "px4") as port:
        for line in commands():
            words = shlex.split(line.replace(URL, f"udpout:127.0.0.1:{port}"))
            assert words[0] == "coaxlink"
            with pytest.raises(SystemExit) as ended:
                main(words[1:])
            said[line] = capsys.readouterr()
            assert ended.value.code == 0, f"{line}\n{said[line].err}"
    assert len(said) == 8
    last = next(reversed(said.values()))
    assert "verified" in last.out
    model = load_rotor_model(tmp_path / "rotor.toml")
    u, v = np.meshgrid(np.linspace(0.3, 1.0, 8), np.linspace(0.3, 1.0, 8))
    scale = model.speed_max_rpm / MAX_RPM
    pair, true = model.loads(u, v), loads(u * scale, v * scale)
    assert np.abs(pair.upper_thrust - true[0]).max() < 0.03 * true[0].max()
    assert np.abs(pair.lower_thrust - true[1]).max() < 0.03 * true[1].max()
    for name in ("my_x8.png", "my_x8.toml", "tables/vehicle/airframe.toml"):
        assert (tmp_path / name).stat().st_size > 0
    assert "MC_YAWRATE_K" in next((tmp_path / "tables").glob("*.params")).read_text()
    dry = next(out for line, out in said.items() if "--dry-run" in line)
    assert dry.out.startswith("rate loops:") and "nothing was written" in dry.out
