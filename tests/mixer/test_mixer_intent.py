"""The wrench a table believes it delivers, against arithmetic by hand."""

import numpy as np
import pytest

from coaxlink.mixer.intent import intended_wrench

CT, KM = 73.06, 1.9 / 73.06
PLACES = [(1, 1, 1), (1, -1, -1), (-1, -1, 1), (-1, 1, -1)]  # forward, right, spin


def quad(factor):
    parameters = {"CA_AIRFRAME": 0, "CA_ROTOR_COUNT": 4, "CA_METHOD": 2, "THR_MDL_FAC": factor}
    for n, (x, y, spin) in enumerate(PLACES):
        geometry = {"PX": 0.2 * x, "PY": 0.2 * y, "PZ": 0.0, "AX": 0.0, "AY": 0.0, "AZ": -1.0}
        for key, value in {**geometry, "CT": CT, "KM": spin * KM}.items():
            parameters[f"CA_ROTOR{n}_{key}"] = value
    return parameters


@pytest.mark.parametrize(("factor", "share"), [(1.0, 0.25), (0.0, 0.5), (0.4, 0.4 * 0.25 + 0.6 * 0.5)])
def test_equal_speeds_mean_thrust_alone_by_the_tables_own_curve(factor, share):
    wrench = intended_wrench(quad(factor), np.full((3, 4), 0.5))
    np.testing.assert_allclose(wrench, np.tile([4 * CT * share, 0, 0, 0], (3, 1)), atol=1e-4)


def test_each_axis_answers_with_its_own_sign():
    right_side_up = [0.5, 0.6, 0.6, 0.5]  # the left rotors push harder: the right side sinks, roll > 0
    assert intended_wrench(quad(1.0), right_side_up)[1] == pytest.approx(
        0.2 * CT * 2 * (0.36 - 0.25), rel=1e-4
    )
    nose_up = [0.6, 0.6, 0.5, 0.5]
    assert intended_wrench(quad(1.0), nose_up)[2] == pytest.approx(0.2 * CT * 2 * (0.36 - 0.25), rel=1e-4)
    ccw_faster = [0.6, 0.5, 0.6, 0.5]
    assert intended_wrench(quad(1.0), ccw_faster)[3] == pytest.approx(1.9 * 2 * (0.36 - 0.25), rel=1e-4)
