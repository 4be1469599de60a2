"""Laws as ArduPilot tables, and tables beside the board's."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from coaxlink.airframe import load_airframe
from coaxlink.errors import InputError
from coaxlink.rotor import load_rotor_model
from coaxlink.tables.ardupilot import ap_factors, report_ap
from coaxlink.tables.px4 import nearest, report_px4, wanted_mix, worst_relative
from coaxlink.uploading.ardupilot_table import moved_rotors, present_table
from coaxlink.uploading.beside import beside_ap, beside_px4
from coaxlink.vehicle import Vehicle
from firmware_params.ardupilot import ApTable, scripts, used_factors

EXAMPLES = Path(__file__).parents[2] / "examples"


def _load(frame="x8_paper", rotor="rotor_eq15"):
    return load_airframe(EXAMPLES / f"{frame}.toml"), load_rotor_model(EXAMPLES / f"{rotor}.toml")


def test_the_paper_s_normalised_matrix():
    """The table of eq. 15 as ArduCopter was flown with it."""
    factors = np.array(ap_factors(Vehicle(*_load()), "reduced"))
    np.testing.assert_allclose(np.abs(factors[:4]), [[0.336, 0.336, 0.5, 0.672]] * 4, atol=1e-3)
    np.testing.assert_allclose(np.abs(factors[4:]), [[0.5, 0.5, 0.410, 1.0]] * 4, atol=1e-3)
    assert (np.sign(factors[0]) == [-1, 1, 1, 1]).all()  # front right, counter-clockwise


def test_the_standard_law_is_ardupilot_s_own_x8():
    factors = np.array(ap_factors(Vehicle(*_load()), "standard"))
    np.testing.assert_allclose(factors, used_factors(ApTable(4)), atol=1e-6)


def test_the_files_carry_one_table():
    vehicle = Vehicle(*_load())
    report = report_ap(vehicle, "reduced", spin_min=0.0)
    (text,) = report.scripts.values()
    assert report.params["SCR_LD_CHECKSUM"] == scripts.load_checksum([text.encode()])
    assert report.params["FRAME_CLASS"] == 15 and report.params["SERVO8_FUNCTION"] == 40
    hover = 20 * 9.80665 / (4 * (46.98 * 46.98 / 69.89 + 69.89))
    assert report.params["MOT_THST_HOVER"] == pytest.approx(hover, abs=2e-4)
    assert report.squared_ratio == pytest.approx([1.487654] * 4, abs=1e-4)
    own_curve = report_ap(vehicle, "reduced", spin_min=0.05)
    assert own_curve.params["MOT_THST_EXPO"] == pytest.approx(0.9025 / 0.9975, abs=1e-4)
    assert own_curve.squared_ratio == pytest.approx([1.487654] * 4, rel=3e-3)
    assert "ap.spin-min" not in {f.id for f in own_curve.findings}
    other_curve = report_ap(vehicle, "reduced", spin_min=0.05, expo=1.0)
    assert other_curve.squared_ratio[0] < 1.47 and "ap.spin-min" in {f.id for f in other_curve.findings}
    loader = report_ap(vehicle, "reduced", frame_class=17)
    assert loader.params["CXL_N"] == 8 and loader.params["FRAME_CLASS"] == 17
    with pytest.raises(InputError, match="expected 15"):
        report_ap(vehicle, "reduced", frame_class=4)


@pytest.mark.slow
def test_done_is_demanded_where_the_firmware_can():
    for frame, law in (("x8_paper", "fitted"), ("coax_quad_plus", "reduced"), ("mixed_hexa", "reduced")):
        vehicle = Vehicle(*_load(frame, "rotor_eq15" if law == "reduced" else "rotor_paper"))
        ap, px4 = report_ap(vehicle, law), report_px4(vehicle, law)
        mix = px4.mix.mix
        for columns, mixed in (
            (ap.columns, ap.mix.factors),
            (px4.table, np.stack([*mix.T[:3], -mix[:, 5]], axis=-1)),
        ):
            demanded = wanted_mix(columns)
            assert max(worst_relative(demanded, nearest(mixed, demanded))) < 1e-3, (frame, law)


def test_a_gain_is_the_slope_that_the_paper_s_numbers_give():
    """Eq. 15 on its own rotors: roll torque per unit roll demand is the row of A times PX4's column."""
    vehicle = Vehicle(*_load())
    report = report_px4(vehicle, "reduced")
    roll = 4 * (8.48929 * 0.557875 + 12.62912 * 0.829925)
    assert report.behaviour.gain_Nm[0] == pytest.approx(roll, rel=1e-3)
    yaw = 4 * (2.44 * 1.0 + 2.0 * 0.819672)
    assert report.behaviour.gain_Nm[2] == pytest.approx(yaw, rel=1e-3)
    held = beside_px4(vehicle, report)
    scale = held.flown.gain_hint(held.reference)[0]
    assert scale == pytest.approx(held.reference.gain_Nm[0] / roll, rel=1e-3)


def test_against_the_board():
    vehicle = Vehicle(*_load())
    report = report_px4(vehicle, "reduced")
    board = dict(report.params) | {"CA_ROTOR0_CT": 50.0}
    held = beside_px4(vehicle, report, board)
    assert held.against == "on board" and held.reference.ceiling_N != held.flown.ceiling_N
    with pytest.raises(InputError, match="holds no multirotor table"):
        beside_px4(vehicle, report, {"CA_ROTOR_COUNT": 0})
    with pytest.raises(InputError, match="6 rotors"):
        beside_px4(vehicle, report, board | {"CA_ROTOR_COUNT": 6})


def test_an_ardupilot_board_is_known_by_its_frame_its_script_or_its_parameters():
    vehicle = Vehicle(*_load())
    matrix = report_ap(vehicle, "reduced")
    (text,) = matrix.scripts.values()
    built_in = present_table({"FRAME_CLASS": 4, "FRAME_TYPE": 1}, lambda: None)
    scripted = present_table({**matrix.params, "FRAME_TYPE": 0}, text.encode)
    np.testing.assert_allclose(used_factors(scripted), matrix.mix.factors, atol=1e-6)
    loader = report_ap(vehicle, "reduced", frame_class=17)
    live = present_table(loader.params, lambda: None)
    np.testing.assert_allclose(used_factors(live), loader.mix.factors, atol=1e-6)
    assert not moved_rotors(built_in, scripted) and not moved_rotors(scripted, live)
    for params, script in (
        (matrix.params, None),
        (matrix.params, b"MotorsMatrix:init(8)"),
        (loader.params | {"CXL_T1": 0.9}, None),
    ):
        assert present_table(params, lambda script=script: script) is None
    assert beside_ap(vehicle, matrix, ({"FRAME_CLASS": 4.0}, built_in)).against == "on board"
    with pytest.raises(InputError, match="not known here"):
        beside_ap(vehicle, matrix, ({"FRAME_CLASS": 3.0}, None))


def test_motors_that_a_frame_numbers_in_another_way_are_found():
    """The example is numbered as ArduPilot's Y6A, which its Y6B is not."""
    table = report_ap(Vehicle(*_load("y6")), "reduced").table
    y6a, y6b = (present_table({"FRAME_CLASS": 5, "FRAME_TYPE": kind}, lambda: None) for kind in (1, 10))
    assert moved_rotors(y6a, table) == []
    assert moved_rotors(y6b, table)[1] == "rotor 2 changes left or right and spin"
    x8 = present_table({"FRAME_CLASS": 4, "FRAME_TYPE": 1}, lambda: None)
    assert moved_rotors(x8, table) == ["8 rotors now, 6 in the table"]
    turned = dataclasses.replace(table, factors=tuple((r, p, -y, t) for r, p, y, t in table.factors))
    assert moved_rotors(table, turned)[5] == "rotor 6 changes spin"
