"""Flights from a plan file: where they go, how smoothly, and what is refused."""

from __future__ import annotations

import math

import pytest

from coaxlink.cli.sim import named_plan
from coaxlink.errors import InputError
from coaxlink.fly.plans import HEIGHT_M, REACH_M, plan_of
from sim.manoeuvres import read_plan


def plan(tmp_path, text):
    path = tmp_path / "plan.toml"
    path.write_text(text)
    return read_plan(path)


def test_it_swings_and_comes_back_and_then_goes_and_stays(tmp_path):
    follow, seconds = plan(
        tmp_path,
        "height_m = 4.0\n[[pieces]]\nseconds = 8\nnorth_m = 2\ncycles = 2\n"
        "[[pieces]]\nseconds = 4\nheight_m = 1.5\nyaw_deg = 90\n[[pieces]]\nseconds = 2\n",
    )
    assert seconds == 14.0
    assert follow(0.0).position == (0.0, 0.0, -4.0)
    assert follow(2.0).position == pytest.approx((2.0, 0.0, -4.0))  # half of the first cycle
    assert follow(4.0).position == pytest.approx((0.0, 0.0, -4.0), abs=1e-9)
    assert follow(12.5).position == pytest.approx((0.0, 0.0, -1.5))
    assert follow(99.0).yaw == pytest.approx(math.pi / 2)


def test_velocity_and_acceleration_belong_to_the_path(tmp_path):
    follow, _ = plan(
        tmp_path,
        "[[pieces]]\nseconds = 5\nnorth_m = 3\neast_m = -1\nheight_m = 6\n"
        "[[pieces]]\nseconds = 6\neast_m = 2\ncycles = 3\n",
    )
    h = 1e-4
    for t in (0.7, 2.5, 4.2, 5.9, 8.3):
        before, here, after = (follow(t + d) for d in (-h, 0.0, h))
        for k in range(3):
            slope = (after.position[k] - before.position[k]) / (2 * h)
            bend = (after.velocity[k] - before.velocity[k]) / (2 * h)
            assert here.velocity[k] == pytest.approx(slope, abs=1e-5)
            assert here.acceleration[k] == pytest.approx(bend, abs=1e-5)


def test_a_name_means_the_same_path_to_the_simulator_and_to_fly():
    follow, seconds = named_plan("steps", ("steps",))
    flown = plan_of("steps", HEIGHT_M, REACH_M)
    assert seconds == flown.duration_s
    for t in (0.0, 5.0, 9.7, seconds):
        there = flown.at(t)[1]
        assert (follow(t).position, follow(t).yaw) == (there.position_m, there.yaw_rad)
    with pytest.raises(InputError, match="hover"):
        named_plan("dance", ("hover",))
