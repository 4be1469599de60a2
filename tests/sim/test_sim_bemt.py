"""The blade-element pair: momentum theory's own limits, the pairs it was fitted to, and a flight on it."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from sim.bemt import RHO, BemtPair, Blades, pair_loads
from sim.errors import WorldError
from sim.flights import fly
from sim.rotors import read_pair
from sim.world import World, build

EXAMPLES = Path(__file__).parents[2] / "examples"
DATA = Path(__file__).parents[3] / "shared" / "data" / "coax"
IDEAL = Blades(0.2, 0.1, 0.6, 0.25, 0.0, mach=0.0, bluff=0.0)


def test_a_lone_rotor_hovers_on_momentum_theory() -> None:
    tip, u = 120.0, np.array([0.3, 0.6, 0.9])
    thrust, torque, *_ = pair_loads(IDEAL, tip, u, 0.0)
    flow = np.sqrt(thrust / (2 * RHO * math.pi * 0.2**2))
    assert torque * tip * u / 0.2 == pytest.approx(thrust * flow)  # ideal power
    s = 0.6
    inflow = np.sqrt((s / 16) ** 2 + s * 0.25 / 12) - s / 16  # closed form of the hover inflow ratio
    assert flow / (tip * u) == pytest.approx(inflow)
    assert thrust[1] / thrust[0] == pytest.approx(4.0)  # no Reynolds, no Mach: the square of speed


def test_the_wake_costs_the_lower_rotor_and_nobody_else() -> None:
    alone = pair_loads(IDEAL, 120.0, 0.0, 0.6)
    below = pair_loads(IDEAL, 120.0, 0.6, 0.6)
    assert below[2] < 0.95 * alone[2] and below[0] == pytest.approx(alone[2], rel=0.05)
    far = pair_loads(Blades(0.2, 4.0, 0.6, 0.25, 0.0, mach=0.0, bluff=0.0), 120.0, 0.6, 0.6)
    ring = 1 / math.sqrt(2)  # fully contracted: half of the disc sees twice the flow
    assert below[2] != pytest.approx(far[2]) and 0 < far[2] < alone[2] and ring < 1


def test_climb_unloads_and_the_lower_rotor_may_be_felt_above() -> None:
    still, up = (pair_loads(IDEAL, 120.0, 0.6, 0.6, c)[0] for c in (0.0, 2.0))
    assert up < still
    felt = Blades(0.2, 0.1, 0.6, 0.25, 0.0, mach=0.0, bluff=0.0, feedback=0.5)
    assert pair_loads(felt, 120.0, 0.6, 0.9)[0] < still
    near, away = (
        pair_loads(Blades(0.2, z, 0.6, 0.25, 0.0, mach=0.0, feedback=0.5), 120.0, 0.6, 0.9)[0]
        for z in (0.05, 0.4)
    )
    assert near < away


def test_the_papers_pair_comes_out_within_what_its_file_says() -> None:
    bemt, paper = read_pair(Path("kde5215_bemt")), read_pair(EXAMPLES / "rotor_paper.toml")
    u, v = (a.ravel() for a in np.meshgrid(np.arange(0.18, 0.91, 0.09), np.arange(0.18, 0.91, 0.09)))
    error = np.sqrt(np.mean((bemt.loads(u, v) - paper.loads(u, v)) ** 2, axis=1))
    assert (error < [2.0, 0.06, 2.7, 0.04]).all()
    assert bemt.loads(0.9, 0.0)[2] == pytest.approx(paper.loads(0.9, 0.0)[2], abs=3.0)
    assert isinstance(bemt, BemtPair) and max(bemt.fit_error) < 0.6


@pytest.mark.skipif(not DATA.is_dir(), reason="the real stand data is not beside the repository")
def test_a_real_pair_comes_out_within_what_its_file_says() -> None:
    pair = read_pair(Path("mn4014_bemt"))
    assert isinstance(pair, BemtPair)
    errors = []
    for name, spacing in (("055", 0.55), ("07", 0.7), ("085", 0.85), ("1", 1.0)):
        blades = Blades(**{**vars(pair.blades), "spacing_m": spacing * 0.4115})
        for row in csv.DictReader((DATA / f"mn4014_16in_zD{name}.csv").read_text().splitlines()):
            a, b = float(row["Speed Left [rpm]"]), float(row["Speed Right [rpm]"])
            if min(a, b) < 300:
                continue
            read = [0.00980665 * float(row["Thrust Left [g]"]), abs(float(row["Torque Left [Nm]"]))]
            read += [0.00980665 * float(row["Thrust Right [g]"]), abs(float(row["Torque Right [Nm]"]))]
            top = pair.speed_max_rpm
            errors.append(pair_loads(blades, pair.tip_m_s, a / top, b / top) - read)
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert len(errors) > 380 and (rms < [0.52, 0.009, 1.1, 0.04]).all()


def test_it_flies_and_its_air_is_felt() -> None:
    world = World(EXAMPLES / "x8_demo.toml", rotor=Path("kde5215_bemt"))
    autopilot = build(world, []).autopilot
    p = autopilot.plant.parameters
    assert 2.0 < p[autopilot.plant.index.INFLOW] < 12.0 and 0.0 < p[autopilot.plant.index.DRAG] < 1.0
    log = fly(autopilot, "paper")
    assert log["height_m"].max() == pytest.approx(4.7, abs=0.3) and log["height_m"][-1] < 0.3


def test_bad_blades_are_one_clear_line(tmp_path: Path) -> None:
    path = tmp_path / "r.toml"
    for text in ("", "[blades]\nradius_m = 1.0", "[blades]\nwings = 2", '[blades]\nradius_m = "wide"'):
        path.write_text(f'form = "bemt"\nspeed_max_rpm = 5000.0\n{text}\n')
        with pytest.raises(WorldError, match="blades"):
            read_pair(path)
