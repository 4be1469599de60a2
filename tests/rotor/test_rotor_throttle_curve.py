"""u = 1 is full throttle, where rpm go with throttle by a curve and the log stops before it."""

import numpy as np
import pytest

from coaxlink.data import Samples
from coaxlink.rotor.stand_data import normalised_speeds
from coaxlink.rotor.throttle_curve import throttle_curve


def stand(top, law, noise=5.0):
    throttle = np.linspace(0.1, top, 40)
    rpm = law(throttle) + noise * np.random.default_rng(1).standard_normal(40)
    loads = {"upper_thrust_N": 60 * throttle**2, "upper_torque_Nm": throttle**2}
    return Samples({"upper_throttle": throttle, "upper_rpm": rpm, **loads}, "rig")


def test_full_throttle_is_read_off_the_curve():
    speeds = normalised_speeds(stand(0.85, lambda t: 7000 * t - 2000 * t**2))
    assert speeds.speed_max_rpm == pytest.approx(5000, rel=0.01)
    assert "by their curve over throttles up to 0.85" in speeds.source


def test_what_was_measured_or_is_not_told_stays_the_fastest_row():
    measured = normalised_speeds(stand(1.0, lambda t: 7000 * t - 2000 * t**2))
    untold = normalised_speeds(stand(0.6, lambda t: 7000 * t - 2000 * t**2, noise=400.0))
    for speeds in (measured, untold):
        assert speeds.source == "fastest rpm in the log"


def test_few_rows_or_one_level_tell_no_curve():
    assert throttle_curve(np.linspace(0.1, 0.9, 5), np.linspace(500, 4000, 5)) is None
    assert throttle_curve(np.full(40, 0.5), np.full(40, 2500.0)) is None
