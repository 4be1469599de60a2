"""PX4's own allocation code, recorded, against what firmware_params says it will do."""

import json
from pathlib import Path

import numpy as np
import pytest

from firmware_params import px4

VECTORS = json.loads((Path(__file__).parents[1] / "data" / "px4_vectors.json").read_text())
CASES = {case["name"]: case for case in VECTORS["cases"]}


def test_equals_the_240_golden_vectors():
    assert sum(len(case["vectors"]) for case in CASES.values()) == 240
    for name, case in CASES.items():
        mix = px4.realise(case["parameters"])
        np.testing.assert_allclose(mix.effectiveness, case["effectiveness"], 1e-6, 1e-5, err_msg=name)
        np.testing.assert_allclose(mix.mix, case["mix"], atol=1e-5, err_msg=name)
        for vector in case["vectors"]:
            sp = mix.setpoints(vector["setpoint"])
            np.testing.assert_allclose(sp, vector["sp"], atol=1e-5, err_msg=name)
            np.testing.assert_allclose(mix.throttle(sp), vector["throttle"], atol=1e-5, err_msg=name)


def test_a_table_survives_the_way_through_parameters():
    for case in CASES.values():
        table = px4.params_to_table(case["parameters"])
        again = px4.params_to_table(px4.table_to_params(table))
        np.testing.assert_array_equal(px4.realise(again).mix, px4.realise(table).mix)


def test_the_first_trap_is_named_and_its_neighbour_is_not():
    (finding,) = px4.realise(CASES["trap 1: eq. 15 scaled by 0.02 loses yaw"]["parameters"]).warnings
    assert finding.id == "px4.weak-axis" and finding.severity == "error" and "yaw" in finding.text
    assert px4.realise(CASES["just outside trap 1: by 0.0205"]["parameters"]).warnings == ()


def test_the_second_trap_is_named_and_its_neighbour_is_not():
    found = px4.realise(CASES["trap 2: CT 100, arm 1.3 m loses roll and pitch"]["parameters"]).warnings
    assert [f.id for f in found] == ["px4.small-mix", "px4.small-mix"]
    assert ["roll" in f.text or "pitch" in f.text for f in found] == [True, True]
    assert px4.realise(CASES["just outside trap 2: arm 1.2 m"]["parameters"]).warnings == ()


def test_the_paper_split_survives_the_normalisation():
    mix = px4.realise(CASES["reduced (eq. 15), THR_MDL_FAC 1"]["parameters"]).mix
    assert mix[4, 5] / mix[0, 5] == pytest.approx(69.89 / 46.98, abs=1e-6)  # 1.4877


def test_a_command_means_its_column_of_the_table():
    """A level quad: all alike under two curves, then left side, front and ccw rotors faster, by hand."""
    places = ((0.1, 0.1, 1), (-0.1, -0.1, 1), (0.1, -0.1, -1), (-0.1, 0.1, -1))  # PX4's quad x
    rotors = tuple(px4.RotorEntry((x, y, 0.0), (0, 0, -1), 50.0, 1.9 / 50 * s) for x, y, s in places)
    for curve, half in ((1.0, 0.25), (0.3, 0.3 * 0.25 + 0.7 * 0.5)):
        wrench = px4.realise(px4.Px4Table(rotors, curve)).wrench(np.full((3, 4), 0.5))
        assert wrench == pytest.approx(np.tile([200.0 * half, 0, 0, 0], (3, 1)), rel=1e-5, abs=1e-5)
    mix, more = px4.realise(px4.Px4Table(rotors, 1.0)), 0.6**2 - 0.5**2
    for faster, axis, per_square in (([2, 1], 1, 0.2 * 50), ([0, 2], 2, 0.2 * 50), ([0, 1], 3, 2 * 1.9)):
        u = np.full(4, 0.5)
        u[faster] = 0.6
        assert mix.wrench(u)[axis] == pytest.approx(per_square * more, rel=1e-4)


def test_a_rotor_without_thrust_or_axis_gets_no_column():
    params = dict(CASES["default coefficients"]["parameters"], CA_ROTOR3_CT=0.0)
    assert not px4.realise(params).effectiveness[:, 3].any()


def test_what_px4_cannot_fly_is_refused_and_a_value_outside_the_range_is_found():
    sound = CASES["default coefficients"]["parameters"]
    for change, text in (
        ({"CA_AIRFRAME": 2}, "CA_AIRFRAME = 2"),
        ({"CA_ROTOR_COUNT": 0}, "CA_ROTOR_COUNT = 0"),
        ({"CA_ROTOR0_CT": float("nan")}, "CA_ROTOR0_CT is nan"),
    ):
        with pytest.raises(px4.TableError, match=text):
            px4.realise({**sound, **change})
    assert [f.id for f in px4.realise({**sound, "CA_ROTOR0_CT": 150.0}).warnings] == ["px4.out-of-range"]
