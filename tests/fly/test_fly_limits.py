"""Plans and limits of `coaxlink fly`, without a vehicle."""

from __future__ import annotations

import numpy as np
import pytest
from case_table import case_table

from coaxlink.errors import InputError
from coaxlink.fly.limits import FlightLimits, PositionState, breach, plan_faults
from coaxlink.fly.plans import NAMED, peaks, plan_of


def test_named_plans_are_smooth_and_our_own_end_where_they_began():
    with case_table() as case:
        for name in NAMED:
            with case(f"{name}"):
                plan = plan_of(name, 4.0, 2.0)
                times = np.arange(0.0, plan.duration_s, 0.02)
                place = np.array([plan.at(float(t))[1].position_m for t in times])
                speed = np.linalg.norm(np.diff(place, axis=0), axis=1) / 0.02
                assert speed.max() < 3.0  # no set-point jumps
                if name != "paper":  # which ends on its circle
                    assert np.allclose(place[0], place[-1], atol=0.02)
                assert plan_faults(plan, FlightLimits()) == []


def test_a_plan_beyond_a_limit_is_named():
    big = plan_of("circle", 4.0, 40.0)
    reported = " ".join(plan_faults(big, FlightLimits()))
    assert "distance reaches 40.0 m" in reported and "speed" in reported
    assert "height reaches 20.0 m" in " ".join(plan_faults(plan_of("hover", 20.0, 1.0), FlightLimits()))
    assert "comes down to 0.50 m" in " ".join(plan_faults(plan_of("hover", 0.5, 1.0), FlightLimits()))
    assert peaks(plan_of("steps", 4.0, 2.0))["highest_m"] == pytest.approx(5.0)


GOOD = {"north_m": 1.0, "east_m": 1.0, "height_m": 4.0, "off_plan_m": 0.2, "tilt_deg": 8.0, "battery": 0.8}


BEYOND = {
    "from the take-off point": {"east_m": -31.0},
    "high": {"height_m": 15.5},
    "off its set-point": {"off_plan_m": 3.5},
    "tilted": {"tilt_deg": 61.0},
    "battery at 29 %": {"battery": 0.29},
}


def test_every_limit_in_flight():
    assert breach(PositionState(**GOOD), FlightLimits()) is None
    for reported, changed in BEYOND.items():
        assert reported in (breach(PositionState(**{**GOOD, **changed}), FlightLimits()) or "")


def test_no_battery_limit_where_none_was_asked_for():
    assert breach(PositionState(**{**GOOD, "battery": 0.05}), FlightLimits(battery=0.0)) is None
    assert breach(PositionState(**{**GOOD, "battery": None}), FlightLimits()) is None


def test_a_plan_file_of_refine_is_read_and_rubbish_refused(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(
        'height_m = 3.0\n[[pieces]]\nwhat = "yaw"\nseconds = 8.0\nyaw_deg = 40.0\ncycles = 2\n'
        '[[pieces]]\nwhat = "north"\nseconds = 4.0\nnorth_m = 2.0\n'
    )
    plan = plan_of(str(path), 9.0, 9.0)
    assert plan.duration_s == pytest.approx(16.0) and peaks(plan)["radius_m"] == pytest.approx(2.0)
    path.write_text('height_m = 3.0\n[[pieces]]\nwhat = "x"\n')
    with pytest.raises(InputError, match="seconds: missing"):
        plan_of(str(path), 1.0, 1.0)
    path.write_text('height_m = 3.0\n[[pieces]]\nseconds = "x"\n')
    with pytest.raises(InputError, match="not a flight plan"):
        plan_of(str(path), 1.0, 1.0)
    with pytest.raises(InputError, match="hover"):
        plan_of("loop the loop", 1.0, 1.0)
