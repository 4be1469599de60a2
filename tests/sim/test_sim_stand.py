"""The virtual thrust stand, against eq. 17 written out by hand."""

from pathlib import Path

import numpy as np
import pytest

from sim.errors import SimulationError
from sim.physics.rotors import read_pair
from sim.stand.grid import COLUMNS, stand_rows, write_stand

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_without_noise_the_stand_reads_equation_17() -> None:
    rows = stand_rows(read_pair(EXAMPLES / "rotor_paper.toml"), thrust_noise_N=0, torque_noise_Nm=0)
    read = dict(zip(COLUMNS, rows.T, strict=True))
    u, v = read["upper_rpm"] / 5400, read["lower_rpm"] / 5400
    assert len(rows) == 121 and u.max() == pytest.approx(0.9) and u.min() == 0
    lower = 2.755 * u**2 * v**2 + 64.721 * v**2 - 2.547 * u * v + 12.402 * v - 37.502 * u**2 + 0.801
    assert read["upper_thrust_N"] == pytest.approx(55.9517 * u**2 + 22.4464 * u)
    assert read["upper_torque_Nm"] == pytest.approx(1.2437 * u**2 + 0.7155 * u)
    assert read["lower_thrust_N"] == pytest.approx(lower)
    assert read["lower_torque_Nm"] == pytest.approx(
        0.307 * u * v**2 + 1.466 * v**2 + 0.573 * v - 0.695 * u**2
    )


def test_noise_has_the_stated_size_and_the_seed_decides_it() -> None:
    pair = read_pair(EXAMPLES / "rotor_paper.toml")
    quiet = stand_rows(pair, thrust_noise_N=0, torque_noise_Nm=0)
    noise = np.concatenate([stand_rows(pair, seed=s) - quiet for s in range(20)])[:, 5:9]
    assert noise.std(axis=0) == pytest.approx([0.5, 0.01, 0.5, 0.01], rel=0.1)
    assert np.array_equal(stand_rows(pair, seed=3), stand_rows(pair, seed=3))
    assert not np.array_equal(stand_rows(pair, seed=3), stand_rows(pair, seed=4))


def test_the_log_is_whole_or_not_there(tmp_path: Path) -> None:
    rows = stand_rows(read_pair(EXAMPLES / "rotor_paper.toml"), seed=1)
    write_stand(tmp_path / "log.csv", rows)
    assert np.loadtxt(tmp_path / "log.csv", delimiter=",", skiprows=1) == pytest.approx(rows, abs=0.06)
    assert [p.name for p in tmp_path.iterdir()] == ["log.csv"]
    with pytest.raises(SimulationError, match="cannot be written"):
        write_stand(tmp_path / "absent" / "log.csv", rows)
