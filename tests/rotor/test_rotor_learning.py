"""The learning curve, and identification of logs joined."""

from __future__ import annotations

import numpy as np
import pytest
from rotor_bench import stand

from coaxlink.data import Samples
from coaxlink.data.join import join
from coaxlink.rotor import identify
from coaxlink.rotor.fit import Options
from coaxlink.rotor.identification import stand_data
from coaxlink.rotor.learning import learning_curve


def test_more_blocks_never_hurt_much_and_few_hurt() -> None:
    curve = learning_curve("crm", stand_data(stand(0)), Options(max_order=2))
    errors = [lesson.rmse["coaxial_thrust"] for lesson in curve]
    assert curve[0].blocks == 2 and curve[-1].blocks == 10
    assert curve[-1].rows == 110
    assert errors[-1] < 0.85 < errors[0]
    assert errors[-1] == pytest.approx(
        identify(stand(0), "crm", options=Options(max_order=2)).channels["coaxial_thrust"].rmse
    )


def test_squares_learn_nothing_more_from_more() -> None:
    errors = [
        lesson.rmse["lower_thrust"] for lesson in learning_curve("rcrm", stand_data(stand(0)), Options())
    ]
    assert errors[-1] > 1.5  # its own shape is what it misses, not rows


def test_a_single_rotor_test_joined_with_a_map() -> None:
    """The rotor alone, at speeds the map has not, adds to the upper rotor only."""
    pair = stand(1)
    u = np.linspace(0.05, 1.0, 60)
    random = np.random.default_rng(0)
    alone = Samples(
        {
            "upper_rpm": 5400 * u,
            "upper_throttle": u,
            "upper_thrust_N": 55.9517 * u**2 + 22.4464 * u + 0.5 * random.standard_normal(60),
            "upper_torque_Nm": 1.2437 * u**2 + 0.7155 * u + 0.01 * random.standard_normal(60),
        },
        "alone",
    )
    before, after = (identify(x, "crm", options=Options(max_order=2)) for x in (pair, join([pair, alone])))
    assert after.channels["upper_thrust"].held_out_rows == 181
    assert after.channels["coaxial_thrust"].held_out_rows == 121
    term = "u_u^2"
    assert (
        after.intervals["upper.thrust_N"].standard_error[term]
        < 0.9 * before.intervals["upper.thrust_N"].standard_error[term]
    )
    assert after.channels["coaxial_thrust"].rmse < 0.85
