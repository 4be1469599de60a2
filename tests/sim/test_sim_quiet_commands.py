"""Holding a place, the stand-in's commands carry the sensors' noise and their own rounding, and no more."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sim.physics.plant import Plant
from sim.physics.rotors import read_pair
from sim.px4.autopilot import Autopilot, Mode
from sim.truth import read_truth
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
ROUNDING = 0.001 / np.sqrt(12.0)


def test_commands_do_not_rattle_in_hold(tmp_path: Path) -> None:
    (tmp_path / "nothing.toml").write_text("\n")
    plant = Plant(read_vehicle(EXAMPLES / "x8_demo.toml"), read_pair(EXAMPLES / "rotor_paper.toml"))
    pilot = Autopilot(plant, read_truth(tmp_path / "nothing.toml"), seed=5)
    pilot.arm()
    pilot.take_off(3.0)
    for _ in range(round(9.0 * 250)):
        pilot.step()
    assert pilot.mode == Mode.HOLD
    commands = []
    for _ in range(500):
        pilot.step()
        commands.append(pilot.command)
    second = np.diff(np.array(commands), 2, axis=0)
    assert second.std() < 1.5 * np.sqrt(6.0) * ROUNDING
    assert abs(pilot.reading.position[2] + 3.0) < 0.15
