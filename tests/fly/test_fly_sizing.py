"""A plan sized by a first small swing: how far a vehicle swings beyond what it is asked, and what follows."""

from __future__ import annotations

import math

import numpy as np
import pytest
from memory_net import Net, Standin, meet

from coaxlink.fly.commands import Track
from coaxlink.fly.flight import Flown, OverLimit, Pilot
from coaxlink.fly.limits import FlightLimits
from coaxlink.fly.plans import hover, identify
from coaxlink.fly.sizing import first_swing, overshoot, sized
from coaxlink.fly.trajectory import FlightPlan, Hold, Swing

REACH = 2.0


def track(small: FlightPlan, gain: float) -> Track:
    """A flight of it at 20 Hz, `gain` times as far and an eighth of a cycle late, with drift and noise."""
    rng = np.random.default_rng(2)
    t = np.arange(0.0, small.duration_s, 0.05)
    delay = small.segments[1].duration_s / 8.0
    along = np.array([small.at(max(x - delay, 0.0))[1].position_m[0] for x in t])
    flown = 3.0 + gain * along + 0.02 * t + 0.03 * rng.standard_normal(len(t))
    rows = [(float(x), 1.0, -4.0) for x in flown]
    wanted = [small.at(x)[1].position_m for x in t]
    return Track(tuple(float(x) + 50.0 for x in t), ("",) * len(t), tuple(wanted), tuple(rows))


def test_how_far_a_small_swing_went() -> None:
    small = first_swing(identify(4.0, REACH))
    assert small is not None and first_swing(hover(4.0, REACH)) is None
    places = np.array([small.at(t)[1].position_m for t in np.arange(0.0, small.duration_s, 0.05)])
    assert np.ptp(places[:, 0]) == pytest.approx(0.25 * REACH, abs=0.01)
    assert np.ptp(places[:, 1:]) == 4.0  # level, at the plan's height
    for gain in (1.0, 1.5, 2.4):
        assert overshoot(small, track(small, gain)) == pytest.approx(gain, rel=0.1)
    assert overshoot(small, track(small, 0.6)) == 1.0


def test_only_level_swings_are_made_smaller() -> None:
    plan = identify(4.0, REACH)
    small = sized(plan, 2.5)
    assert small.duration_s == plan.duration_s and sized(plan, 1.0) == plan
    for before, after in zip(plan.segments, small.segments, strict=True):
        if isinstance(before, Swing) and isinstance(after, Swing):
            assert math.hypot(*after.end_m[:2]) == pytest.approx(math.hypot(*before.end_m[:2]) / 2.5)
            assert (after.end_m[2], after.yaw_end_rad) == (before.end_m[2], before.yaw_end_rad)
        else:
            assert after == before


@pytest.mark.slow
def test_a_vehicle_that_swings_goes_as_far_as_it_was_meant_to() -> None:
    middle = (0.0, 0.0, -3.0)
    plan = FlightPlan((Hold("hover", middle, 2.0), Swing("out", middle, (REACH, 0.0, -3.0), 12.0, 3)))
    board = Standin(Net(), "ardupilot")
    board.autopilot.swings_hz = 0.25
    with meet(board) as session:
        pilot, flown = Pilot(session, FlightLimits()), Flown(plan.duration_s)
        north: list[float] = []
        pilot.fly(plan, flown, lambda segment, t, state: north.append(state.north_m))
    assert flown.result == "flown" and flown.as_json()["first_swing_went"] == pytest.approx(2.4, abs=0.4)
    assert np.ptp(north) < 1.3 * REACH  # 4.8 m unsized


@pytest.mark.slow
def test_one_that_is_not_held_is_landed(monkeypatch: pytest.MonkeyPatch) -> None:
    board = Standin(Net(), "ardupilot")
    board.autopilot.swings_hz = 0.25
    monkeypatch.setattr("sim.ardupilot.copter.SWING_DAMPING", 0.05)
    with meet(board) as session, pytest.raises(OverLimit, match="times as far as asked: tune"):
        Pilot(session, FlightLimits()).fly(identify(3.0, REACH), Flown(60.0))
    assert not board.autopilot.armed
