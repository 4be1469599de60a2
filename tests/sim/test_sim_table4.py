"""The paper's simulated flight: its mixers err as it says; the exact and fitted laws beat its best."""

from pathlib import Path

import numpy as np
import pytest

from coaxlink.airframe import load_airframe
from coaxlink.mixer import make_law
from coaxlink.rotor import load_rotor_model
from coaxlink.vehicle import Vehicle
from sim.geometric import ROWS, fly_law, rotation, vee
from sim.world import World, build_plant

EXAMPLES = Path(__file__).parents[2] / "examples"
AIRFRAME = load_airframe(EXAMPLES / "x8_demo.toml")
# Table 4: the least error of its three mixers, row by row
PAPER_BEST = dict(zip(ROWS, (0.3652, 0.3659, 0.0698, 0.10451, 0.08423, 0.00105, 0.58), strict=True))


def flown(law: str, rotor: str = "rotor_paper.toml", seconds: float = 21.0) -> dict[str, float]:
    plant, _ = build_plant(World(EXAMPLES / "x8_demo.toml"))
    mixer = make_law(law, Vehicle(AIRFRAME, load_rotor_model(EXAMPLES / rotor)))
    return fly_law(plant, mixer.speeds, seconds=seconds)


@pytest.mark.parametrize("law", ["exact", "fitted"])
def test_every_row_is_ahead_of_the_papers_best(law: str) -> None:
    rows = flown(law)
    assert all(rows[name] < PAPER_BEST[name] for name in ROWS), rows


def test_the_standard_mixer_sinks_and_algorithm_1_has_no_yaw() -> None:
    standard = flown("standard-printed", "rotor_srm_paper.toml", 7.0)
    assert 3.0 < standard["f_N"] < 6.0 and 0.3 < standard["p_z_m"] < 0.8  # 4.78 N and 0.637 m in the paper
    printed = flown("coaxial-printed", seconds=25.0)
    assert printed["f_N"] < 0.1 and printed["tau_z_Nm"] > 0.02


def test_rotations() -> None:
    q = np.array([np.cos(0.2), 0.0, 0.0, np.sin(0.2)])
    r = rotation(q)
    assert r @ r.T == pytest.approx(np.eye(3)) and r[1, 0] == pytest.approx(np.sin(0.4))
    assert vee(np.array([[0, -3, 2], [3, 0, -1], [-2, 1, 0.0]])) == pytest.approx([1, 2, 3])
