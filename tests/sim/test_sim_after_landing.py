"""The mode of the stand-in PX4 after a flight: UserModeIntention.cpp, and seen on the real one."""

from __future__ import annotations

from pathlib import Path

import pytest

from sim.physics.plant import Plant
from sim.physics.rotors import read_pair
from sim.px4.autopilot import Autopilot, Goal, Mode, Refused
from sim.truth import Truth
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_after_a_landing_it_is_in_the_mode_chosen_before(tmp_path: Path) -> None:
    plant = Plant(read_vehicle(EXAMPLES / "x8_demo.toml"), read_pair(EXAMPLES / "rotor_paper.toml"))
    pilot = Autopilot(plant, Truth())

    def flown(*, offboard: bool) -> Mode:
        pilot.arm()
        pilot.take_off(2.0)
        for _ in range(round(6.0 * 250)):
            pilot.step()
        if offboard:
            pilot.offboard(Goal((0.0, 0.0, -2.0)))
            pilot.set_mode(Mode.OFFBOARD)
        pilot.set_mode(Mode.LAND)
        for _ in range(round(20.0 * 250)):
            pilot.step()
        assert pilot.landed and not pilot.armed
        return pilot.mode

    assert flown(offboard=False) == Mode.HOLD
    assert flown(offboard=True) == Mode.OFFBOARD
    with pytest.raises(Refused, match="health failures"):
        pilot.arm()
    pilot.set_mode(Mode.HOLD)
    pilot.arm()
    assert pilot.armed
