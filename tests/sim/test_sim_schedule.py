"""Schedules of the virtual stand: what is asked is what is run, and nonsense is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim.physics.rotors import read_pair
from sim.stand.effects import StandEffect, StandSetup, measure
from sim.stand.schedule import read_schedule

ROTOR = Path(__file__).parents[2] / "examples" / "rotor_paper.toml"


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "plan.toml"
    path.write_text(text)
    return path


def test_pieces_follow_one_another(tmp_path):
    plan = read_schedule(
        write(
            tmp_path,
            "rate_hz = 4.0\n[[pieces]]\nseconds = 2\nupper = [0.0, 0.8]\nlower = 0.5\nsupply_V = 30\n"
            '[[pieces]]\nseconds = 4\nupper = [0.2, 0.6]\nlower = 0\nshape = "steps"\nspacing_m = 0.2\n',
        )
    )
    assert np.allclose(plan.time_s, 0.25 * np.arange(1, 25))
    assert np.allclose(plan.upper[:8], 0.1 * np.arange(1, 9)) and np.all(plan.lower[:8] == 0.5)
    assert plan.upper[8:].tolist() == [0.2] * 4 + [0.6] * 4 + [0.2] * 4 + [0.6] * 4
    assert np.all(plan.supply_V[:8] == 30.0) and np.all(np.isnan(plan.supply_V[8:]))
    assert np.all(np.isnan(plan.spacing_m[:8])) and np.all(plan.spacing_m[8:] == 0.2)


def test_the_supply_is_what_the_plan_sets(tmp_path):
    plan = read_schedule(
        write(
            tmp_path,
            "".join(
                f"[[pieces]]\nseconds = 5\nupper = 0.8\nlower = 0.8\nsupply_V = {v}\n" for v in (33.6, 29.4)
            ),
        )
    )
    columns = measure(
        read_pair(ROTOR), StandSetup((StandEffect("battery_voltage", 1.0, 0.0, 0),)), seed=3, schedule=plan
    )
    volts, rpm = columns["voltage_V"], columns["upper_rpm"]
    assert abs(volts[:50].mean() - 33.6) < 0.02 and abs(volts[50:].mean() - 29.4) < 0.02
    assert rpm[50:].mean() / rpm[:50].mean() == pytest.approx(29.4 / 33.6, rel=0.01)
