"""Set-points are what a vehicle can follow: continuous, and velocity and acceleration are derivatives."""

import math

import numpy as np
import pytest
from case_table import case_table

from coaxlink.fly.trajectory import Circle, FlightPlan, Hold, Move, Swing, paper_flight, planned_flight

SEGMENTS = [
    Hold("h", (1.0, 2.0, -3.0), 2.0),
    Move("m", (0.0, 0.0, -3.0), (2.0, -1.0, -4.5), 3.0, 0.0, 1.0),
    Circle("c", 2.0, -4.5, 8.0, 2),
    Circle("f", 2.0, -4.5, 3.6, 3),
    Swing("s", (0.0, 0.0, -3.0), (1.0, -2.0, -4.0), 6.0, 2, 0.0, 1.0),
    Swing("t", (0.0, 0.0, -3.0), (1.0, -2.0, -4.0), 6.0, 0),
]


def test_velocity_and_acceleration_are_the_derivatives():
    with case_table() as case:
        for segment in SEGMENTS:
            with case(f"{segment}"):
                h = 1e-4
                for t in np.linspace(2 * h, segment.duration_s - 2 * h, 37):
                    before, here, after = (segment.at(x) for x in (t - h, t, t + h))
                    slope = (np.array(after.position_m) - before.position_m) / (2 * h)
                    bend = (np.array(after.velocity_m_s) - before.velocity_m_s) / (2 * h)
                    np.testing.assert_allclose(here.velocity_m_s, slope, atol=1e-5)
                    np.testing.assert_allclose(here.acceleration_m_s2, bend, atol=5e-3)


def test_a_circle_makes_whole_laps_of_its_radius_and_period():
    circle = Circle("c", 2.0, -4.5, 8.0, 2)
    np.testing.assert_allclose(circle.at(circle.duration_s).position_m, (2.0, 0.0, -4.5), atol=1e-9)
    middle = circle.at(circle.duration_s / 2)
    assert math.hypot(*middle.position_m[:2]) == pytest.approx(2.0)
    assert math.hypot(*middle.velocity_m_s) == pytest.approx(2 * math.pi * 2.0 / 8.0)


@pytest.mark.slow
def test_the_paper_flight_never_jumps_and_stays_above_ground():
    plan = paper_flight()
    points = [plan.at(t)[1] for t in np.arange(0.0, plan.duration_s, 0.01)]
    position = np.array([p.position_m for p in points])
    assert np.abs(np.diff(position, axis=0)).max() < 0.05
    assert position[:, 2].max() < -0.5
    names = {plan.at(t)[0] for t in np.arange(0.0, plan.duration_s, 0.1)}
    assert {"hover", "circle", "low hover"} <= names


def test_after_the_end_a_plan_holds_its_last_place():
    plan = FlightPlan((Move("m", (0.0, 0.0, -1.0), (0.0, 0.0, -3.0), 2.0),))
    assert plan.at(99.0)[1].position_m == (0.0, 0.0, -3.0)
    assert plan.at(-1.0)[1].position_m == (0.0, 0.0, -1.0)


def test_a_plan_of_refine_is_flown_piece_by_piece():
    plan = planned_flight(
        {
            "height_m": 4.0,
            "pieces": [
                {"what": "swing", "seconds": 8.0, "north_m": 2.0, "cycles": 2},
                {"what": "sink", "seconds": 4.0, "height_m": 1.5, "yaw_deg": 90.0},
                {"what": "stay", "seconds": 2.0},
            ],
        }
    )
    start = plan.duration_s - 14.0
    assert start > 2.0  # it settles first
    assert plan.at(0.0)[1].position_m == (0.0, 0.0, -4.0)
    name, there = plan.at(start + 2.0)  # half of the first cycle
    assert name == "swing" and there.position_m == pytest.approx((2.0, 0.0, -4.0))
    assert plan.at(start + 8.0)[1].position_m == pytest.approx((0.0, 0.0, -4.0), abs=1e-9)
    last = plan.at(start + 13.0)[1]
    assert last.position_m == pytest.approx((0.0, 0.0, -1.5)) and last.yaw_rad == pytest.approx(math.pi / 2)
